//! Shows plans, reports and fleets to people, as text, tables, charts, graphs and pictures.

mod brief;
mod busy;
mod course;
pub mod cue_sheet;
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

pub use brief::{preflight_warnings, rounded};
pub use course::course_lines;
pub use required::requirements_table;
pub use text::{
    Detail, PreflightDetails, TAKEN_OVER, UNBOUNDED, choreography_figures, ending_text, latencies_text,
    main_duration, plan_table, preflight_table, report_text,
};
pub use trials::trials_text;
pub use wait::waits;
