//! Tests drivers on their threads: which calls reach the hardware, in which order, and which effects failures have.

mod edge;
mod orders;
mod plain;
mod thread;
mod timed;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use urrcp::{
    Command, ControlRequest, ControlResponse, ErrorCode, InitializationBlock, Message, Millis, RequestId,
    Script, Server, Span, Status, StatusValue, Step, Timestamp,
};

use super::*;
use crate::host::tests::LogFile;
use crate::plans::PlanEvent;
use crate::tolerance::Tolerance;
use crate::{Host, HostOptions, Hosted, LinkEvent, RobotLink};

const BLOCK: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "default_value": 3, "interpolation": "linear", "script_queue": 2,
   "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5},
     "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 8}}},
  {"id": "wheel", "name": "wheel", "available_control_types": {
     "speed": {"min_value": -10, "max_value": 10, "granularity": 1},
     "script": {"min_value": -10, "max_value": 10, "granularity": 1, "max_number_of_steps": 8}}},
  {"id": "eye", "name": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9, "max_delay": 60000}}}]}"#;

/// A robot whose lift slows down within its declared acceleration.
const LIFT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "lift", "name": "lift", "interpolation": "linear", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "acceleration": {"min_value": -100, "max_value": 100, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 8,
                "control_types": ["position"]}}}]}"#;

/// A robot like `LIFT`, whose lift takes longer to come to rest than an edge that ends waits. Its wheel comes to rest in half a second.
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

/// Returns a request for a script that starts `lead` milliseconds from now. `None`: it starts at its receipt, which is never too late.
fn request(
    device: &str,
    id: &str,
    lead: Option<f64>,
    steps: &[(f64, f64)],
    control_type: ControlType,
) -> Message {
    let step = |(millis, value): &(f64, f64)| Step {
        offset: Millis::new(*millis).unwrap(),
        setpoint: Setpoint::new(control_type, *value),
        stop_condition: None,
    };
    let script = Script::new(steps.iter().map(step).collect()).unwrap();
    let now: Timestamp<Server> = HostClock::anchored().now().assume_clock();
    Message::ControlRequest(ControlRequest {
        timestamp: Some(now),
        time_offset_to_start: lead.map(|lead| Millis::new(lead).unwrap()),
        request_id: Some(RequestId::new(id).unwrap()),
        ..ControlRequest::immediate(DeviceId::new(device).unwrap(), Command::Script(script))
    })
}

/// Returns a complete script without steps, for a driver that times scripts by itself.
fn empty_plan<C>(device: &DeviceId) -> PlanPart<C> {
    PlanPart {
        plan: crate::PlanId(1),
        device: device.clone(),
        start: Timestamp::from_nanos(0),
        begin_by: Timestamp::from_nanos(0),
        interpolation: urrcp::Interpolation::Hold,
        first: 0,
        steps: Vec::new(),
        is_last: true,
    }
}

/// Test hardware: reports its calls, and behaves as the test specifies.
#[derive(Default)]
struct Bench {
    broken: AtomicBool,
    /// Whether the hardware refuses values.
    refuses: AtomicBool,
    panics: AtomicBool,
    takes_ramps: bool,
    /// Whether calls of `set` hang; they return once this value is false.
    busy: AtomicBool,
    line: Option<std::os::unix::net::UnixStream>,
    /// Whether the hardware times the scripts of the arm by itself.
    times_scripts: bool,
}

/// The test's handle to the hardware. When the test ends or fails, dropping the handle releases a hanging call, because the host waits
/// for that call.
struct Shared(Arc<Bench>);

impl std::ops::Deref for Shared {
    type Target = Bench;

    fn deref(&self) -> &Bench {
        &self.0
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        self.busy.store(false, Ordering::SeqCst);
    }
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
        // Read before the test receives the value: if the test then sets `busy`, the next call hangs, but never this one.
        let hangs = self.bench.busy.load(Ordering::SeqCst);
        self.act(format!("{device} {}", setpoint.value))?;
        while hangs && self.bench.busy.load(Ordering::SeqCst) {
            #[expect(clippy::disallowed_methods, reason = "the hardware hangs")]
            std::thread::sleep(std::time::Duration::from_millis(1));
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

    /// Reports that the script has started on time, and that it has ended on time.
    #[expect(clippy::disallowed_methods, reason = "hardware takes its time")]
    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        if self.bench.refuses.load(Ordering::SeqCst) {
            return Err(DriverError::Refused("too hot".to_owned()));
        }
        let values: Vec<_> = part.steps.iter().map(|step| step.setpoint.value.to_string()).collect();
        self.act(format!("{} plan {}", part.device, values.join(" ")))?;
        let (plan, pushes) = (part.plan, self.pushes.clone().unwrap());
        let (start, end) = (part.start, part.steps.last().unwrap().at);
        // This thread ends after its reports.
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

/// A robot on a host, with its hardware and a link to it.
struct Rig {
    bench: Shared,
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
        Self::tolerating(Tolerance::AN_HOUR, host, block, bench, options)
    }

    /// Creates a rig (a robot with test hardware) that applies these maximum delays. Other rigs permit practically any delay.
    fn tolerating(
        tolerance: Tolerance,
        host: HostOptions,
        block: &str,
        bench: Bench,
        options: DriverOptions,
    ) -> Self {
        let bench = Shared(Arc::new(bench));
        let (done, seen) = channel();
        let block: InitializationBlock = serde_json::from_str(block).unwrap();
        let fake = Fake { bench: Arc::clone(&bench.0), done, pushes: None };
        let hosted = Hosted::driven(block, Box::new(fake), options).tolerating(tolerance);
        let host = Host::start(vec![hosted], host).unwrap();
        host.await_hardware(Duration::from_secs(60));
        let link = host.handle().connect(0).unwrap();
        Self { bench, done: seen, host, link }
    }

    /// Sends a script that starts at its receipt.
    fn script(&self, device: &str, id: &str, steps: &[(f64, f64)], control_type: ControlType) {
        self.link.send(request(device, id, None, steps, control_type));
    }

    /// Sends a script that starts `lead` milliseconds from now. The robot must receive it before then.
    fn script_in(&self, device: &str, id: &str, lead: f64, steps: &[(f64, f64)], control_type: ControlType) {
        self.link.send(request(device, id, Some(lead), steps, control_type));
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

    /// Checks the next calls to the hardware, except pings.
    #[track_caller]
    fn next_done(&self, expected: &[&str]) {
        for expected in expected {
            let next = || self.done.recv_timeout(Duration::from_secs(60)).unwrap();
            let done = std::iter::repeat_with(next).find(|what| what != "ping");
            assert_eq!(done.as_deref(), Some(*expected));
        }
    }

    /// Waits until the hardware receives a value of `device` above `bound`. Returns all values of the device received up to then.
    fn until_beyond(&self, device: &str, bound: f64) -> Vec<f64> {
        let mut values = Vec::new();
        while values.last().is_none_or(|value| *value <= bound) {
            let done = self.done.recv_timeout(Duration::from_secs(60)).unwrap();
            values.extend(value_of(device, &done));
        }
        values
    }

    /// Waits until the robot has done `count` steps, whether or not the hardware has received them.
    async fn until_steps(&self, count: u64) {
        let figures = self.host.figures();
        let stepped = async {
            while figures.robots()[0].steps() < count {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), stepped).await.unwrap();
    }

    /// Stops the robot, and returns the calls to the hardware until its end, except pings.
    fn stop(self) -> Vec<String> {
        self.stop_and_tell().0
    }

    /// Like `stop`, and also returns why the robot may not be at rest.
    fn stop_and_tell(self) -> (Vec<String>, Option<String>) {
        let Self { host, done, link, bench: _bench } = self;
        drop(link);
        let not_at_rest = host.stop().pop().map(|robot| robot.reason);
        (done.try_iter().filter(|what| what != "ping").collect(), not_at_rest)
    }
}

/// Returns the value that a call to the hardware sets on `device`. `None` if it is another call.
fn value_of(device: &str, done: &str) -> Option<f64> {
    done.strip_prefix(device)?.strip_prefix(' ')?.parse().ok()
}

/// Traits of a driver that receives one value at a time.
const MANNERS: mailbox::DriverTraits = mailbox::DriverTraits {
    acknowledges: false,
    takes_frames: false,
    ping_period: Duration::from_millis(25),
    silence_max: None,
};

const PLAYED: [Status; 3] = [Status::Accepted, Status::Started, Status::Ok];
