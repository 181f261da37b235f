//! `--traces`: sends the mission as an OpenTelemetry trace to a collector.

use crate::mission::Mission;
use crate::run::watch::Watches;
use crate::server_clock::ServerClock;

/// The destination of traces.
#[derive(Clone, Debug, Default, clap::Args)]
pub(super) struct TracesArgs {
    /// Send the mission as an OpenTelemetry trace, by OTLP over HTTP, to the collector at URL, such as http://localhost:4318.
    #[arg(long, value_name = "URL", value_parser = parse)]
    traces: Option<String>,
}

fn parse(text: &str) -> Result<String, String> {
    let rest = text.strip_prefix("http://").map(|rest| rest.trim_end_matches('/'));
    let is_there = rest.is_some_and(|rest| !rest.is_empty() && !rest.contains(char::is_whitespace));
    is_there.then(|| text.to_owned()).ok_or_else(|| {
        "expected http://HOST:PORT of a collector, such as http://localhost:4318; to reach a remote collector, run one on this machine that forwards to it"
            .to_owned()
    })
}

/// The connection to the collector that `--traces` names. Without the option, it has no effect.
#[derive(Debug, Default)]
pub(super) struct Traces {
    #[cfg(feature = "traces")]
    to: Option<crate::operations::Traces>,
}

impl TracesArgs {
    /// Prepares the connection to the collector if the user has requested traces.
    ///
    /// # Errors
    /// Fails if the URL is invalid, or if this build does not support traces.
    #[cfg(feature = "traces")]
    pub(super) fn open(&self) -> Result<Traces, String> {
        let to = self.traces.as_ref().map(|url| {
            crate::operations::Traces::to(url)
                .map_err(|error| format!("cannot send traces to {url}: {error}"))
        });
        Ok(Traces { to: to.transpose()? })
    }

    /// Returns an error if the user has requested traces, because this build does not support them.
    #[cfg(not(feature = "traces"))]
    pub(super) fn open(&self) -> Result<Traces, String> {
        match self.traces {
            None => Ok(Traces::default()),
            Some(_) => Err("this program was built without traces: leave out --traces, or build it with \
                            `cargo install downbeat --features traces`"
                .to_owned()),
        }
    }
}

#[cfg_attr(
    not(feature = "traces"),
    expect(clippy::unused_self, reason = "there is nothing to tell of without the feature")
)]
impl Traces {
    /// Adds a mission to the trace.
    pub(super) fn add_mission(&self, clock: ServerClock, mission: &Mission, watches: &mut Watches) {
        #[cfg(feature = "traces")]
        if let Some(to) = &self.to {
            let about = crate::operations::About {
                scenario: mission.choreography().scenario.clone(),
                session: mission.options().session_name().map(ToString::to_string),
                robots: mission.robot_ids().len(),
            };
            watches.add(to.watch(clock.now(), about));
        }
        #[cfg(not(feature = "traces"))]
        let _nothing_to_tell = (clock, mission, watches);
    }

    /// Sends the remaining spans, for at most a few seconds. Must be called after the mission is over.
    pub(super) fn end(self) {
        #[cfg(feature = "traces")]
        if let Some(Err(error)) = self.to.map(crate::operations::Traces::end) {
            super::console::warn(&format!("the trace is incomplete: {error}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn collector_url_must_be_plain_http() {
        for url in ["http://localhost:4318", "http://[::1]:4318/", "http://10.0.0.7:4318/otlp"] {
            assert_eq!(parse(url), Ok(url.to_owned()));
        }
        for wrong in ["", "localhost:4318", "https://collector:4318", "http://", "http:///", "http://a b"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
