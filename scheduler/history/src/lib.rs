//! Past missions, read from their journals and recordings.
//!
//! | module | |
//! |---|---|
//! | [`history`] | a journal or a recording, read from its file |
//! | [`compare`] | the differences between two plans or two missions |
//! | [`measured`] | the network and the clocks of a recording, as a world file |
//! | [`page`] | a mission, a dry run or trials as a page for a browser |

pub mod compare;
pub mod history;
pub mod measured;
pub mod page;
#[cfg(test)]
mod test_records;
