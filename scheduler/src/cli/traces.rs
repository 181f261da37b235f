//! Traces of a mission for OpenTelemetry, if this program has them and a collector is named.

use crate::run::watch::Watches;
use crate::server_clock::ServerClock;

/// The trace of a mission, if there is one.
#[derive(Default)]
pub(super) struct Traces {
    #[cfg(feature = "otel")]
    trace: Option<crate::operations::Trace>,
}

impl Traces {
    /// Begins the trace of a mission. Where none can be made, the mission plays without.
    #[cfg(feature = "otel")]
    pub(super) fn begin(scenario: &str, clock: ServerClock, watches: &mut Watches) -> Self {
        let begun = crate::operations::provider().and_then(|provider| {
            let begin =
                |provider| crate::operations::Trace::begin(provider, scenario.to_owned(), clock.now());
            provider.map(begin).transpose().map_err(|error| format!("cannot export traces: {error}"))
        });
        match begun {
            Ok(Some((trace, watch))) => {
                watches.add(watch);
                Self { trace: Some(trace) }
            }
            Ok(None) => Self::default(),
            Err(error) => {
                super::console::warn(&error);
                Self::default()
            }
        }
    }

    #[cfg(not(feature = "otel"))]
    pub(super) const fn begin(_: &str, _: ServerClock, _: &Watches) -> Self {
        Self {}
    }

    /// After the mission: exports what is left, for a while.
    pub(super) fn finish(self, watches: &mut Watches) {
        drop(std::mem::take(watches));
        #[cfg(feature = "otel")]
        if let Some(trace) = self.trace {
            trace.finish();
        }
    }
}
