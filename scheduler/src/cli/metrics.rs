//! `--metrics`: serves an endpoint for Prometheus and for health checks while the command runs.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use downbeat_robot::Host;
use urrcp::RobotId;

use super::Format;
use crate::link::Endpoint;
use crate::run::watch::Watches;
use crate::server_clock::ServerClock;

/// The address of metrics.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct MetricsArgs {
    /// Serve metrics for Prometheus at http://ADDRESS/metrics, and health at /healthz and /readyz. ADDRESS is IP:PORT, or only a port, as
    /// in 9464, for clients on this machine.
    #[arg(long, value_name = "ADDRESS", value_parser = parse)]
    metrics: Option<SocketAddr>,
}

fn parse(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse().ok().map(|port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
    port.or_else(|| text.parse().ok()).ok_or_else(|| {
        "expected IP:PORT or a port of this machine, such as 9464, 127.0.0.1:9464 or [::]:9464".to_owned()
    })
}

/// The endpoint that was started for `--metrics`. Without the option, it has no effect.
#[derive(Default)]
pub(super) struct Metrics {
    #[cfg(feature = "metrics")]
    board: Option<crate::operations::Board>,
}

impl MetricsArgs {
    /// Starts the endpoint if the user has requested it. Must be called before anything moves.
    ///
    /// # Errors
    /// Fails if the process cannot listen on the address, or if this build does not support metrics.
    #[cfg(feature = "metrics")]
    pub(super) fn serve(self, format: Format) -> Result<Metrics, String> {
        let Some(address) = self.metrics else { return Ok(Metrics::default()) };
        let board = crate::operations::Board::default();
        let served = crate::operations::serve(address, board.clone());
        let address = served.map_err(|error| {
            let refusal = downbeat_scripts::Refusal::of(downbeat_scripts::Attempt::Listen, &error);
            format!("cannot serve metrics at {address}: {refusal}")
        })?;
        if format == Format::Text {
            super::console::note(&format!("metrics are served at http://{address}/metrics"));
        }
        Ok(Metrics { board: Some(board) })
    }

    /// Returns an error if the user has requested metrics, because this build does not support them.
    #[cfg(not(feature = "metrics"))]
    pub(super) fn serve(self, _: Format) -> Result<Metrics, String> {
        match self.metrics {
            None => Ok(Metrics::default()),
            Some(_) => Err("this program was built without metrics: leave out --metrics, install the Debian package, or build it \
                            with `cargo install downbeat --features metrics`"
                .to_owned()),
        }
    }
}

#[cfg_attr(
    not(feature = "metrics"),
    expect(clippy::unused_self, reason = "there is nothing to tell of without the feature")
)]
impl Metrics {
    /// Adds the metrics of a host's robots. `names` are their ids, in the host's order.
    pub(super) fn add_host(&self, host: &Host, names: Vec<RobotId>) {
        #[cfg(feature = "metrics")]
        if let Some(board) = &self.board {
            board.add(crate::operations::HostMetrics::of(host, names));
        }
        #[cfg(not(feature = "metrics"))]
        let _nothing_to_tell = (host, names);
    }

    /// Adds the metrics of a mission and its robots. `host` runs the robots that are in this process.
    pub(super) fn add_mission(
        &self,
        clock: ServerClock,
        ids: Vec<RobotId>,
        endpoints: &[Endpoint],
        host: Option<&Host>,
        watches: &mut Watches,
    ) {
        if let Some(host) = host {
            let in_process =
                ids.iter().zip(endpoints).filter(|(_, to)| matches!(to, Endpoint::InProcess { .. }));
            self.add_host(host, in_process.map(|(id, _)| id.clone()).collect());
        }
        #[cfg(feature = "metrics")]
        if let Some(board) = &self.board {
            let mission = crate::operations::MissionMetrics::new(clock, ids.into_iter());
            watches.add(mission.watch());
            board.add(mission);
        }
        #[cfg(not(feature = "metrics"))]
        let _nothing_to_tell = (clock, watches);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_without_host_means_localhost() {
        assert_eq!(parse("9464"), Ok("127.0.0.1:9464".parse().unwrap()));
        assert_eq!(parse("0.0.0.0:9464"), Ok("0.0.0.0:9464".parse().unwrap()));
        for wrong in ["", "70000", "localhost", "here:9464"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }
}
