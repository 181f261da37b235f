//! Options for commands that run drivers of robots in this process.

use std::time::Duration;

use downbeat_robot::driver::Timeouts;

use super::run::parse_span;
use crate::fleet::{Drivers, StartPrograms};

/// Timeouts of the programs that drive robots.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct DriverArgs {
    /// Time for a program to answer its first line, and for a program of version 2 to start its hardware.
    #[arg(long, value_parser = timeout, default_value = "10s", value_name = "TIME")]
    driver_start_timeout: Duration,
    /// Time for a program to answer any other line. After that, the hardware is treated as unavailable.
    #[arg(long, value_parser = timeout, default_value = "1s", value_name = "TIME")]
    driver_answer_timeout: Duration,
}

impl DriverArgs {
    pub(super) const fn timeouts(self) -> Timeouts {
        Timeouts { start: self.driver_start_timeout, answer: self.driver_answer_timeout }
    }

    pub(super) const fn of(self, programs: StartPrograms) -> Drivers {
        Drivers { programs, timeouts: self.timeouts() }
    }
}

fn timeout(text: &str) -> Result<Duration, String> {
    let time = parse_span(text)?.to_duration();
    let fits = time >= Duration::from_millis(10) && time <= Duration::from_secs(600);
    if fits { Ok(time) } else { Err("expected a time from 10ms to 600s".to_owned()) }
}
