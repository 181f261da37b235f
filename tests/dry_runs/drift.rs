//! Tests robots whose clocks drift while they play. The one true clock of the virtual world measures how far apart they are.

use serde_json::Value;

use stage::session::Session;

/// Ten minutes of nods, one per second: the number of repetitions, their period and the keyframes.
const NODS: (u32, &str, &str) = (600, "1s", "{at: 0s, to: 0}, {at: 250ms, to: 10}, {at: 750ms, to: 0}");

/// Ten minutes of movement back and forth without a pause: the number of repetitions, their period and the keyframes.
const SLIDES: (u32, &str, &str) = (300, "2s", "{at: 0s, to: 0}, {at: 1s, to: 10}, {at: 2s, to: 0}");

/// A single movement of ten minutes: the number of repetitions, their period and the keyframes.
const RIDE: (u32, &str, &str) = (1, "600s", "{at: 0s, to: 0}, {at: 600s, to: 600}");

/// Returns a cue in which the given robots repeat a movement.
fn cue(robots: &str, (times, every, keyframes): (u32, &str, &str)) -> String {
    format!(
        "  - {{at: 0s, robots: [{robots}], repeat: {{times: {times}, every: {every}}}, tracks: {{rail: [{keyframes}]}}}}\n"
    )
}

struct Rail {
    interpolation: &'static str,
    queue: u32,
    steps: u32,
    inquiry: bool,
}

const RAIL: Rail = Rail { interpolation: "linear", queue: 2, steps: 250, inquiry: true };

/// Returns a session with two robots whose clocks drift by 20 ppm in opposite directions. The scheduler measures these clocks.
fn fleet(rail: &Rail) -> Session {
    let Rail { interpolation, queue, steps, inquiry } = rail;
    let init = |id: &str| {
        format!(
            "id: {id}\napi_version: \"1\"\nreports: true\ninquiry: {inquiry}\ndevices:
  - id: rail
    name: rail
    interpolation: {interpolation}
    script_queue: {queue}
    available_control_types:
      position: {{min_value: -2000, max_value: 2000, granularity: 0.1, max_error: 0.5}}
      script: {{min_value: -2000, max_value: 2000, granularity: 0.1, max_error: 0.5, max_number_of_steps: {steps}}}\n"
        )
    };
    let robot = |id: &str, offset: &str, drift: &str| {
        format!(
            "  {id}: {{init: {id}.yaml, address: sim, clock: measured, \
             simulate: {{clock_offset: {offset}, drift: {drift}, ntp_error: none}}}}\n"
        )
    };
    let robots = robot("one", "50ms", "20ppm") + &robot("two", "-20ms", "-20ppm");
    let session = Session::new();
    session.file("one.yaml", init("one")).file("two.yaml", init("two"));
    session.file("fleet.yaml", format!("robots:\n{robots}"));
    session
}

fn played(cues: &str, rail: &Rail) -> (i32, Value) {
    let session = fleet(rail);
    session.file("show.yaml", format!("scenario: ten minutes\ncues:\n{cues}"));
    let ran = session.run(&["dry-run", "show.yaml", "--format", "json"]);
    (ran.code(), ran.json())
}

/// Returns the larger of two true spreads, in milliseconds: that of the starts and that of the last steps.
fn spread(report: &Value) -> f64 {
    let of = |key: &str| report[key].as_f64().unwrap_or_else(|| unreachable!("no {key}: {report}"));
    of("true_spread_ms").max(of("true_end_spread_ms"))
}

#[test]
fn robots_with_measured_clocks_stay_in_sync_for_ten_minutes() {
    for rail in [
        RAIL,
        Rail { inquiry: false, ..RAIL },
        Rail { interpolation: "hold", ..RAIL },
        Rail { queue: 8, ..RAIL },
        // All steps fit into one script.
        Rail { steps: 5_000, ..RAIL },
    ] {
        let (code, report) = played(&cue("one, two", NODS), &rail);
        let Rail { interpolation, queue, steps, inquiry } = rail;
        let what = format!("{interpolation}, queue {queue}, {steps} steps, inquiry {inquiry}");
        assert_eq!((code, &report["outcome"]), (0, &"done".into()), "{what}");
        assert!(spread(&report) < 2.5, "{what}: {} ms", spread(&report));
    }
}

/// Returns the time in milliseconds by which the robots are apart according to the report. Checks that the mission was out of tolerance.
fn out_of_tolerance((code, report): &(i32, Value)) -> f64 {
    assert_eq!(*code, 6, "{report}");
    report["outcome"]["out_of_tolerance"]["spread_ms"].as_f64().unwrap()
}

#[test]
fn mission_with_clock_drift_beyond_tolerance_is_not_reported_done() {
    // The device holds one script, so drift cannot be corrected.
    let played = played(&cue("one, two", NODS), &Rail { queue: 1, steps: 5_000, ..RAIL });
    let (told, true_spread) = (out_of_tolerance(&played), spread(&played.1));
    assert!((23.5..24.1).contains(&true_spread), "{true_spread} ms");
    assert!((true_spread - 1.0..true_spread).contains(&told), "{told} ms of {true_spread} ms");
}

#[test]
fn robots_stay_in_sync_for_ten_minutes_without_rests() {
    for movement in [SLIDES, RIDE] {
        let (code, report) = played(&cue("one, two", movement), &RAIL);
        assert_eq!((code, &report["outcome"]), (0, &"done".into()), "{movement:?}");
        assert!(spread(&report) < 2.5, "{movement:?}: {} ms", spread(&report));
    }
}

#[test]
fn small_tolerance_shortens_scripts_for_robots_with_measured_clocks() {
    let session = fleet(&RAIL);
    let scripts = |tolerance: &str| {
        session.file(
            "show.yaml",
            format!("scenario: s\nstart_tolerance: {tolerance}\ncues:\n{}", cue("one", RIDE)),
        );
        let plan = session.run(&["plan", "show.yaml", "--format", "json"]).json();
        plan["acts"][0]["robots"]["one"].as_array().map(Vec::len)
    };
    assert_eq!((scripts("60ms"), scripts("3ms")), (Some(20), Some(60)));
}

#[test]
fn finished_robot_is_judged_by_its_clock_at_its_end() {
    let (_, every, nod) = NODS;
    let cues = cue("one", (5, every, nod)) + &cue("two", NODS);
    let (code, report) = played(&cues, &RAIL);
    assert_eq!((code, &report["outcome"]), (0, &"done".into()));
    assert!(spread(&report) < 2.5, "{} ms", spread(&report));
}
