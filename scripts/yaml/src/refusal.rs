//! Explains errors of the operating system, and suggests remedies.

use std::fmt;
use std::io::{self, ErrorKind};
use std::path::Path;

/// The operation that failed.
#[derive(Clone, Copy, Debug)]
pub enum Attempt<'a> {
    /// The program tried to read this file.
    Read(&'a Path),
    /// The program tried to write this file or create this folder.
    Write(&'a Path),
    /// The program tried to listen at an address.
    Listen,
    /// The program tried to connect to a robot.
    Connect,
}

/// The reason why the system refused an operation, and a remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The reason that the system reports, in words for the user.
    pub reason: String,
    /// The remedy, if one is known.
    pub remedy: Option<String>,
}

impl Refusal {
    /// Explains an error that the system reported for an operation.
    #[must_use]
    pub fn of(attempt: Attempt<'_>, error: &io::Error) -> Self {
        Self { reason: reason(attempt, error), remedy: remedy(attempt, error) }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.remedy {
            Some(remedy) => write!(f, "{}; {remedy}", self.reason),
            None => f.write_str(&self.reason),
        }
    }
}

fn reason(attempt: Attempt<'_>, error: &io::Error) -> String {
    let reason = match (error.kind(), attempt) {
        (ErrorKind::NotFound, Attempt::Read(_)) => "there is no such file",
        (ErrorKind::NotFound, Attempt::Write(_)) => "the folder does not exist",
        (ErrorKind::NotADirectory | ErrorKind::AlreadyExists, Attempt::Write(_)) => {
            "a file with the name of the folder already exists"
        }
        (ErrorKind::IsADirectory, _) => "this is a folder",
        (ErrorKind::PermissionDenied, _) => "permission denied",
        (ErrorKind::AddrInUse, _) => "the port is in use",
        (ErrorKind::AddrNotAvailable, Attempt::Listen) => "this machine does not have that address",
        (ErrorKind::InvalidInput, Attempt::Listen) => "this is not an address",
        (ErrorKind::ConnectionRefused, _) => "connection refused",
        (ErrorKind::ConnectionReset, _) => "the other side closed the connection",
        (ErrorKind::TimedOut, _) => "no answer",
        _ if is_unknown_host(error) => "the host name cannot be resolved",
        _ => return plain(error),
    };
    reason.to_owned()
}

/// Returns the system's error text without the error number.
fn plain(error: &io::Error) -> String {
    let text = error.to_string();
    match text.rfind(" (os error ") {
        Some(end) => text[..end].to_owned(),
        None => text,
    }
}

/// Whether a host name could not be resolved. The standard library has no error kind for this, so the text is compared.
fn is_unknown_host(error: &io::Error) -> bool {
    error.to_string().starts_with("failed to lookup address information")
}

fn remedy(attempt: Attempt<'_>, error: &io::Error) -> Option<String> {
    let parent = |path: &Path| path.parent().unwrap_or(path).display().to_string();
    let remedy = match (attempt, error.kind()) {
        (Attempt::Read(path), ErrorKind::PermissionDenied) => {
            format!("allow it with `chmod u+r {}`, or ask the owner of the file", path.display())
        }
        (Attempt::Write(path), ErrorKind::NotFound) => format!("create it with `mkdir -p {}`", parent(path)),
        (Attempt::Write(_), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => {
            "choose a folder that you can write to".to_owned()
        }
        (
            Attempt::Write(_),
            ErrorKind::NotADirectory | ErrorKind::AlreadyExists | ErrorKind::IsADirectory,
        ) => "choose another path".to_owned(),
        (Attempt::Listen, ErrorKind::AddrInUse) => {
            "another program, perhaps a running robot, listens on this port: stop it, or choose another port"
                .to_owned()
        }
        (Attempt::Listen, ErrorKind::AddrNotAvailable) => {
            "listen on 127.0.0.1 to be reachable only from this machine, or on 0.0.0.0 to be reachable from any network"
                .to_owned()
        }
        (Attempt::Listen, ErrorKind::PermissionDenied) => "choose port 1024 or higher".to_owned(),
        (Attempt::Listen, ErrorKind::InvalidInput) => "write HOST:PORT, such as 127.0.0.1:7401".to_owned(),
        (Attempt::Connect, ErrorKind::ConnectionRefused) => {
            "start the robot, or correct the port in its address".to_owned()
        }
        (Attempt::Connect | Attempt::Listen, _) if is_unknown_host(error) => {
            "correct the name, or write the IP address".to_owned()
        }
        (
            Attempt::Connect,
            ErrorKind::TimedOut | ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable,
        ) => "check the address, and make sure that the robot is switched on and connected to this network".to_owned(),
        _ => return None,
    };
    Some(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusal_gives_advice_and_omits_error_number() {
        let told = |attempt, number| Refusal::of(attempt, &io::Error::from_raw_os_error(number)).to_string();
        let path = Path::new("shows/a.yaml");
        assert_eq!(
            told(Attempt::Write(path), 2),
            "the folder does not exist; create it with `mkdir -p shows`"
        );
        assert_eq!(told(Attempt::Listen, 13), "permission denied; choose port 1024 or higher");
        assert_eq!(told(Attempt::Write(path), 28), "No space left on device");
    }
}
