//! TLS 1.3 with certificates on both sides: a robot accepts only operators of its authority, and an operator can verify which robot it is
//! connected to. `docs/security.md` describes the content of a certificate, and which side checks which part of it.

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
