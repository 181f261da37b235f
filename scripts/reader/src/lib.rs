//! Reads the values of a YAML tree key by key, and collects every finding.
//!
//! | module | |
//! |---|---|
//! | [`fields`] | the reader: maps, lists, numbers, times, words, values that are spread over a group |
//! | [`keys`](mod@keys) | a map as a struct with a field for each key |
//! | [`scope`] | the variables that are in scope |
//! | [`slips`] | hints for keys, words and forms of other programs |
//! | [`clock_time`] | instants and times of day |
//! | [`known`] | the lists of valid keys and words that the reader has used, for tests of the schemas |

pub mod clock_time;
pub mod fields;
pub mod known;
pub mod scope;
pub mod slips;

pub use fields::{keys, kinds};
