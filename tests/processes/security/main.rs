//! Tests of who may move a robot, and of what strangers can do.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod attacks;
mod audit;
mod desk;
mod flooding;
mod hmac;
mod hostile;
mod identity;
mod location;
mod own_pki;
mod passphrase;
mod requests;
mod revoked;
mod rotation;
mod seize;
mod tls;
