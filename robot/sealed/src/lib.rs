//! A secret that a robot shares with its authority: for robots too small for TLS. Both sides prove that they know a key that
//! follows from it, and each record carries a code (HMAC-SHA256), so that none can be altered, repeated, left out or put in
//! another order. What is sent can be read by others.
//!
//! `docs/protocol.md` has the bytes, `docs/security.md` what this is good for. `handshake` and `record` do no I/O.

mod claim;
mod guard;
mod handshake;
mod hex;
mod passes;
mod record;
mod revoked;
mod secret;
mod stream;

pub use claim::{Claim, NoClaim};
pub use guard::Guard;
pub use handshake::{Hello, Keys, NONCE_BYTES, Nonce, NotSealed, Refused, fresh_nonce, proof_of_operator};
pub use passes::{Held, Passes};
pub use record::{BadRecord, Opening, RECORD_BYTES_MAX, Sealing};
pub use revoked::RevokedSerials;
pub use secret::{Pass, Secret, SecretError};
pub use stream::{Sealed, connect};
