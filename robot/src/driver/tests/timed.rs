//! Tests scripts that the hardware times by itself: the driver receives them ahead of their steps, and the robot reports what the
//! hardware reports.

use super::*;

#[tokio::test]
async fn script_timed_by_the_driver_is_reported_as_the_driver_reports_it() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.script_in("arm", "a", 3_000.0, &[(0.0, 5.0), (300.0, 6.5)], ControlType::Position);
    let accepted = rig.response().await;
    rig.next_done(&["connect", "arm plan 5 6.5"]);
    let (started, ended) = (rig.response().await, rig.response().await);
    assert_eq!([&accepted, &started, &ended].map(|r| r.status.clone()), PLAYED);
    let took = ended.event_timestamp.unwrap() - started.event_timestamp.unwrap();
    assert_eq!(took, Span::from_millis(300), "exactly as the driver says");
    assert_eq!((ended.steps_done, ended.late_steps), (Some(2), Some(0)));
    assert_eq!(rig.stop(), ["wheel 0"]);
}

#[tokio::test]
async fn driver_that_times_scripts_ends_them_before_the_device_comes_to_rest() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.script_in("arm", "a", 60_000.0, &[(0.0, 5.0)], ControlType::Position);
    rig.responses(&PLAYED[..1]).await;
    rig.next_done(&["connect", "arm plan 5"]);
    assert_eq!(rig.stop(), ["arm cancel hold", "wheel 0"]);
}

#[tokio::test]
async fn script_refused_by_the_driver_fails_with_the_reason() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.bench.refuses.store(true, Ordering::SeqCst);
    rig.script_in("arm", "a", 60_000.0, &[(0.0, 5.0)], ControlType::Position);
    rig.responses(&PLAYED[..1]).await;
    let failed = rig.response().await;
    assert_eq!(failed.error.unwrap().message, "the hardware refused a script of `arm`: too hot");
}

/// A driver program that times scripts by itself, and logs each value with the time at which it is set, in nanoseconds. The value 66
/// makes it fail; 77 ends it.
const AHEAD: &str = r#"
import os, sys, time
from downbeat_driver import Driver

class Ahead(Driver):
    lookahead = 2_000 if sys.argv[2] == "horizon" else "script"

    def set(self, device, control_type, value, *more):
        if value == 66:
            raise RuntimeError("torque")
        with open(sys.argv[1], "a") as driven:
            driven.write(f"{time.time_ns()} {device} {value:g}\n")
        if value == 77:
            os._exit(3)

Ahead().run()
"#;

/// Starts a host with the program `AHEAD`. Also returns a link to the robot and the folder of the program's log. `None` if Python is
/// missing.
fn ahead(mode: &str) -> Option<(Host, RobotLink, std::path::PathBuf)> {
    use std::sync::atomic::AtomicU32;
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    std::process::Command::new(&python).arg("--version").output().ok()?;
    let name = format!("downbeat-ahead-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
    let folder = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("ahead.py"), AHEAD).unwrap();
    let package = concat!(env!("CARGO_MANIFEST_DIR"), "/drivers/python");
    let shown = folder.display();
    let command = format!(
        "PYTHONDONTWRITEBYTECODE=1 PYTHONPATH='{package}' {python} '{shown}/ahead.py' '{shown}/log' {mode}"
    );
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let answer = Duration::from_secs(60);
    let driver = Program::new(&command, &block).unwrap().within(Timeouts { start: answer, answer });
    let driver = Box::new(driver.borne_in_silence());
    let hosted = Hosted::driven(block, driver, DriverOptions::default()).tolerating(Tolerance::AN_HOUR);
    let host = Host::start(vec![hosted], HostOptions::default()).unwrap();
    host.await_hardware(Duration::from_secs(60));
    let link = host.handle().connect(0).unwrap();
    Some((host, link, folder))
}

/// Returns the logged lines of a program, with their times.
fn logged(folder: &std::path::Path) -> Vec<(i64, String)> {
    let text = std::fs::read_to_string(folder.join("log")).unwrap_or_default();
    let line = |line: &str| {
        let (at, what) = line.split_once(' ').unwrap();
        (at.parse().unwrap(), what.to_owned())
    };
    text.lines().map(line).collect()
}

async fn responses(link: &mut RobotLink, count: usize) -> Vec<ControlResponse> {
    let mut all = Vec::new();
    while all.len() < count {
        match link.recv().await {
            Some(LinkEvent::Message(Message::ControlResponse(response))) => all.push(response),
            other => panic!("{other:?}"),
        }
    }
    all
}

#[tokio::test]
async fn reports_of_a_program_that_times_scripts_agree_with_its_log() {
    // With a horizon, the driver receives the last step two seconds before the previous step is due.
    for (mode, apart) in [("script", 300.0), ("horizon", 2_000.0)] {
        let Some((host, mut link, folder)) = ahead(mode) else { return };
        let steps = [(0.0, 4.0), (apart, 5.0), (2.0 * apart, 6.0)];
        link.send(request("wheel", "wheel", Some(3_000.0), &steps, ControlType::Speed));
        let all = responses(&mut link, 3).await;
        let statuses: Vec<_> = all.iter().map(|response| response.status.clone()).collect();
        assert_eq!(statuses, PLAYED, "{mode}: {:?}", all[all.len() - 1].error);
        let log = logged(&folder);
        let values: Vec<_> = log.iter().map(|(_, what)| what.as_str()).collect();
        assert_eq!(values, ["wheel 4", "wheel 5", "wheel 6"]);
        let at = |index: usize| all[index].event_timestamp.unwrap().as_nanos();
        // The driver reports the start right before the first value, and the end right after the last value.
        assert!(at(1) <= log[0].0 && log[2].0 <= at(2), "{mode}: {all:?} {log:?}");
        assert!(host.stop().is_empty());
        let _left = std::fs::remove_dir_all(folder);
    }
}

#[tokio::test]
async fn script_fails_if_its_program_fails_in_a_step_or_dies() {
    for (value, why) in [(66.0, "the hardware failed in step 2: RuntimeError: torque"), (77.0, "has ended")] {
        let Some((host, mut link, folder)) = ahead("script") else { return };
        link.send(request(
            "arm",
            "arm",
            Some(3_000.0),
            &[(300.0, 4.0), (600.0, value), (900.0, 6.0)],
            ControlType::Position,
        ));
        let all = responses(&mut link, 3).await;
        let failed = all[2].error.as_ref().unwrap().message.to_string();
        assert!(all[1].status == Status::Started && failed.contains(why), "{all:?}");
        drop(host);
        assert!(!logged(&folder).iter().any(|(_, what)| what == "arm 6"));
        let _left = std::fs::remove_dir_all(folder);
    }
}

#[tokio::test]
async fn script_of_a_program_has_ended_when_its_stop_is_confirmed() {
    let Some((host, mut link, folder)) = ahead("script") else { return };
    // The script runs for a minute, so that the stop comes before its end.
    let mut steps: Vec<_> = (0..7_u32).map(|i| (f64::from(i) * 500.0, f64::from(i + 1))).collect();
    steps.push((60_000.0, 8.0));
    link.send(request("wheel", "wheel", Some(3_000.0), &steps, ControlType::Speed));
    responses(&mut link, 2).await;
    link.send(Message::ControlRequest(ControlRequest {
        request_id: Some(RequestId::new("stop").unwrap()),
        ..ControlRequest::immediate(DeviceId::new("wheel").unwrap(), Command::Script(Script::default()))
    }));
    let all = responses(&mut link, 2).await;
    assert_eq!([&all[0].status, &all[1].status], [&Status::Failed, &Status::Ok], "{all:?}");
    let log = logged(&folder);
    assert_eq!(log.last().unwrap().1, "wheel 0", "{log:?}");
    let steps_done = all[0].steps_done.unwrap() as usize;
    assert_eq!(log.len(), steps_done + 1, "{log:?} {all:?}");
    tokio::time::sleep(Duration::from_millis(700)).await;
    assert_eq!(logged(&folder).len(), log.len(), "it goes on");
    drop(host);
    let _left = std::fs::remove_dir_all(folder);
}
