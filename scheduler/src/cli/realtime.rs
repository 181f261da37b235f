//! `--realtime`: what the thread that wakes this process's robots asks the system for, and what it got.

use clap::ValueEnum;
use downbeat_robot::realtime::Realtime;
use downbeat_robot::{Host, HostError};

use super::{Exit, Format, console};
use crate::fleet::EndpointError;

/// Whether robots of this process run under real-time scheduling.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct RealtimeArgs {
    /// Whether the robots of this process use real-time scheduling (SCHED_FIFO) and locked memory.
    #[arg(long, value_enum, default_value_t = RealtimeArg::Auto, value_name = "WHEN")]
    realtime: RealtimeArg,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RealtimeArg {
    /// Use it if it is permitted, and say what was obtained.
    Auto,
    /// Do not ask for it.
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

    /// Says what the robots of this host got; for machines only that something is missing.
    pub(super) fn tell(self, host: &Host, format: Format) {
        let scheduling = host.scheduling();
        let asked = self.realtime() != Realtime::Off;
        if asked && (format == Format::Text || scheduling.lacks_something()) {
            console::note(&format!("robots of this process: {scheduling}"));
        }
    }
}

/// How the program ends where the robots of this process cannot be run.
pub(super) const fn exit_of(error: &EndpointError) -> Exit {
    match error {
        EndpointError::Host(HostError::Realtime(_)) => Exit::Usage,
        _ => Exit::Failed,
    }
}
