//! Drivers under their thread: what reaches the hardware, in which order, and what does when it fails.

mod thread;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use urrcp::{
    Command, ControlRequest, ControlResponse, ErrorCode, InitializationBlock, Message, Millis, RequestId,
    Script, Server, Span, Status, StatusValue, Step, Timestamp,
};

use super::*;
use crate::hardware::STALE;
use crate::host::tests::LogFile;
use crate::plans::PlanEvent;
use crate::{Host, HostOptions, Hosted, LinkEvent, RobotLink};

const BLOCK: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "default_value": 3, "interpolation": "linear", "script_queue": 2,
   "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 8}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 8}}},
  {"id": "eye", "name": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}}]}"#;

/// Slows down as it can.
const LIFT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "lift", "name": "lift", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "acceleration": {"min_value": -400, "max_value": 400, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 8,
                "control_types": ["position"]}}}]}"#;

/// Like `LIFT`, but takes longer to come to rest than an edge waits. Its wheel needs half a second.
const HEAVY: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "lift", "name": "lift", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "acceleration": {"min_value": -1, "max_value": 1, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 8,
                "control_types": ["position"]}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "acceleration": {"min_value": -20, "max_value": 20, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 1000,
                "control_types": ["speed"]}}}]}"#;

/// Hardware of a test: tells what is done with it, and does what the test says.
#[derive(Default)]
struct Bench {
    broken: AtomicBool,
    /// It takes no value.
    refuses: AtomicBool,
    panics: AtomicBool,
    takes_ramps: bool,
    /// Until a test lets it, a `set` does not return.
    busy: AtomicBool,
    line: Option<std::os::unix::net::UnixStream>,
    /// It times the scripts of the arm by itself.
    times_scripts: bool,
}

struct Fake {
    bench: Arc<Bench>,
    done: Sender<String>,
    pushes: Option<Pushes>,
}

impl Fake {
    fn act(&self, what: String) -> Result<(), DriverError> {
        if self.bench.broken.load(Ordering::SeqCst) {
            return Err(DriverError::Away("pulled out".to_owned()));
        }
        assert!(!self.bench.panics.load(Ordering::SeqCst), "a fault of the driver itself");
        let _test_is_over = self.done.send(what);
        Ok(())
    }
}

impl Driver for Fake {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.act("connect".to_owned())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        if self.bench.refuses.load(Ordering::SeqCst) {
            return Err(DriverError::Refused("too hot".to_owned()));
        }
        self.act(format!("{device} {}", setpoint.value))?;
        while self.bench.busy.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
        Ok(())
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        self.act(format!("read {sensor}")).map(|()| 7.0)
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        self.act("ping".to_owned())
    }

    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        self.act(format!("{device} ramp to {}", ramp.to))
    }

    fn takes_ramps(&self) -> bool {
        self.bench.takes_ramps
    }

    fn lookahead(&self) -> BTreeMap<DeviceId, Lookahead> {
        let arm = self.bench.times_scripts.then(|| (DeviceId::new("arm").unwrap(), Lookahead::Script));
        arm.into_iter().collect()
    }

    /// Begins on time, and is done when it has to be.
    #[expect(clippy::disallowed_methods, reason = "hardware takes its time")]
    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        if self.bench.refuses.load(Ordering::SeqCst) {
            return Err(DriverError::Refused("too hot".to_owned()));
        }
        let values: Vec<_> = part.steps.iter().map(|step| step.setpoint.value.to_string()).collect();
        self.act(format!("{} plan {}", part.device, values.join(" ")))?;
        let (plan, pushes) = (part.plan, self.pushes.clone().unwrap());
        let (start, end) = (part.start, part.steps.last().unwrap().at);
        // Ends with what it has to say.
        std::thread::spawn(move || {
            for (at, event) in [(start, PlanEvent::Began), (end, PlanEvent::Done)] {
                let left = at.assume_clock() - HostClock::anchored().now();
                std::thread::sleep(left.to_duration());
                pushes.plan(plan, at, event);
            }
        });
        Ok(())
    }

    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), DriverError> {
        self.act(format!("{} cancel {}", cancel.device, cancel.then.as_str()))
    }

    fn take_pushes(&mut self, pushes: Pushes) {
        self.pushes = Some(pushes);
    }

    fn lifeline(&self) -> Option<Lifeline> {
        Lifeline::of(self.bench.line.as_ref()?, "the line was cut")
    }
}

/// A robot on a host, with its hardware and a link.
struct Rig {
    bench: Arc<Bench>,
    done: Receiver<String>,
    host: Host,
    link: RobotLink,
}

impl Rig {
    fn new(bench: Bench, options: DriverOptions) -> Self {
        Self::of(BLOCK, bench, options)
    }

    fn of(block: &str, bench: Bench, options: DriverOptions) -> Self {
        Self::on(HostOptions::default(), block, bench, options)
    }

    fn on(host: HostOptions, block: &str, bench: Bench, options: DriverOptions) -> Self {
        let bench = Arc::new(bench);
        let (done, seen) = channel();
        let block: InitializationBlock = serde_json::from_str(block).unwrap();
        let fake = Fake { bench: Arc::clone(&bench), done, pushes: None };
        let hosted = Hosted::driven(block, Box::new(fake), options);
        let host = Host::start(vec![hosted], host).unwrap();
        host.await_hardware(Duration::from_secs(60));
        let link = host.handle().connect(0).unwrap();
        Self { bench, done: seen, host, link }
    }

    fn script(&self, device: &str, id: &str, steps: &[(f64, f64)], control_type: ControlType) {
        self.script_in(device, id, 200.0, steps, control_type);
    }

    /// Sends a script that starts this many milliseconds from now.
    fn script_in(&self, device: &str, id: &str, lead: f64, steps: &[(f64, f64)], control_type: ControlType) {
        let step = |(millis, value): &(f64, f64)| Step {
            offset: Millis::new(*millis).unwrap(),
            setpoint: Setpoint::new(control_type, *value),
            stop_condition: None,
        };
        let script = Script::new(steps.iter().map(step).collect()).unwrap();
        let now: Timestamp<Server> = HostClock::anchored().now().assume_clock();
        self.link.send(Message::ControlRequest(ControlRequest {
            timestamp: Some(now),
            time_offset_to_start: Some(Millis::new(lead).unwrap()),
            request_id: Some(RequestId::new(id).unwrap()),
            ..ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::Script(script))
        }));
    }

    async fn response(&mut self) -> ControlResponse {
        match self.link.recv().await {
            Some(LinkEvent::Message(Message::ControlResponse(response))) => response,
            other => panic!("{other:?}"),
        }
    }

    async fn responses(&mut self, expected: &[Status]) {
        for status in expected {
            assert_eq!(self.response().await.status, *status);
        }
    }

    /// What is done with the hardware next, pings aside.
    #[track_caller]
    fn next_done(&self, expected: &[&str]) {
        for expected in expected {
            let next = || self.done.recv_timeout(Duration::from_secs(60)).unwrap();
            let done = std::iter::repeat_with(next).find(|what| what != "ping");
            assert_eq!(done.as_deref(), Some(*expected));
        }
    }

    /// What was done with the hardware up to its end, pings aside.
    fn stop(self) -> Vec<String> {
        self.stop_and_tell().0
    }

    /// And why it may not be at rest.
    fn stop_and_tell(self) -> (Vec<String>, Option<String>) {
        let Self { host, done, link, .. } = self;
        drop(link);
        let not_at_rest = host.stop().pop().map(|robot| robot.reason);
        (done.try_iter().filter(|what| what != "ping").collect(), not_at_rest)
    }
}

/// Of a driver that is told one value after another.
const MANNERS: mailbox::Manners =
    mailbox::Manners { acknowledges: false, takes_frames: false, ping_period: Duration::from_millis(25) };

const PLAYED: [Status; 3] = [Status::Accepted, Status::Started, Status::Ok];

#[tokio::test]
async fn values_reach_the_hardware_in_order_and_in_the_end_the_default_state() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (300.0, -4.0), (600.0, 2.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let (done, not_at_rest) = rig.stop_and_tell();
    assert_eq!(done, ["connect", "wheel 4", "wheel -4", "wheel 2", "arm 3", "wheel 0"]);
    assert_eq!(not_at_rest, None);
}

#[tokio::test]
async fn what_is_set_on_hardware_is_in_the_log() {
    let log = LogFile::new("edge");
    let options = HostOptions::default().with_log(log.0.clone());
    let mut rig = Rig::on(options, BLOCK, Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (20.0, -4.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let _done = rig.stop();
    let steps: Vec<_> =
        log.lines().iter().filter(|line| line["step"].is_u64()).map(|line| line["value"].clone()).collect();
    assert_eq!(steps, [4.0, -4.0]);
}

#[tokio::test]
async fn hardware_that_was_only_looked_at_is_not_moved() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.link.send(Message::ControlRequest(ControlRequest::immediate(
        DeviceId::new("eye").unwrap(),
        Command::ReadSensor,
    )));
    assert_eq!(rig.response().await.status_value, StatusValue::Number(7.0));
    // Nor does anybody wonder where it is once it has gone.
    rig.bench.broken.store(true, Ordering::SeqCst);
    let (done, not_at_rest) = rig.stop_and_tell();
    assert_eq!((done, not_at_rest), (vec!["connect".to_owned(), "read eye".to_owned()], None));
}

#[tokio::test]
async fn an_edge_of_its_own_brings_its_devices_to_rest_when_it_finds_them() {
    let options = DriverOptions { at_start: AtStart::Default, ..DriverOptions::default() };
    let rig = Rig::new(Bench::default(), options);
    rig.next_done(&["connect", "arm 3", "wheel 0"]);
}

#[tokio::test]
async fn a_linear_movement_is_sampled_on_the_grid_and_ends_on_its_target() {
    let options = DriverOptions { samples_per_second: Some(200.0), ..DriverOptions::default() };
    let mut rig = Rig::new(Bench::default(), options);
    rig.script("arm", "a", &[(600.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    let end = done.iter().rposition(|what| what == "arm 30").unwrap();
    let values: Vec<f64> =
        done[1..=end].iter().map(|what| what.strip_prefix("arm ").unwrap().parse().unwrap()).collect();
    assert!(values.len() > 3, "no samples: {values:?}");
    assert!(values.is_sorted(), "{values:?}");
    assert!(values.iter().all(|value| (value * 2.0).fract() == 0.0), "off the grid: {values:?}");
    assert_eq!(&done[end + 1..], ["arm 3", "wheel 0"]);
}

#[tokio::test]
async fn the_second_sample_of_a_movement_comes_one_period_after_its_first() {
    let options = DriverOptions { samples_per_second: Some(2.0), ..DriverOptions::default() };
    let mut rig = Rig::new(Bench::default(), options);
    rig.script("arm", "a", &[(1_000.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    let values = done.iter().filter_map(|what| what.strip_prefix("arm ")?.parse::<f64>().ok());
    let on_the_way: Vec<f64> = values.filter(|value| (10.0..29.0).contains(value)).collect();
    assert_eq!(on_the_way.len(), 1, "{done:?}");
}

#[tokio::test]
async fn an_edge_that_ends_lets_its_devices_slow_down_to_their_default_state() {
    // It would take ramps, but this way is none.
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let mut rig = Rig::of(LIFT, bench, DriverOptions::default());
    rig.script("lift", "a", &[(1_000.0, 90.0), (60_000.0, 90.0)], ControlType::Position);
    rig.responses(&PLAYED[..2]).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    let values: Vec<f64> =
        rig.stop().iter().filter_map(|what| what.strip_prefix("lift ")?.parse().ok()).collect();
    // On for a little, then down, the acceleration (always 0) among them.
    let top = values.iter().copied().fold(0.0, f64::max);
    let down: Vec<f64> =
        values.iter().copied().skip_while(|value| *value < top).filter(|v| *v > 0.0).collect();
    assert!(top > 5.0 && down.len() > 3, "no way down: {values:?}");
    assert!(down.is_sorted_by(|a, b| a >= b), "{values:?}");
    assert_eq!(values.last(), Some(&0.0), "{values:?}");
}

#[tokio::test]
async fn a_driver_that_moves_linearly_by_itself_is_told_the_whole_way() {
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let mut rig = Rig::new(bench, DriverOptions::default());
    rig.script("arm", "a", &[(0.0, 3.0), (400.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    let done = rig.stop();
    assert_eq!(done, ["connect", "arm 3", "arm ramp to 30", "arm 30", "arm 3", "wheel 0"]);
}

#[tokio::test]
async fn an_edge_that_ends_stays_until_a_way_that_the_driver_goes_by_itself_is_over() {
    let bench = Bench { takes_ramps: true, ..Bench::default() };
    let mut rig = Rig::of(HEAVY, bench, DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 10.0), (60_000.0, 10.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 10"]);
    let begin = HostClock::anchored().now();
    let mut done = rig.stop();
    let took = HostClock::anchored().now() - begin;
    done.retain(|what| what.starts_with("wheel"));
    // The acceleration goes to 0 at once, the speed in the end.
    assert_eq!(done, ["wheel ramp to 0", "wheel 0", "wheel 0"]);
    assert!(took >= Span::from_millis(450), "ended {took} after it had begun to slow down for 500 ms");
}

#[tokio::test]
async fn a_position_that_takes_too_long_to_rest_stays_where_it_is_and_does_not_jump() {
    let mut rig = Rig::of(HEAVY, Bench::default(), DriverOptions::default());
    rig.script("lift", "a", &[(4_000.0, 20.0), (60_000.0, 20.0)], ControlType::Position);
    rig.responses(&PLAYED[..2]).await;
    tokio::time::sleep(Duration::from_millis(600)).await;
    let (done, not_at_rest) = rig.stop_and_tell();
    assert!(not_at_rest.unwrap().contains("`lift` was still on its way"));
    let values: Vec<f64> = done.iter().filter_map(|what| what.strip_prefix("lift ")?.parse().ok()).collect();
    assert!(values.iter().any(|value| *value > 2.0), "{values:?}");
    assert_ne!(values.last(), Some(&0.0), "{values:?}");
}

#[tokio::test]
async fn the_hardware_is_asked_for_a_sign_of_life_however_close_the_steps_are() {
    let mut rig = Rig::of(HEAVY, Bench::default(), DriverOptions::default());
    let steps: Vec<_> = (0..700_u32).map(|i| (f64::from(i) * 5.0, f64::from(i % 2 + 1))).collect();
    rig.script("wheel", "a", &steps, ControlType::Speed);
    rig.responses(&PLAYED).await;
    let done: Vec<String> = rig.done.try_iter().collect();
    let mut played = done.iter().skip_while(|what| !what.starts_with("wheel"));
    assert!(played.any(|what| what == "ping"), "no ping in {} values", done.len());
}

#[tokio::test]
async fn a_slow_device_skips_what_is_out_of_date_and_the_machine_does_not_wait() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.bench.busy.store(true, Ordering::SeqCst);
    let steps: Vec<_> = (0..8_u32).map(|i| (f64::from(i) * 10.0, f64::from(i))).collect();
    rig.script("wheel", "a", &steps, ControlType::Speed);
    // The machine goes on while the first value still hangs in the driver, but does not tell that all is done.
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 0"]);
    let early = tokio::time::timeout(Duration::from_millis(150), rig.response()).await;
    assert!(early.is_err(), "told before the hardware has it: {early:?}");
    rig.bench.busy.store(false, Ordering::SeqCst);
    rig.next_done(&["wheel 7"]);
    rig.responses(&PLAYED[2..]).await;
}

#[tokio::test]
async fn a_value_that_waited_too_long_for_the_hardware_is_not_set_and_its_script_fails_as_late() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.bench.busy.store(true, Ordering::SeqCst);
    rig.script("wheel", "a", &[(0.0, 4.0), (50.0, 6.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    tokio::time::sleep(2 * STALE).await;
    rig.bench.busy.store(false, Ordering::SeqCst);
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Late);
    rig.next_done(&["wheel 0"]);
}

#[tokio::test]
async fn hardware_that_hangs_up_while_nothing_is_asked_is_away_before_the_next_ping() {
    let (hangs_up, line) = std::os::unix::net::UnixStream::pair().unwrap();
    let bench = Bench { line: Some(line), ..Bench::default() };
    let mut rig = Rig::new(bench, DriverOptions::default());
    rig.script_in("wheel", "a", 60_000.0, &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED[..1]).await;
    drop(hangs_up);
    let error = rig.response().await.error.unwrap();
    assert_eq!(error.message, "the hardware is away: the line was cut");
}

#[tokio::test]
async fn hardware_that_fails_under_a_script_fails_it_and_starts_again_from_its_default_state() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.broken.store(true, Ordering::SeqCst);
    // Found out by a ping, since nothing more is due.
    let failed = rig.response().await;
    assert_eq!(failed.status, Status::Failed);
    let error = failed.error.unwrap();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(error.message.contains("pulled out"), "{error}");
    rig.script("wheel", "b", &[(0.0, 5.0)], ControlType::Speed);
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Internal);
    rig.bench.broken.store(false, Ordering::SeqCst);
    rig.next_done(&["connect", "arm 3", "wheel 0"]);
    rig.script("wheel", "c", &[(0.0, 5.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
}

#[tokio::test]
async fn hardware_that_fails_in_the_last_value_of_a_script_leaves_its_end_unknown() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.bench.busy.store(true, Ordering::SeqCst);
    rig.script("wheel", "a", &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.broken.store(true, Ordering::SeqCst);
    rig.bench.busy.store(false, Ordering::SeqCst);
    let error = rig.response().await.error.unwrap();
    let expected = "it is unknown whether the hardware took the last value: the hardware is away: pulled out";
    assert_eq!((error.code, error.message.as_str()), (ErrorCode::Internal, expected));
}

#[tokio::test]
async fn a_stop_is_confirmed_once_the_hardware_has_taken_it() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.busy.store(true, Ordering::SeqCst);
    let wheel = DeviceId::new("wheel").unwrap();
    let stop = Command::Script(Script::new(Vec::new()).unwrap());
    rig.link.send(Message::ControlRequest(ControlRequest::immediate(wheel, stop)));
    assert_eq!(rig.response().await.error.unwrap().code, ErrorCode::Cancelled);
    rig.next_done(&["wheel 0"]);
    let early = tokio::time::timeout(Duration::from_millis(150), rig.response()).await;
    assert!(early.is_err(), "told before the hardware has it: {early:?}");
    rig.bench.busy.store(false, Ordering::SeqCst);
    rig.responses(&PLAYED[2..]).await;
}

#[tokio::test]
async fn a_value_that_the_hardware_refuses_reads_as_refused_and_not_as_away() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (300.0, 8.0), (60_000.0, 0.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.refuses.store(true, Ordering::SeqCst);
    let error = rig.response().await.error.unwrap();
    assert_eq!(error.message, "the hardware refused speed 8 of `wheel`: too hot");
}

#[tokio::test]
async fn hardware_that_cannot_be_brought_to_rest_is_named_when_its_host_ends() {
    for noticed in [false, true] {
        let mut rig = Rig::new(Bench::default(), DriverOptions::default());
        rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
        rig.responses(&PLAYED[..2]).await;
        rig.next_done(&["connect", "wheel 4"]);
        rig.bench.broken.store(true, Ordering::SeqCst);
        if noticed {
            assert_eq!(rig.response().await.status, Status::Failed);
        }
        let (_, not_at_rest) = rig.stop_and_tell();
        assert_eq!(not_at_rest.as_deref(), Some("the hardware is away: pulled out"));
    }
}

#[tokio::test]
async fn the_last_values_are_followed_by_a_question_so_that_they_are_known_to_be_taken() {
    let options = DriverOptions { at_start: AtStart::Default, ..DriverOptions::default() };
    let rig = Rig::new(Bench::default(), options);
    rig.next_done(&["connect", "arm 3", "wheel 0"]);
    let Rig { host, done, link, .. } = rig;
    drop(link);
    assert_eq!(host.stop(), []);
    assert_eq!(done.iter().last().as_deref(), Some("ping"));
}

#[tokio::test]
async fn a_driver_that_panics_fails_what_runs_and_leaves_the_host_alone() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    rig.next_done(&["connect", "wheel 4"]);
    rig.bench.panics.store(true, Ordering::SeqCst);
    let failed = rig.response().await;
    assert!(failed.error.unwrap().message.contains("its driver panicked"));
    let told = (vec![], Some("its driver panicked".to_owned()));
    assert_eq!(rig.stop_and_tell(), told);
}

#[tokio::test]
async fn a_script_that_the_driver_times_is_handed_over_and_told_as_the_driver_says() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.script_in("arm", "a", 400.0, &[(0.0, 5.0), (300.0, 6.5)], ControlType::Position);
    let accepted = rig.response().await;
    rig.next_done(&["connect", "arm plan 5 6.5"]);
    let (started, ended) = (rig.response().await, rig.response().await);
    assert_eq!([&accepted, &started, &ended].map(|r| r.status.clone()), PLAYED);
    let took = ended.event_timestamp.unwrap() - started.event_timestamp.unwrap();
    assert_eq!(took, Span::from_millis(300), "exactly as the driver says");
    assert_eq!((ended.steps_done, ended.late_steps), (Some(2), Some(0)));
    assert_eq!(rig.stop(), ["arm 3", "wheel 0"]);
}

#[tokio::test]
async fn a_driver_that_times_scripts_ends_them_before_the_device_goes_to_rest() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.script_in("arm", "a", 60_000.0, &[(0.0, 5.0)], ControlType::Position);
    rig.responses(&PLAYED[..1]).await;
    rig.next_done(&["connect", "arm plan 5"]);
    assert_eq!(rig.stop(), ["arm cancel default", "arm 3", "wheel 0"]);
}

#[tokio::test]
async fn a_script_that_the_driver_does_not_take_fails_and_the_hardware_stays() {
    let mut rig = Rig::new(Bench { times_scripts: true, ..Bench::default() }, DriverOptions::default());
    rig.bench.refuses.store(true, Ordering::SeqCst);
    rig.script_in("arm", "a", 60_000.0, &[(0.0, 5.0)], ControlType::Position);
    rig.responses(&PLAYED[..1]).await;
    let failed = rig.response().await;
    assert_eq!(failed.error.unwrap().message, "the hardware refused a script of `arm`: too hot");
}

#[tokio::test]
async fn a_sensor_is_read_no_more_often_than_its_rate() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default().with_readings_per_second(0.01));
    for _ in 0..3 {
        rig.link.send(Message::ControlRequest(ControlRequest::immediate(
            DeviceId::new("eye").unwrap(),
            Command::ReadSensor,
        )));
        assert_eq!(rig.response().await.status_value, StatusValue::Number(7.0));
    }
    assert_eq!(rig.stop(), ["connect", "read eye"]);
}

#[test]
fn what_is_set_of_a_driver_leaves_the_rest_as_it_was() {
    let options = DriverOptions::default().with_samples_per_second(40.0).with_readings_per_second(3.0);
    let options = options.with_pings_per_second(7.0);
    let set = [options.samples_per_second, options.readings_per_second, options.pings_per_second];
    assert_eq!(set, [40.0, 3.0, 7.0].map(Some));
}

#[test]
fn a_script_that_is_taken_back_before_the_driver_has_it_never_reaches_it() {
    let mailbox = Mailbox::default();
    mailbox.connected(1, mailbox::Manners { acknowledges: true, ..MANNERS });
    let arm = DeviceId::new("arm").unwrap();
    let part = PlanPart {
        plan: crate::PlanId(1),
        device: arm.clone(),
        start: Timestamp::from_nanos(0),
        begin_by: Timestamp::from_nanos(0),
        interpolation: urrcp::Interpolation::Hold,
        first: 0,
        steps: Vec::new(),
        is_last: true,
    };
    let cancel =
        PlanCancel { plan: part.plan, device: arm.clone(), then: crate::Then::Keep, why: String::new() };
    let take = mailbox::PlanOrder::Take(part, HostClock::anchored());
    let orders = [
        mailbox::Order::Plan(take),
        mailbox::Order::Plan(mailbox::PlanOrder::Cancel(cancel)),
        mailbox::Order::Confirm(Ticket(1), arm),
    ];
    mailbox.post(1, orders.into_iter(), Demand::default());
    mailbox.close();
    let soon = || HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    assert!(matches!(mailbox.next(soon()), mailbox::Work::Plan(mailbox::PlanOrder::Cancel(_))));
    assert!(matches!(mailbox.next(soon()), mailbox::Work::Confirm(tickets) if tickets == [Ticket(1)]));
}

/// Times scripts by itself, and logs each value with the nanoseconds at which it is set. 66 fails, 77 ends it.
const AHEAD: &str = r#"
import os, sys, time
from downbeat_driver import Driver

class Ahead(Driver):
    lookahead = 100 if sys.argv[2] == "horizon" else "script"

    def set(self, device, control_type, value, *more):
        if value == 66:
            raise RuntimeError("torque")
        with open(sys.argv[1], "a") as driven:
            driven.write(f"{time.time_ns()} {device} {value:g}\n")
        if value == 77:
            os._exit(3)

Ahead().run()
"#;

/// A host with the program `AHEAD`, and the log of that. `None` where there is no Python.
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
    let driver = Program::new(&command, &block).unwrap();
    let options = DriverOptions::default();
    let host = Host::start(vec![Hosted::driven(block, Box::new(driver), options)], HostOptions::default());
    let host = host.unwrap();
    host.await_hardware(Duration::from_secs(60));
    let link = host.handle().connect(0).unwrap();
    Some((host, link, folder))
}

/// What a program has logged, and when.
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

fn request(device: &str, lead: f64, steps: &[(f64, f64)], control_type: ControlType) -> Message {
    let step = |(millis, value): &(f64, f64)| Step {
        offset: Millis::new(*millis).unwrap(),
        setpoint: Setpoint::new(control_type, *value),
        stop_condition: None,
    };
    let script = Script::new(steps.iter().map(step).collect()).unwrap();
    let now: Timestamp<Server> = HostClock::anchored().now().assume_clock();
    Message::ControlRequest(ControlRequest {
        timestamp: Some(now),
        time_offset_to_start: Some(Millis::new(lead).unwrap()),
        request_id: Some(RequestId::new(device).unwrap()),
        ..ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::Script(script))
    })
}

#[tokio::test]
async fn a_program_that_times_scripts_reports_what_it_logs() {
    for mode in ["script", "horizon"] {
        let Some((host, mut link, folder)) = ahead(mode) else { return };
        link.send(request("wheel", 2_000.0, &[(0.0, 4.0), (300.0, 5.0), (600.0, 6.0)], ControlType::Speed));
        let all = responses(&mut link, 3).await;
        let statuses: Vec<_> = all.iter().map(|response| response.status.clone()).collect();
        assert_eq!(statuses, PLAYED, "{mode}: {:?}", all[all.len() - 1].error);
        let log = logged(&folder);
        let values: Vec<_> = log.iter().map(|(_, what)| what.as_str()).collect();
        assert_eq!(values, ["wheel 4", "wheel 5", "wheel 6"]);
        let at = |index: usize| all[index].event_timestamp.unwrap().as_nanos();
        // It says that it begins right before the first value, and that it is done right behind the last one.
        assert!(at(1) <= log[0].0 && log[2].0 <= at(2), "{mode}: {all:?} {log:?}");
        assert!(host.stop().is_empty());
        let _left = std::fs::remove_dir_all(folder);
    }
}

#[tokio::test]
async fn a_program_that_fails_in_a_step_or_dies_leaves_its_script_failed() {
    for (value, why) in [(66.0, "the hardware failed in step 2: RuntimeError: torque"), (77.0, "has ended")] {
        let Some((host, mut link, folder)) = ahead("script") else { return };
        link.send(request(
            "arm",
            2_000.0,
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
async fn a_stop_ends_the_script_of_a_program_before_it_is_confirmed() {
    let Some((host, mut link, folder)) = ahead("script") else { return };
    let steps: Vec<_> = (0..8_u32).map(|i| (f64::from(i) * 500.0, f64::from(i + 1))).collect();
    link.send(request("wheel", 2_000.0, &steps, ControlType::Speed));
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

#[test]
fn orders_of_an_earlier_connection_are_void_and_newer_values_take_the_place_of_older_ones() {
    let mailbox = Mailbox::default();
    let key = |device: &str| (DeviceId::new(device).unwrap(), ControlType::Speed);
    let set = |device, value| {
        let setpoint = Setpoint::new(ControlType::Speed, value);
        mailbox::Order::Set(key(device), mailbox::Value { setpoint, due: None })
    };
    mailbox.post(0, [set("before", 1.0)].into_iter(), Demand::default());
    mailbox.connected(1, MANNERS);
    mailbox.post(0, [set("a", 2.0)].into_iter(), Demand::default());
    mailbox.post(1, [set("a", 3.0), set("b", 4.0), set("a", 5.0)].into_iter(), Demand::default());
    mailbox.close();
    let values: Vec<_> = std::iter::from_fn(|| {
        match mailbox.next(HostClock::anchored().instant_of(Timestamp::from_nanos(0))) {
            mailbox::Work::Drive(drives) => {
                let [(key, Some(value), None)] = drives.as_slice() else { panic!("{drives:?}") };
                Some((key.0.to_string(), value.setpoint.value))
            }
            _ => None,
        }
    })
    .collect();
    assert_eq!(values, [("a".to_owned(), 5.0), ("b".to_owned(), 4.0)]);
    mailbox.connected(1, MANNERS);
    mailbox.post(1, [set("a", 6.0)].into_iter(), Demand::default());
    mailbox.disconnected();
    mailbox.connected(2, MANNERS);
    mailbox.post(1, [set("a", 7.0)].into_iter(), Demand::default());
    assert!(matches!(
        mailbox.next(HostClock::anchored().instant_of(Timestamp::from_nanos(0))),
        mailbox::Work::Closed
    ));
}

#[test]
fn a_driver_that_takes_frames_is_given_at_once_what_waits_at_once() {
    let mailbox = Mailbox::default();
    mailbox.connected(1, mailbox::Manners { acknowledges: true, takes_frames: true, ..MANNERS });
    let set = |device: &str, value| {
        let setpoint = Setpoint::new(ControlType::Speed, value);
        let key = (DeviceId::new(device).unwrap(), ControlType::Speed);
        mailbox::Order::Set(key, mailbox::Value { setpoint, due: None })
    };
    mailbox.post(1, [set("a", 1.0), set("b", 2.0)].into_iter(), Demand::default());
    let soon = || HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    let mailbox::Work::Drive(frame) = mailbox.next(soon()) else { panic!("nothing to drive") };
    let frame: Vec<_> = frame.iter().map(|(key, ..)| key.0.as_str()).collect();
    assert_eq!(frame, ["a", "b"]);
    mailbox.close();
    assert!(matches!(mailbox.next(soon()), mailbox::Work::Closed));
}

#[tokio::test]
async fn what_was_told_unasked_counts_for_its_time_and_its_connection() {
    let mailbox = Arc::new(Mailbox::default());
    let pushes = Pushes::into(Arc::clone(&mailbox));
    let eye = DeviceId::new("eye").unwrap();
    pushes.reading(&eye, 1.0);
    assert_eq!(mailbox.pushed(&eye, Duration::MAX), None, "nothing is connected");
    mailbox.connected(1, MANNERS);
    pushes.reading(&eye, 2.0);
    assert_eq!(mailbox.pushed(&eye, Duration::from_secs(600)), Some(2.0));
    tokio::time::sleep(Duration::from_millis(2)).await;
    assert_eq!(mailbox.pushed(&eye, Duration::from_millis(1)), None, "too old");
    pushes.fault("stuck");
    let soon = HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    assert!(matches!(mailbox.next(soon), mailbox::Work::Fault(reason) if reason == "stuck"));
    mailbox.disconnected();
    assert_eq!(mailbox.pushed(&eye, Duration::MAX), None);
}

#[tokio::test]
async fn a_host_tells_whether_the_hardware_of_its_robots_answers() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    let figures = rig.host.figures();
    rig.script("wheel", "a", &[(0.0, 4.0), (60_000.0, 8.0)], ControlType::Speed);
    rig.responses(&PLAYED[..2]).await;
    assert!(figures.robots()[0].hardware_answers());
    rig.bench.broken.store(true, Ordering::SeqCst);
    assert_eq!(rig.response().await.status, Status::Failed);
    assert!(!figures.robots()[0].hardware_answers());
    rig.bench.broken.store(false, Ordering::SeqCst);
    rig.next_done(&["connect", "wheel 4", "connect", "arm 3", "wheel 0"]);
    rig.script("wheel", "b", &[(0.0, 5.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    assert!(figures.robots()[0].hardware_answers());
}

#[test]
fn what_a_driver_says_of_a_script_is_passed_on_as_it_says_it() {
    let mailbox = Arc::new(Mailbox::default());
    let pushes = Pushes::into(Arc::clone(&mailbox));
    mailbox.connected(1, MANNERS);
    let soon = HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    pushes.plan(crate::PlanId(1), Timestamp::from_nanos(5), PlanEvent::Began);
    let mailbox::Work::Words(words) = mailbox.next(soon) else { panic!("nothing was said") };
    assert_eq!(
        (words[0].plan, words[0].at, &words[0].event),
        (crate::PlanId(1), Timestamp::from_nanos(5), &PlanEvent::Began)
    );
}

/// The least that a driver is.
struct Plain(Vec<String>);

impl Driver for Plain {
    fn connect(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.0.push(format!("{device} {}", setpoint.value));
        if setpoint.value < 0.0 { Err(DriverError::Refused("below zero".to_owned())) } else { Ok(()) }
    }

    fn read(&mut self, _sensor: &DeviceId) -> Result<f64, DriverError> {
        Ok(0.0)
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
}

#[test]
fn a_driver_by_default_is_told_values_alone_one_after_another() {
    let mut plain = Plain(Vec::new());
    assert!(!plain.takes_ramps() && !plain.takes_frames() && !plain.set_is_acknowledged());
    assert!(plain.lookahead().is_empty() && plain.latency().is_empty() && plain.lifeline().is_none());
    assert_eq!(plain.rates(), Rates::default());
    let value =
        |device: &str, value| (DeviceId::new(device).unwrap(), Setpoint::new(ControlType::Speed, value));
    assert_eq!(plain.set_frame(&[value("a", 1.0), value("b", 2.0)]), Ok(()));
    let refused = Err(DriverError::Refused("below zero".to_owned()));
    assert_eq!(plain.set_frame(&[value("c", -1.0), value("d", 2.0)]), refused);
    assert_eq!(plain.0, ["a 1", "b 2", "c -1"]);
    let ramp = Ramp { control_type: ControlType::Speed, to: 1.0, duration: Duration::ZERO };
    let arm = || DeviceId::new("a").unwrap();
    assert!(plain.ramp(&arm(), ramp).is_err());
    let part = PlanPart {
        plan: crate::PlanId(1),
        device: arm(),
        start: Timestamp::from_nanos(0),
        begin_by: Timestamp::from_nanos(0),
        interpolation: urrcp::Interpolation::Hold,
        first: 0,
        steps: Vec::new(),
        is_last: true,
    };
    let (then, why) = (crate::Then::Keep, String::new());
    let cancel = PlanCancel { plan: part.plan, device: arm(), then, why };
    let timed = Err(DriverError::Refused("this driver times no scripts".to_owned()));
    assert_eq!([plain.plan(&part), plain.cancel(&cancel)], [timed.clone(), timed]);
}

#[tokio::test]
async fn hardware_that_is_to_be_held_stays_where_it_is_and_turns_no_more() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    rig.script("arm", "a", &[(0.0, 30.0)], ControlType::Position);
    rig.responses(&PLAYED).await;
    rig.script("wheel", "b", &[(0.0, 4.0)], ControlType::Speed);
    rig.responses(&PLAYED).await;
    let Rig { host, done, link, .. } = rig;
    drop(link);
    assert_eq!(host.stop_but(&["r".parse().unwrap()]), []);
    let done: Vec<_> = done.try_iter().filter(|what| what != "ping").collect();
    assert_eq!(done.last().map(String::as_str), Some("wheel 0"));
    assert!(!done.contains(&"arm 3".to_owned()), "{done:?}");
}

#[tokio::test]
async fn an_edge_whose_session_is_over_is_free_once_it_is_asked() {
    let mut rig = Rig::new(Bench::default(), DriverOptions::default());
    let handle = rig.host.handle();
    let session = urrcp::SessionId::new("show").ok();
    let claim = urrcp::AvailabilityRequest { session, ..Default::default() };
    rig.link.send(Message::AvailabilityRequest(claim));
    rig.link.recv().await.unwrap();
    handle.look(0).await;
    assert!(handle.owner(0).unwrap().borrow().is_some(), "its link stands");
    drop(rig.link);
    handle.look(0).await;
    assert!(handle.owner(0).unwrap().borrow().is_none());
}

#[tokio::test]
async fn who_watches_the_hardware_of_a_robot_is_told_of_each_event() {
    let (tell, events) = channel();
    let (done, _seen) = channel();
    let bench = Arc::new(Bench::default());
    let fake = Fake { bench: Arc::clone(&bench), done, pushes: None };
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let hosted = Hosted::driven(block, Box::new(fake), DriverOptions::default())
        .watched(move |event| tell.send(event.to_string()).unwrap());
    let host = Host::start(vec![hosted], HostOptions::default()).unwrap();
    let next = || events.recv_timeout(Duration::from_secs(60)).unwrap();
    assert_eq!(next(), "the hardware answers");
    bench.broken.store(true, Ordering::SeqCst);
    assert_eq!(next(), "the hardware is away: pulled out");
    host.stop();
}

#[test]
fn imagined_hardware_reads_what_was_set_last_or_the_middle_of_its_range() {
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let mut driver = SimulatedDriver::new(&block);
    let (arm, eye) = (DeviceId::new("arm").unwrap(), DeviceId::new("eye").unwrap());
    driver.connect().unwrap();
    assert_eq!(driver.read(&eye), Ok(4.5));
    assert_eq!(driver.read(&arm), Err(DriverError::Refused("`arm` is no sensor".to_owned())));
    driver.set(&arm, &Setpoint::new(ControlType::Position, 30.0)).unwrap();
    assert_eq!(driver.read(&arm), Ok(30.0));
    assert!(driver.set_is_acknowledged());
    driver.ping().unwrap();
}
