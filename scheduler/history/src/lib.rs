//! Missions that were played, as their journals and recordings tell them.
//!
//! | module | |
//! |---|---|
//! | [`history`] | reads a journal or a recording |
//! | [`compare`] | the differences between two plans or two missions |
//! | [`measured`] | the network and the clocks of a recording, as a world file |
//! | [`page`] | a mission, a dry run or trials as a page for a browser |

pub mod compare;
pub mod history;
pub mod measured;
pub mod page;
