//! Plans, reports and fleets for people: text, tables, charts, graphs and pictures.

mod busy;
mod course;
pub(crate) mod gantt;
pub(crate) mod graph;
pub(crate) mod local;
pub mod picture;
mod reading;
mod required;
mod ruler;
pub(crate) mod table;
mod text;
mod trials;
mod wait;

pub(crate) use course::course_lines;
pub(crate) use required::requirements_table;
pub use text::report_text;
pub(crate) use text::{
    TAKEN_OVER, UNBOUNDED, choreography_figures, ending_text, latencies_text, main_duration, plan_table,
    preflight_table,
};
pub use trials::trials_text;
pub(crate) use wait::waits;
