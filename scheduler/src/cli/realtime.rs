//! `--realtime`: requests real-time scheduling for the thread that wakes this process's robots, and reports the scheduling that this
//! thread has obtained.

use clap::ValueEnum;
use downbeat_robot::realtime::Realtime;
use downbeat_robot::{Host, HostError};

use super::{Exit, Format, console};
use crate::fleet::EndpointError;

/// Options for the real-time scheduling of robots in this process.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct RealtimeArgs {
    /// Whether the robots of this process use real-time scheduling (SCHED_FIFO) and locked memory.
    #[arg(long, value_enum, default_value_t = RealtimeArg::Auto, value_name = "WHEN")]
    realtime: RealtimeArg,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RealtimeArg {
    /// Use it if it is permitted, and print the result.
    Auto,
    /// Do not request it.
    Off,
    /// End with exit code 2 if it is not permitted.
    Required,
}

impl RealtimeArgs {
    pub(super) const fn realtime(self) -> Realtime {
        match self.realtime {
            RealtimeArg::Auto => Realtime::Auto,
            RealtimeArg::Off => Realtime::Off,
            RealtimeArg::Required => Realtime::Required,
        }
    }

    /// Prints the scheduling that the host's robots have obtained. With JSON output, prints it only if it is less than requested.
    pub(super) fn tell(self, host: &Host, format: Format) {
        let scheduling = host.scheduling();
        let asked = self.realtime() != Realtime::Off;
        if asked && (format == Format::Text || scheduling.lacks_something()) {
            console::note(&format!("robots of this process: {scheduling}"));
        }
    }
}

/// Returns the exit code for an error that prevents the robots of this process from running.
pub(super) const fn exit_of(error: &EndpointError) -> Exit {
    match error {
        EndpointError::Host(HostError::Realtime(_)) => Exit::Usage,
        _ => Exit::Failed,
    }
}
