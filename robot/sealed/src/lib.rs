//! A transport for robots that are too small for TLS, based on a secret that a robot shares with its authority. Each side proves that it
//! knows a key that is derived from the secret. Each record carries a code (HMAC-SHA256), so that the receiver detects records that were
//! altered, repeated, omitted or reordered. The messages are not encrypted: others can read them.
//!
//! `docs/protocol.md` specifies the format, and `docs/security.md` describes the protection. The modules `handshake` and `record` do no
//! I/O.

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
pub use revoked::{RevokedSerials, Serials};
pub use secret::{Pass, Secret, SecretError};
pub use stream::{Sealed, connect};
