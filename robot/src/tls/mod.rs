//! TLS 1.3 with certificates on both sides: a robot hears only operators of its authority, and an operator is sure which
//! robot it speaks to. `docs/security.md` says what is in a certificate and who checks it.

mod config;
mod credentials;
mod guard;
mod identity;
mod revoked;
mod statement;

pub use config::{SERVER_NAME, client_config, server_config};
pub use credentials::{Credentials, CredentialsError};
pub use guard::Guard;
pub use identity::{Identity, IdentityError, Name};
pub use revoked::Revoked;
pub use statement::{Signed, Witness};

#[cfg(test)]
mod tests;
