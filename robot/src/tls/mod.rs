//! TLS 1.3 with certificates on both sides: a robot accepts only operators of authorities that it trusts, and an operator can verify which
//! robot it is connected to. `docs/security.md` describes the content of a certificate, and which side checks which part of it.

mod authority;
mod config;
mod credentials;
mod guard;
mod identity;
mod list;
mod revoked;
mod statement;

pub use authority::Authority;
pub use config::{SERVER_NAME, client_config, server_config};
pub use credentials::{Credentials, CredentialsError};
pub use guard::Guard;
pub use identity::{Identity, IdentityError, Name};
pub use list::{Exclusion, List};
pub use revoked::Revoked;
pub use statement::{Signed, Witness};

/// Returns the calendar time in seconds since 1970, UTC, which determines whether certificates and lists are valid.
#[expect(clippy::disallowed_methods, reason = "certificates are valid by the calendar")]
fn calendar() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
