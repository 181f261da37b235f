//! Reads Zenoh configurations, in the format of Zenoh's own files.

use std::fmt;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use ::zenoh::Config;
use serde_json::Value;

/// The reason why a network cannot be joined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The configuration cannot be read or used.
    #[error("{}: {why}; expected a Zenoh configuration, as in docs/zenoh.md", file.display())]
    File {
        /// Path of the file.
        file: PathBuf,
        /// The reason why the configuration cannot be used.
        why: String,
    },
    /// The Zenoh session could not be opened.
    #[error(
        "cannot join the Zenoh network of {named}: {why}; check `connect/endpoints` in the configuration, and that a router listens there"
    )]
    NotJoined {
        /// Name of the configuration for people: the path of its file, or `the configuration`.
        named: String,
        /// The error that Zenoh reports.
        why: String,
    },
    /// The system could not create a thread. Contains the system's error.
    #[error("cannot start a thread for Zenoh: {0}")]
    Thread(io::Error),
}

impl NetworkError {
    pub(super) fn not_joined(named: &str, why: impl fmt::Display) -> Self {
        Self::NotJoined { named: named.to_owned(), why: without_places(&why.to_string()) }
    }
}

/// Removes the positions in Zenoh's source code from one of Zenoh's error messages.
fn without_places(error: &str) -> String {
    let place_of = |part: &str| part.rfind(" at ").filter(|at| part[*at..].contains(".rs:"));
    let causes = error.split(" - Caused by ");
    let causes = causes.map(|part| part[..place_of(part).unwrap_or(part.len())].trim().trim_end_matches('!'));
    causes.collect::<Vec<_>>().join(": ")
}

pub(super) fn read(file: &Path) -> Result<Config, NetworkError> {
    let bad = |why: String| NetworkError::File { file: file.to_owned(), why };
    // Zenoh's own error contains neither the path nor the cause.
    std::fs::File::open(file).map_err(|error| bad(error.to_string()))?;
    let config = Config::from_file(file).map_err(|error| bad(error.to_string()))?;
    quiet(config).map_err(bad)
}

pub(super) fn parse(json5: &str) -> Result<Config, NetworkError> {
    let bad = |why: String| NetworkError::File { file: PathBuf::from("configuration"), why };
    let config = Config::from_json5(json5).map_err(|error| bad(error.to_string()))?;
    quiet(config).map_err(bad)
}

/// Returns an endpoint of this configuration that anyone may reach, because it is neither on this machine nor protected by TLS. `None` if
/// there is no such endpoint.
pub(super) fn open_endpoint(config: &Config) -> Option<String> {
    let said = |key: &str| -> Option<Value> { serde_json::from_str(&config.get_json(key).ok()?).ok() };
    let mode = said("mode").as_ref().and_then(Value::as_str).unwrap_or("peer").to_owned();
    let of_mode = |value: Value| match value {
        Value::Object(mut by_mode) => by_mode.remove(&mode).unwrap_or_default(),
        value => value,
    };
    let listens = if mode == "client" { None } else { said("listen/endpoints") };
    let endpoints = said("connect/endpoints").into_iter().chain(listens).map(of_mode);
    let endpoints = endpoints.flat_map(|list| list.as_array().cloned().unwrap_or_default());
    let mut named = endpoints.filter_map(|endpoint| endpoint.as_str().map(str::to_owned));
    named.find(|endpoint| is_open(endpoint))
}

/// Whether a process may open several sessions with this configuration. This is so if the configuration only connects, and sets no id.
pub(super) fn may_be_joined_again(config: &Config) -> bool {
    let said = |key: &str| config.get_json(key).unwrap_or_default();
    said("mode") == "\"client\"" && matches!(said("id").as_str(), "" | "null")
}

fn is_open(endpoint: &str) -> bool {
    let Some((protocol, rest)) = endpoint.split_once('/') else { return true };
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let is_here =
        host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.to_canonical().is_loopback());
    !is_here && !matches!(protocol, "tls" | "quic" | "unixsock-stream" | "unixpipe" | "serial" | "vsock")
}

/// Disables multicast, unless the configuration enables it. Without multicast, Zenoh finds only the members that the configuration names,
/// and joins no unknown network.
fn quiet(mut config: Config) -> Result<Config, String> {
    const ENABLED: &str = "scouting/multicast/enabled";
    let said = config.get_json(ENABLED).map_err(|error| error.to_string())?;
    if said == "null" {
        config.insert_json5(ENABLED, "false").map_err(|error| error.to_string())?;
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multicast_is_off_unless_enabled_in_the_file() {
        let enabled = |json5: &str| parse(json5).unwrap().get_json("scouting/multicast/enabled").unwrap();
        assert_eq!(enabled("{}"), "false");
        assert_eq!(enabled("{scouting: {multicast: {enabled: true}}}"), "true");
        assert_eq!(enabled("{scouting: {multicast: {enabled: false}}}"), "false");
    }

    #[test]
    fn zenoh_errors_are_reported_without_source_locations() {
        let said = "Unable to connect to any of [a]!  at /x/orchestrator.rs:447. - Caused by refused at /x/link.rs:9.";
        assert_eq!(without_places(said), "Unable to connect to any of [a]: refused");
        assert_eq!(without_places("no router available"), "no router available");
    }

    #[test]
    fn only_a_client_without_a_fixed_id_may_join_several_times() {
        let may = |json5: &str| may_be_joined_again(&parse(json5).unwrap());
        assert!(may(r#"{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}}"#));
        assert!(!may(r#"{mode: "client", id: "a1"}"#), "two members of one network have two ids");
        assert!(
            !may(r#"{mode: "peer", listen: {endpoints: ["tcp/127.0.0.1:7447"]}}"#),
            "a port is taken once"
        );
        assert!(!may("{}"), "a peer by default");
    }

    #[test]
    fn non_local_endpoint_without_tls_is_open() {
        let open = |json5: &str| open_endpoint(&parse(json5).unwrap());
        assert_eq!(open(r#"{mode: "client", connect: {endpoints: ["tls/router.example:7447"]}}"#), None);
        assert_eq!(
            open(r#"{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447", "tcp/[::1]:1"]}}"#),
            None
        );
        let beyond = r#"{mode: "client", connect: {endpoints: ["tcp/localhost:1", "tcp/192.0.2.7:7447"]}}"#;
        assert_eq!(open(beyond).as_deref(), Some("tcp/192.0.2.7:7447"));
        let listens = r#"{mode: "peer", listen: {endpoints: {router: [], peer: ["udp/0.0.0.0:7447"]}}}"#;
        assert_eq!(open(listens).as_deref(), Some("udp/0.0.0.0:7447"));
        assert!(open("{}").is_some(), "a peer listens everywhere by default");
    }

    #[test]
    fn error_for_an_unusable_file_names_the_file_and_the_reason() {
        let missing = read(Path::new("/nowhere/zenoh.json5")).unwrap_err().to_string();
        assert!(missing.contains("/nowhere/zenoh.json5: No such file"), "{missing}");
        let wrong = parse("{mode: 7}").unwrap_err().to_string();
        assert!(wrong.contains("expected a Zenoh configuration"), "{wrong}");
    }
}
