use std::path::Path;

use super::*;
use crate::fleet::{Fleet, read_fleet};
use downbeat_yaml::finding::Severity;

const INIT: &str = r#"{"id": "arm", "api_version": "1", "devices": [
  {"id": "elbow", "latency": 25, "latency_spread": 2, "available_control_types": {"position": {"min_value": 0, "max_value": 90, "granularity": 1}}},
  {"id": "wrist", "available_control_types": {"position": {"min_value": 0, "max_value": 90, "granularity": 1}}},
  {"id": "angle", "available_control_types": {"sensor": {"min_value": 0, "max_value": 90}}}]}"#;

/// Reads a fleet of one arm with these additional keys, and with this latency file if one is given.
fn fleet(keys: &str, file: Option<&str>) -> (Option<Fleet>, Vec<Finding>) {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("arm.json", INIT);
    let named = file.map_or("", |_| "latency: latency.yaml\n");
    write("fleet.yaml", &format!("{named}robots:\n  arm: {{init: arm.json, address: sim{keys}}}\n"));
    file.iter().for_each(|text| write("latency.yaml", text));
    read_fleet(&folder.path().join("fleet.yaml"))
}

/// Returns the latency and spread of each device in milliseconds, each with its source.
#[track_caller]
fn latencies(keys: &str, file: Option<&str>) -> Vec<(String, f64, f64, LatencySource)> {
    let (fleet, findings) = fleet(keys, file);
    assert!(findings.iter().all(|finding| finding.severity == Severity::Warning), "{findings:?}");
    let latencies = fleet.unwrap().robots.remove(0).mission.latencies;
    let of = |(device, found): (DeviceId, DeviceLatency)| {
        let Latency { median, spread } = found.latency;
        (device.to_string(), median.as_millis_f64(), spread.as_millis_f64(), found.from)
    };
    latencies.into_iter().map(of).collect()
}

fn entry(device: &str, median: f64, spread: f64, from: LatencySource) -> (String, f64, f64, LatencySource) {
    (device.to_owned(), median, spread, from)
}

const FILE: &str = "latency: {arm: {elbow: {median: 30ms, spread: 1.5ms}}}";

#[test]
fn latency_in_fleet_overrides_file_and_file_overrides_robot() {
    use LatencySource::{File, Fleet, Robot};
    assert_eq!(latencies("", None), [entry("elbow", 25.0, 2.0, Robot)]);
    assert_eq!(latencies("", Some(FILE)), [entry("elbow", 30.0, 1.5, File)]);
    let own = ", latency: {wrist: {median: 41.2ms, spread: 3ms}}";
    assert_eq!(
        latencies(own, Some(FILE)),
        [entry("elbow", 30.0, 1.5, File), entry("wrist", 41.2, 3.0, Fleet)]
    );
    let all = [entry("elbow", 60.0, 0.0, Fleet), entry("wrist", 60.0, 0.0, Fleet)];
    assert_eq!(latencies(", latency: 60ms", Some(FILE)), all);
    assert_eq!(latencies(", latency: {elbow: 0ms}", Some(FILE)), [entry("elbow", 0.0, 0.0, Fleet)]);
}

#[track_caller]
fn check_refused(keys: &str, file: Option<&str>, (place, message): ((&str, usize, usize), &str)) {
    let (fleet, findings) = fleet(keys, file);
    assert!(fleet.is_none());
    let [finding] = findings.as_slice() else { panic!("{findings:?}") };
    let name = Path::new(&finding.file).file_name().and_then(|name| name.to_str());
    assert_eq!((name, finding.line, finding.column), (Some(place.0), place.1, place.2), "{finding:?}");
    assert!(finding.message.contains(message), "{finding:?}");
}

#[test]
fn invalid_latency_is_refused_at_its_position() {
    let negative = "latency:\n  arm:\n    elbow: {median: -3ms}\n";
    check_refused("", Some(negative), (("latency.yaml", 3, 21), "invalid time `-3ms`"));
    let long = "latency:\n  arm:\n    elbow: {median: 3ms, spread: 11s}\n";
    check_refused("", Some(long), (("latency.yaml", 3, 34), "a latency of 11 s is out of range"));
    check_refused(
        "",
        Some("latency:\n  arm:\n    elbow: {spread: 3ms}\n"),
        (("latency.yaml", 3, 12), "no `median`"),
    );
    check_refused("", Some("latency: [1"), (("latency.yaml", 1, 12), ""));
    check_refused(", latency: 11s", None, (("fleet.yaml", 2, 48), "a latency of 11 s is out of range"));
    check_refused(
        ", latency: {angle: 1ms}",
        None,
        (("fleet.yaml", 2, 49), "`angle` does not accept commands"),
    );
    check_refused(", latency: {elbwo: 1ms}", None, (("fleet.yaml", 2, 49), "no device `elbwo`"));
}

#[test]
fn latency_of_missing_robot_or_device_causes_a_warning() {
    let file = "latency:\n  arm:\n    elbwo: {median: 3ms}\n  leg: {knee: {median: 4ms}}\n";
    let (fleet, findings) = fleet("", Some(file));
    assert!(fleet.is_some());
    let told: Vec<_> =
        findings.iter().map(|finding| (finding.code, finding.line, finding.hint.clone())).collect();
    let hint = Some("did you mean `elbow`?".to_owned());
    assert_eq!(told, [(Code::StaleLatency, 3, hint), (Code::StaleLatency, 4, None)], "{findings:?}");
}

#[test]
fn written_latency_file_is_read_back() {
    let ms = Span::from_micros;
    let whole = MeasuredLatency {
        median: ms(41_200),
        spread: Some(ms(3_100)),
        p95: Some(ms(44_000)),
        trials: Some(20),
        measured: Some("2026-11-23T21:04:05Z".to_owned()),
        lag: Some(Lag { time_constant: ms(20_000), lags: 2, later: ms(-1_500) }),
        tracking_lag: Some(ms(35_000)),
    };
    let bare = MeasuredLatency { median: Span::ZERO, ..MeasuredLatency::default() };
    let arm: BTreeMap<DeviceId, _> =
        [("elbow", whole), ("a: \"b\"", bare)].map(|(id, of)| (id.parse().unwrap(), of)).into();
    let file: LatencyFile =
        [("arm-1".parse().unwrap(), arm), ("true".parse().unwrap(), BTreeMap::new())].into();
    let text = latency_text(&file);
    let line = "    elbow: {median: 41.2ms, spread: 3.1ms, p95: 44ms, trials: 20, \
                measured: \"2026-11-23T21:04:05Z\", time_constant: 20ms, lags: 2, later: -1.5ms, tracking_lag: 35ms}\n";
    assert!(text.contains(line), "{text}");
    for file in [file, LatencyFile::new()] {
        let source = Source { name: "latency.yaml".to_owned(), text: latency_text(&file) };
        assert_eq!(latency_file_of(&source).unwrap(), file);
    }
}
