//! Plans, reports and fleets for people: text, tables, charts, graphs and pictures.

mod busy;
mod course;
pub mod gantt;
pub mod graph;
pub mod local;
pub mod picture;
mod reading;
mod required;
mod ruler;
pub mod table;
mod text;
mod trials;
mod wait;

pub use course::course_lines;
pub use required::requirements_table;
pub use text::report_text;
pub use text::{
    TAKEN_OVER, UNBOUNDED, choreography_figures, ending_text, latencies_text, main_duration, plan_table,
    preflight_table,
};
pub use trials::trials_text;
pub use wait::waits;
