//! `downbeat keys`: creates the site's own certificate authority, and keys for robots and operators.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Subcommand;
use downbeat_robot::tls::Name;
use downbeat_robot::{Role, Roles};
use downbeat_scripts::shown::shown;
use downbeat_scripts::{abbreviate_home, counted};
use urrcp::RobotId;

use super::passphrase::{self, PassphraseArgs};
use super::push::{self, PushArgs};
use super::request::{self, InstallArgs, RequestArgs, SignArgs};
use super::{Exit, Format, ProjectArgs, console};
use crate::keys::{
    Ask, Authorities, Authority, End, Entry, IfThere, Issuing, KeysError, Kind, Location, Renewed,
    RequestError, calendar, check_operator_name,
};
use crate::show::table::Rows;

/// Default validity of a certificate in days.
const DAYS: i64 = 365;
/// Maximum validity of a certificate in days: that of the authority, because a longer validity would be useless.
const DAYS_MAX: i64 = 3_650;
const DAY: i64 = 24 * 3_600;

/// Make keys and certificates for robots and operators.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Begin with `downbeat keys init`. Copy each robot's file, and `revoked.pem`, to the robot; keep `authority.key` \
secret. The authority is in $DOWNBEAT_KEYS, or else in $XDG_DATA_HOME/downbeat/keys, or else in ~/.local/share/downbeat/keys. \
See docs/security.md.

Examples:
  downbeat keys init
  downbeat keys robot cf1 cf2 cf3
  downbeat keys operator anna --role observe,drive,stop
  downbeat keys secret cf4
  downbeat keys revoke cf2
  downbeat keys rotate"
)]
pub(super) enum KeysCommand {
    /// Make the authority whose certificates all robots and operators of a site trust.
    Init(InitArgs),
    /// Make keys for robots, by the ids that they report.
    Robot(RobotKeysArgs),
    /// Make a key for an operator.
    Operator(OperatorArgs),
    /// Make secrets for robots without TLS, such as microcontrollers at `hmac://` addresses.
    Secret(SecretArgs),
    /// Make a key on the machine that uses it, and a request for its certificate.
    Request(RequestArgs),
    /// Sign a request with the key of the authority.
    Sign(SignArgs),
    /// Add a signed certificate to the key for which it was requested.
    Install(InstallArgs),
    /// Make a new key for a robot or an operator. The old one remains valid until it expires or is revoked.
    Renew(RenewArgs),
    /// Revoke all keys of a robot or an operator, including its secret and passes.
    Revoke(RevokeArgs),
    /// Replace the authority while its robots and operators continue to work.
    Rotate(RotateArgs),
    /// Send the list of revoked keys to the robots of a fleet.
    Push(PushArgs),
    /// Set, change or remove the passphrase of the authority's key.
    Passphrase(PassphraseArgs),
    /// List all certificates and secrets.
    List(FolderArgs),
}

/// The location of the authority.
#[derive(Debug, clap::Args)]
pub(super) struct FolderArgs {
    /// The folder of the authority. By default, it is $DOWNBEAT_KEYS, or else $XDG_DATA_HOME/downbeat/keys, or else
    /// ~/.local/share/downbeat/keys.
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
}

impl FolderArgs {
    fn location(&self) -> Result<Location, KeysError> {
        Location::of(self.keys.as_deref())
    }

    pub(super) fn open(&self) -> Result<Authority, KeysError> {
        self.location()?.open(passphrase::ask)
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat keys init
  downbeat keys init --passphrase --keys /media/safe/keys")]
pub(super) struct InitArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// Ask for a passphrase that protects the authority's key. All commands that sign will ask for it.
    #[arg(long)]
    passphrase: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct DaysArgs {
    /// Number of days for which the certificate is valid.
    #[arg(long, value_name = "DAYS", default_value_t = DAYS, value_parser = clap::value_parser!(i64).range(1..=DAYS_MAX))]
    pub(super) days: i64,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  downbeat keys robot cf1 cf2 cf3 --days 90")]
pub(super) struct RobotKeysArgs {
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    days: DaysArgs,
    /// The robots' ids.
    #[arg(required = true, value_name = "ID")]
    robots: Vec<RobotId>,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Copy each file to its robot, with `revoked.serials`, and give each operator the file NAME.passes next to NAME.pem.

Example:
  downbeat keys secret cf4 cf5"
)]
pub(super) struct SecretArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// Replace a secret that a robot already has.
    #[arg(long)]
    renew: bool,
    /// The robots' ids.
    #[arg(required = true, value_name = "ID")]
    robots: Vec<RobotId>,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Roles:
  observe  read the identity, the state and the sensors of robots
  drive    play missions
  stop     stop any robot, also in missions of other operators
  seize    take over robots from missions of other operators

Example:
  downbeat keys operator anna --role observe,drive,stop")]
pub(super) struct OperatorArgs {
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    days: DaysArgs,
    /// The operator's name.
    #[arg(value_parser = operator_name)]
    name: String,
    /// What the operator may do: observe, drive, stop, seize.
    #[arg(long = "role", required = true, value_name = "ROLE", value_delimiter = ',')]
    roles: Vec<Role>,
}

fn named(robot: Option<&RobotId>, operator: Option<&str>) -> Option<Name> {
    robot.cloned().map(Name::Robot).or_else(|| operator.map(|name| Name::Operator(name.to_owned())))
}

#[derive(Debug, clap::Args)]
pub(super) struct NamedArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// The robot's id.
    #[arg(required_unless_present_any = ["operator", "all"], value_name = "ROBOT")]
    robot: Option<RobotId>,
    /// The operator's name, instead of a robot.
    #[arg(long, value_name = "NAME", conflicts_with = "robot", value_parser = operator_name)]
    operator: Option<String>,
}

impl NamedArgs {
    fn name(&self) -> Option<Name> {
        named(self.robot.as_ref(), self.operator.as_deref())
    }
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat keys revoke cf2
  downbeat keys revoke --operator anna --fleet fleet.yaml")]
pub(super) struct RevokeArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// The robot's id.
    #[arg(required_unless_present_any = ["operator", "serial"], value_name = "ROBOT")]
    robot: Option<RobotId>,
    /// The operator's name, instead of a robot.
    #[arg(long, value_name = "NAME", conflicts_with = "robot", value_parser = operator_name)]
    operator: Option<String>,
    /// Revoke only the certificate whose serial number begins with these digits, as in `downbeat keys list`, and the passes with the
    /// same number.
    #[arg(long, value_name = "DIGITS", conflicts_with_all = ["robot", "operator"])]
    serial: Option<String>,
    /// Then send the list of revoked keys to the robots of this fleet, as `downbeat keys push` does.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
}

#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat keys renew cf2
  downbeat keys renew --all")]
pub(super) struct RenewArgs {
    #[command(flatten)]
    named: NamedArgs,
    #[command(flatten)]
    days: DaysArgs,
    /// After `downbeat keys rotate`: make a new key for each name that has only one of the old authority.
    #[arg(long, conflicts_with_all = ["robot", "operator"])]
    all: bool,
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "If the key of the authority was stolen, do not use this command: make a new authority in another folder, and new keys for all.

Examples:
  downbeat keys rotate           # 1. make the new authority
  downbeat keys push             # 2. robots and operators that get revoked.pem trust both
  downbeat keys renew --all      # 3. make new keys, and copy them as at first
  downbeat keys rotate --end     # 4. make the list that shuts out the old authority
  downbeat keys push             # 5. send it"
)]
pub(super) struct RotateArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// Shut out the old authority, and delete its key.
    #[arg(long)]
    end: bool,
    /// With --end, also shut out names that have only a key of the old authority.
    #[arg(long, requires = "end")]
    force: bool,
}

fn operator_name(text: &str) -> Result<String, String> {
    check_operator_name(text).map(|()| text.to_owned())
}

pub(super) fn keys(command: &KeysCommand, format: Format) -> Exit {
    let done = match command {
        KeysCommand::Init(args) => init(args, format),
        KeysCommand::Robot(args) => {
            let names = args.robots.iter().cloned().map(Name::Robot);
            issue(&args.folder, &names.collect(), &Roles::default(), args.days.days, format)
        }
        KeysCommand::Operator(args) => {
            let roles = args.roles.iter().copied().collect();
            let names = BTreeSet::from([Name::Operator(args.name.clone())]);
            issue(&args.folder, &names, &roles, args.days.days, format)
        }
        KeysCommand::Secret(args) => secret(args, format),
        KeysCommand::Request(args) => request::request(args, format),
        KeysCommand::Sign(args) => request::sign(args, format),
        KeysCommand::Install(args) => request::install(args, format),
        KeysCommand::Renew(args) => renew(args, format),
        KeysCommand::Revoke(args) => match revoke(args, format) {
            Ok(exit) => return exit,
            Err(error) => Err(error),
        },
        KeysCommand::Rotate(args) => rotate(args, format),
        KeysCommand::Push(args) => return push::push(args, format),
        KeysCommand::Passphrase(args) => passphrase::passphrase(args, format),
        KeysCommand::List(args) => list(args, format),
    };
    match done {
        Ok(()) => Exit::Done,
        Err(error) => {
            console::error(&error.to_string());
            match error {
                KeysError::Taken(_)
                | KeysError::SecretTaken(_)
                | KeysError::RevokedAlready(_)
                | KeysError::Rotating(_)
                | KeysError::NotRotating(_)
                | KeysError::NotRenewed(_)
                | KeysError::FileExists(_)
                | KeysError::Request { error: RequestError::Certified(_), .. }
                | KeysError::Exists(_) => Exit::Failed,
                _ => Exit::Usage,
            }
        }
    }
}

fn init(args: &InitArgs, format: Format) -> Result<(), KeysError> {
    let location = args.folder.location()?;
    let new_passphrase = args.passphrase.then_some(passphrase::ask_new as Ask);
    let authority = location.create(calendar(), new_passphrase)?;
    let folder = location.folder();
    match format {
        Format::Json => {
            console::print_json(&serde_json::json!({ "keys": folder, "revoked": authority.revoked() }));
        }
        Format::Text => console::print(&format!(
            "created an authority in {folder}\n\
             next: `downbeat keys robot ID` for each robot, `downbeat keys operator NAME --role observe,drive,stop` for yourself\n\
             then write into fleet.yaml:\n  identity: {}\n  revoked: {}\n\
             keep {folder}/authority.key secret, and keep a copy of it in a safe place: anyone who has it can create keys\n",
            in_yaml(&folder.join("operators/NAME.pem")),
            in_yaml(&authority.revoked()),
            folder = shown(&folder.display().to_string()),
        )),
    }
    Ok(())
}

/// Returns a path as a value of a fleet file.
fn in_yaml(path: &Path) -> String {
    let path = abbreviate_home(path).display().to_string();
    let is_plain = path.chars().all(|c| c.is_alphanumeric() || "/._-~".contains(c));
    if is_plain { path } else { serde_json::Value::from(path).to_string() }
}

fn issue(
    folder: &FolderArgs,
    names: &BTreeSet<Name>,
    roles: &Roles,
    days: i64,
    format: Format,
) -> Result<(), KeysError> {
    let paths = folder.open()?.issue(names, roles, calendar(), days)?;
    tell(names.iter().zip(&paths), days, format);
    Ok(())
}

fn secret(args: &SecretArgs, format: Format) -> Result<(), KeysError> {
    let if_there = if args.renew { IfThere::Replace } else { IfThere::Keep };
    let robots = args.robots.iter().cloned().collect();
    let paths = args.folder.open()?.make_secrets(&robots, if_there)?;
    match format {
        Format::Json => {
            let made = |(robot, path): (&RobotId, &PathBuf)| serde_json::json!({ "name": format!("robot {robot}"), "secret": path });
            let made: Vec<_> = robots.iter().zip(&paths).map(made).collect();
            console::print_json(&serde_json::json!({ "secrets": made }));
        }
        Format::Text => {
            for (robot, path) in robots.iter().zip(&paths) {
                let line = format!("robot {robot}: {}; operators now have passes for it", path.display());
                console::print(&format!("{}\n", shown(&line)));
            }
        }
    }
    Ok(())
}

fn renew(args: &RenewArgs, format: Format) -> Result<(), KeysError> {
    let authority = args.named.folder.open()?;
    if args.all {
        return renew_all(&authority, args.days.days, format);
    }
    let Some(name) = args.named.name() else { return Ok(()) };
    let path = authority.renew(&name, calendar(), args.days.days)?;
    tell(std::iter::once((&name, &path)), args.days.days, format);
    Ok(())
}

/// Makes keys of the current authority for all names that have only one of the old authority.
fn renew_all(authority: &Authority, days: i64, format: Format) -> Result<(), KeysError> {
    let Renewed { made, requested } = authority.renew_all(calendar(), days)?;
    match format {
        Format::Json => {
            let requested: Vec<String> = requested.iter().map(Name::to_string).collect();
            let made = in_json(made.iter().map(|(name, path)| (name, path)), days);
            console::print_json(&serde_json::json!({ "keys": made, "requested": requested }));
        }
        Format::Text => {
            tell(made.iter().map(|(name, path)| (name, path)), days, format);
            for name in &requested {
                let problem = KeysError::KeyElsewhere(name.clone()).to_string();
                console::print(&format!("{}: not renewed: {}\n", shown(&name.to_string()), shown(&problem)));
            }
            if made.is_empty() && requested.is_empty() {
                console::print("every name with a valid key has one of the current authority\n");
            }
        }
    }
    Ok(())
}

fn rotate(args: &RotateArgs, format: Format) -> Result<(), KeysError> {
    let authority = args.folder.open()?;
    if args.end {
        let end = if args.force { End::Always } else { End::IfRenewed };
        authority.end(end, calendar())?;
    } else {
        authority.rotate(calendar())?;
    }
    let (authorities, list) = (authority.authorities()?, authority.revoked());
    match format {
        Format::Json => {
            let Authorities { current, old } = authorities;
            console::print_json(&serde_json::json!({ "current": current, "old": old, "revoked": list }));
        }
        Format::Text => {
            let (name, list) = (mark(&authorities.current), list.display().to_string());
            let text = if args.end {
                format!(
                    "the old authority is shut out by {list}, and its key was deleted; destroy all copies of that key\n\
                     next: `downbeat keys push FLEET`, and copy {list} to each operator and to each robot that `push` does not reach\n"
                )
            } else {
                format!(
                    "made authority {name}, which signs all new keys; keep a copy of successor.key in a safe place\n\
                     next: `downbeat keys push FLEET`, and copy {list} to each operator and to each robot that `push` does not reach\n\
                     when all have it: `downbeat keys renew --all`, and copy the new keys\n\
                     when all use their new keys: `downbeat keys rotate --end`\n"
                )
            };
            console::print(&text);
        }
    }
    Ok(())
}

/// Returns the part of an authority's name that distinguishes it from other authorities that `downbeat keys` made.
fn mark(name: &str) -> &str {
    name.rsplit(' ').next().unwrap_or(name)
}

fn in_json<'a>(made: impl Iterator<Item = (&'a Name, &'a PathBuf)>, days: i64) -> serde_json::Value {
    made.map(|(name, path)| serde_json::json!({ "name": name.to_string(), "file": path, "days": days }))
        .collect()
}

fn tell<'a>(made: impl Iterator<Item = (&'a Name, &'a PathBuf)>, days: i64, format: Format) {
    match format {
        Format::Json => console::print_json(&serde_json::json!({ "keys": in_json(made, days) })),
        Format::Text => {
            for (name, path) in made {
                let line = format!("{name}: {}, valid for {days} days", path.display());
                console::print(&format!("{}\n", shown(&line)));
            }
        }
    }
}

fn revoke(args: &RevokeArgs, format: Format) -> Result<Exit, KeysError> {
    let RevokeArgs { folder, robot, operator, serial, fleet, project } = args;
    // The fleet is read first: an error in its file prevents the whole command.
    let fleet = match fleet.as_deref().map(|path| push::fleet(path, project, format)).transpose() {
        Ok(fleet) => fleet,
        Err(exit) => return Ok(exit),
    };
    let authority = folder.open()?;
    let certificate = serial.as_deref().map(|serial| authority.with_serial(serial)).transpose()?;
    let named = || named(robot.as_ref(), operator.as_deref());
    let Some(name) = certificate.as_ref().map(|(name, _)| name.clone()).or_else(named) else {
        return Ok(Exit::Done);
    };
    if fleet.as_ref().is_some_and(|fleet| push::is_sent_by(fleet, &name)) {
        console::error(&format!(
            "{} would send the list to the robots itself, and they would refuse it; set DOWNBEAT_IDENTITY to the identity file of another operator",
            shown(&name.to_string())
        ));
        return Ok(Exit::Usage);
    }
    let revoked = match &certificate {
        Some((_, certificate)) => authority.revoke_certificate(&name, certificate, calendar()).map(|()| 1),
        None => authority.revoke(&name, calendar()),
    };
    let revoked = match revoked {
        // The list may not have reached all robots.
        Err(KeysError::RevokedAlready(_)) if fleet.is_some() => 0,
        revoked => revoked?,
    };
    let (list, serials) = (authority.revoked(), authority.revoked_serials());
    // The folder is locked while the authority is open.
    drop(authority);
    if format == Format::Text {
        console::print(&format!("revoked {} of {}\n", counted(revoked, "key"), shown(&name.to_string())));
        if fleet.is_none() {
            console::print(&format!(
                "next: `downbeat keys push FLEET`, or copy {} to every robot, and {} to every robot with a secret; a robot with an old list still accepts revoked keys\n",
                shown(&list.display().to_string()),
                shown(&serials.display().to_string())
            ));
        }
    }
    let sent = fleet.map(|fleet| push::send(&fleet, folder, PushArgs::PATIENCE)).transpose();
    if format == Format::Json {
        let robots = sent.as_ref().ok().and_then(Option::as_ref);
        let mut json = serde_json::json!({ "name": name.to_string(), "revoked": revoked, "list": list, "serials": serials });
        robots.into_iter().for_each(|robots| json["robots"] = serde_json::json!(robots));
        console::print_json(&json);
    }
    match sent {
        Ok(None) => Ok(Exit::Done),
        Ok(Some(robots)) => {
            if format == Format::Text {
                push::show(&robots);
            }
            Ok(push::exit(&robots))
        }
        Err(message) => {
            console::error(&format!("the list was not sent to the robots: {message}"));
            Ok(Exit::Failed)
        }
    }
}

fn list(args: &FolderArgs, format: Format) -> Result<(), KeysError> {
    let authority = args.open()?;
    let (issued, secrets) = (authority.issued()?, authority.robots_with_secret()?);
    let authorities = authority.authorities()?;
    match format {
        Format::Json => {
            let Authorities { current, old } = authorities;
            console::print_json(&serde_json::json!({
                "certificates": issued.entries(), "secrets": secrets, "current": current, "old": old,
            }));
        }
        Format::Text => {
            let mut rows = Rows::new(&["name", "of a", "serial", "issued", "roles", "state"], 6);
            for entry in issued.entries() {
                let kind = if entry.kind == Kind::Robot { "robot" } else { "operator" };
                let serial = distinct(entry, issued.entries());
                let issuing = authorities.issuing(entry.authority.as_deref());
                rows.add([
                    &entry.name,
                    kind,
                    serial,
                    &day(entry.issued),
                    &entry.roles.join(", "),
                    &state(entry, issuing),
                ]);
            }
            for robot in &secrets {
                rows.add([robot.as_str(), "robot", "", "", "", "has a secret"]);
            }
            console::print(&rows.text(console::columns()));
            if let Some(old) = &authorities.old {
                console::print(&progress(&authorities.current, old, &authority.not_renewed(calendar())?));
            }
        }
    }
    Ok(())
}

/// Returns how far the replacement of an authority has progressed. `left` have only a key of the old authority.
fn progress(current: &str, old: &str, left: &[Name]) -> String {
    let names: Vec<String> = left.iter().map(Name::to_string).collect();
    let next = if left.is_empty() {
        "every name has a key of the new authority; when all use it, continue with `downbeat keys rotate --end`".to_owned()
    } else {
        let count = counted(left.len(), "name");
        let names = shown(&names.join(", ")).into_owned();
        format!(
            "{count} without a key of the new authority: {names}; continue with `downbeat keys renew --all`"
        )
    };
    format!("authority {} replaces {}: {next}\n", mark(current), mark(old))
}

/// Minimum number of characters of a serial number that are listed.
const SERIAL_SHOWN: usize = "00:00:00:00".len();

/// Returns the beginning of a serial number that no other certificate has.
fn distinct<'a>(entry: &'a Entry, all: &[Entry]) -> &'a str {
    let alike = |other: &Entry| {
        let pairs = entry.serial.bytes().zip(other.serial.bytes());
        pairs.take_while(|(a, b)| a == b).count() + 1
    };
    let others = all.iter().filter(|other| other.serial != entry.serial);
    let shown = others.map(alike).max().unwrap_or(0).max(SERIAL_SHOWN);
    entry.serial.get(..shown).unwrap_or(&entry.serial)
}

/// Returns the day of a time in seconds since 1970, in UTC.
fn day(seconds: i64) -> String {
    chrono::DateTime::from_timestamp(seconds, 0).map(|at| at.format("%F").to_string()).unwrap_or_default()
}

fn state(entry: &Entry, issuing: Issuing) -> String {
    let left = entry.expires - calendar();
    match entry.revoked {
        Some(_) => "revoked".to_owned(),
        None if left < 0 => "expired".to_owned(),
        None => match issuing {
            Issuing::Current => format!("valid for {} days", left / DAY),
            Issuing::Old => format!("valid for {} days, of the old authority", left / DAY),
            Issuing::Ended => "its authority has ended".to_owned(),
        },
    }
}
