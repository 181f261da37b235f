//! `downbeat keys request`, `sign` and `install`: keys that are made on the machine that uses them.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use downbeat_robot::tls::Name;
use downbeat_robot::{Role, Roles};
use downbeat_scripts::shown::shown;

use super::keys::{DaysArgs, FolderArgs};
use super::{Format, console};
use crate::keys::{self, Fingerprint, KeysError, Request, Terms, calendar, check_operator_name};

/// The kind of the owner of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Owner {
    /// A robot, by the id that it reports.
    Robot,
    /// An operator.
    Operator,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Writes NAME.pem, the private key, which never leaves this machine, and NAME.csr, the request. Bring the request to the \
authority, which signs it with `downbeat keys sign`, and bring the certificate back for `downbeat keys install`.

Examples:
  downbeat keys request robot cf1
  downbeat keys request operator anna --role observe,drive"
)]
pub(super) struct RequestArgs {
    /// Whose key to make.
    #[arg(value_enum)]
    owner: Owner,
    /// The robot's id, or the operator's name.
    name: String,
    /// The roles to ask for, for an operator. The authority decides which roles it grants.
    #[arg(long = "role", value_name = "ROLE", value_delimiter = ',')]
    roles: Vec<Role>,
    /// The folder for the two files.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Before you send the certificate, compare the fingerprint with the one that `downbeat keys request` printed, for example \
by telephone: the request may have been exchanged on its way.

Examples:
  downbeat keys sign cf1.csr
  downbeat keys sign anna.csr --role observe,drive,stop --days 90"
)]
pub(super) struct SignArgs {
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    days: DaysArgs,
    /// The request.
    #[arg(value_name = "FILE")]
    request: PathBuf,
    /// What the operator may do: observe, drive, stop, seize. The roles in the request have no effect.
    #[arg(long = "role", value_name = "ROLE", value_delimiter = ',')]
    roles: Vec<Role>,
    /// Sign only a key with this fingerprint.
    #[arg(long, value_name = "HEX")]
    fingerprint: Option<Fingerprint>,
    /// Renew the certificate of a name that already has one.
    #[arg(long)]
    renew: bool,
    /// The folder for the certificate. By default, it is the folder of the request.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Adds the certificate to the file with the private key, which is then a complete identity file.

Example:
  downbeat keys install cf1.crt"
)]
pub(super) struct InstallArgs {
    /// The certificate that `downbeat keys sign` wrote.
    #[arg(value_name = "FILE")]
    certificate: PathBuf,
    /// The file with the private key. By default, it is FILE with the ending `.pem`.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Trust only an authority whose key has this fingerprint, which `downbeat keys sign` printed. If it printed two, state both.
    #[arg(long = "fingerprint", value_name = "HEX")]
    fingerprints: Vec<Fingerprint>,
}

/// Returns the folder that contains a file.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn print_lines(lines: &[String]) {
    for line in lines {
        console::print(&format!("{}\n", shown(line)));
    }
}

fn texts(fingerprints: &[Fingerprint]) -> Vec<String> {
    fingerprints.iter().map(Fingerprint::to_string).collect()
}

/// Returns a line for each authority's fingerprint. The first authority signed a certificate; a second one is being replaced.
fn of_authorities(relation: &str, fingerprints: &[Fingerprint]) -> Vec<String> {
    let kinds = ["authority", "old authority"].into_iter();
    let line = |(kind, found)| format!("fingerprint of the {kind}{relation}: {found}");
    kinds.zip(fingerprints).map(line).collect()
}

fn words(roles: &Roles) -> Vec<String> {
    roles.iter().map(|role| role.to_string()).collect()
}

impl RequestArgs {
    fn name(&self) -> Result<Name, KeysError> {
        let unusable = |error: String| KeysError::Name { name: self.name.clone(), error };
        match self.owner {
            Owner::Robot => self.name.parse().map(Name::Robot).map_err(|error| unusable(error.to_string())),
            Owner::Operator => {
                check_operator_name(&self.name).map_err(unusable)?;
                Ok(Name::Operator(self.name.clone()))
            }
        }
    }
}

pub(super) fn request(args: &RequestArgs, format: Format) -> Result<(), KeysError> {
    let name = args.name()?;
    let wished: Roles = args.roles.iter().copied().collect();
    if args.owner == Owner::Robot && !args.roles.is_empty() {
        return Err(KeysError::RolesOfRobot);
    }
    let made = keys::request(&args.out, &name, &wished)?;
    match format {
        Format::Json => console::print_json(&serde_json::json!({
            "name": name.to_string(),
            "key": made.key,
            "request": made.request,
            "fingerprint": made.fingerprint.to_string(),
        })),
        Format::Text => print_lines(&[
            format!("{name}: {} is the private key, which stays here", made.key.display()),
            format!("fingerprint of the key: {}", made.fingerprint),
            format!(
                "next: bring {} to the authority for `downbeat keys sign`, and state the fingerprint by another way, such as the telephone",
                made.request.display()
            ),
        ]),
    }
    Ok(())
}

pub(super) fn sign(args: &SignArgs, format: Format) -> Result<(), KeysError> {
    let request = Request::read(&args.request)?;
    if let Some(expected) = &args.fingerprint {
        request.check_fingerprint(expected)?;
    }
    let terms = Terms {
        roles: args.roles.iter().copied().collect(),
        from: calendar(),
        days: args.days.days,
        is_renewal: args.renew,
    };
    let folder = args.out.as_deref().unwrap_or_else(|| folder_of(&args.request));
    let signed = args.folder.open()?.sign(&request, &terms, folder)?;
    let (name, certificate) = (request.name(), signed.certificate.display());
    match format {
        Format::Json => console::print_json(&serde_json::json!({
            "name": name.to_string(),
            "certificate": signed.certificate,
            "serial": signed.identity.serial,
            "days": args.days.days,
            "roles": words(&signed.identity.roles),
            "requested_roles": words(request.wished()),
            "fingerprint": request.fingerprint().to_string(),
            "authorities": texts(&signed.authorities),
            "passes": signed.passes,
        })),
        Format::Text => {
            let mut lines = vec![format!("{name}: {certificate}, valid for {} days", args.days.days)];
            if matches!(name, Name::Operator(_)) {
                let granted = &signed.identity.roles;
                lines.push(format!("granted: {granted}; the request asked for {}", request.wish()));
            }
            lines.push(format!("fingerprint of the key: {}", request.fingerprint()));
            if args.fingerprint.is_none() {
                lines.push(
                    "before you send the certificate, compare it with the fingerprint that `downbeat keys request` printed"
                        .to_owned(),
                );
            }
            lines.extend(of_authorities("", &signed.authorities));
            let passes = signed.passes.as_ref();
            let passes = passes.map(|passes| format!(" and {}", passes.display())).unwrap_or_default();
            lines.push(format!("next: send {certificate}{passes}, and run `downbeat keys install` there"));
            print_lines(&lines);
        }
    }
    Ok(())
}

pub(super) fn install(args: &InstallArgs, format: Format) -> Result<(), KeysError> {
    let key = args.key.clone().unwrap_or_else(|| args.certificate.with_extension("pem"));
    let installed = keys::install(&args.certificate, &key, &args.fingerprints)?;
    let identity = &installed.identity;
    match format {
        Format::Json => console::print_json(&serde_json::json!({
            "name": identity.name.to_string(),
            "file": installed.file,
            "roles": words(&identity.roles),
            "serial": identity.serial,
            "expires": identity.expires,
            "authorities": texts(&installed.authorities),
        })),
        Format::Text => {
            print_lines(&[format!("{}: {} is complete", identity.name, installed.file.display())]);
            print_lines(&of_authorities(", which it trusts", &installed.authorities));
        }
    }
    Ok(())
}
