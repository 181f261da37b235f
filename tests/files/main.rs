//! Import and export of other programs' files, and the files that the program opens on its host.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod export;
mod host;
mod import;
mod import_real;
mod import_tables;
