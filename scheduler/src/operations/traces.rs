//! Sends a mission as an OpenTelemetry trace: one span for the mission, with child spans for the greeting and for each act that was sent.
//! The span of an act contains spans for the phases up to its start, and for each robot's part. Times are on the server's clock, as in
//! reports.
//!
//! The mission's loop begins and ends spans. A thread of the SDK sends them by OTLP over HTTP. If its queue is full, spans are lost, so
//! that the mission never waits.

use std::collections::{HashMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use opentelemetry::trace::{SpanBuilder, Status, TraceContextExt, Tracer, TracerProvider};
use opentelemetry::{Context, KeyValue};
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::resource::{EnvResourceDetector, ResourceDetector, TelemetryResourceDetector};
use opentelemetry_sdk::trace::{
    BatchConfigBuilder, BatchSpanProcessor, SdkTracer, SdkTracerProvider, SpanData, SpanExporter as Exporter,
};
use urrcp::{RobotId, Server, Span, Timestamp};

use crate::mission::{Failure, Mission, Outcome, Progress};
use crate::run::watch::Watch;

/// Maximum number of spans that wait to be sent. It is more than enough for two acts with as many robots as one scheduler can drive.
const QUEUE: usize = 32_768;
/// Maximum number of spans per request to the collector.
const BATCH: usize = 1_024;
/// Maximum duration of a request to the collector.
const REQUEST: Duration = Duration::from_secs(3);
/// Maximum time to wait, at the end of a mission, until its last spans are sent.
const LAST: Duration = Duration::from_secs(5);
/// Maximum number of events per span. If the links of a mission break very often, only the first events are kept.
const EVENTS_MAX: u32 = 4_096;

/// Counts of the spans that were begun and that were sent.
#[derive(Debug, Default)]
struct Tally {
    begun: AtomicU64,
    sent: AtomicU64,
    /// The latest reason why the collector refused spans. `None` if it never did.
    refusal: Mutex<Option<String>>,
}

/// An exporter that counts the spans that were sent, because the SDK does not report spans that could not be sent.
#[derive(Debug)]
struct Counted<E> {
    exporter: E,
    tally: Arc<Tally>,
}

impl<E: Exporter> Exporter for Counted<E> {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let spans = batch.len() as u64;
        let sent = self.exporter.export(batch).await;
        match &sent {
            Ok(()) => _ = self.tally.sent.fetch_add(spans, Ordering::Relaxed),
            Err(error) => {
                let mut refusal = self.tally.refusal.lock().unwrap_or_else(PoisonError::into_inner);
                *refusal = Some(error.to_string());
            }
        }
        sent
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.exporter.shutdown_with_timeout(timeout)
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.exporter.set_resource(resource);
    }
}

/// The connection to a collector, through which traces are sent.
#[derive(Debug)]
pub(crate) struct Traces {
    provider: SdkTracerProvider,
    tally: Arc<Tally>,
}

impl Traces {
    /// Creates the connection to a collector at `url`, such as `http://localhost:4318`. Nothing is sent before a span ends.
    ///
    /// # Errors
    /// Fails if `url` is invalid.
    pub(crate) fn to(url: &str) -> Result<Self, String> {
        let endpoint = format!("{}/v1/traces", url.trim_end_matches('/'));
        let exporter = SpanExporter::builder().with_http().with_endpoint(endpoint).with_timeout(REQUEST);
        Ok(Self::through(exporter.build().map_err(|error| error.to_string())?))
    }

    fn through(exporter: impl Exporter + 'static) -> Self {
        let config = BatchConfigBuilder::default()
            .with_max_queue_size(QUEUE)
            .with_max_export_batch_size(BATCH)
            .build();
        let tally = Arc::new(Tally::default());
        let exporter = Counted { exporter, tally: Arc::clone(&tally) };
        let processor = BatchSpanProcessor::builder(exporter).with_batch_config(config).build();
        let resource = Resource::builder_empty()
            .with_attributes([
                KeyValue::new("service.name", "downbeat"),
                KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
            ])
            .with_detectors(&[
                Box::new(TelemetryResourceDetector) as Box<dyn ResourceDetector>,
                Box::new(EnvResourceDetector::new()),
            ]);
        // OpenTelemetry's standard environment variables take precedence over the defaults of this program.
        let resource = match std::env::var("OTEL_SERVICE_NAME") {
            Ok(name) if !name.is_empty() => resource.with_service_name(name),
            _ => resource,
        };
        let resource = resource.build();
        let provider = SdkTracerProvider::builder()
            .with_span_processor(processor)
            .with_max_events_per_span(EVENTS_MAX)
            .with_resource(resource)
            .build();
        Self { provider, tally }
    }

    /// Returns the watcher that creates spans from a mission's progress reports.
    pub(crate) fn watch(&self, now: Timestamp<Server>, mission: About) -> MissionTrace {
        let tracer = self.provider.tracer("downbeat");
        MissionTrace::begin(Spans { tracer, tally: Arc::clone(&self.tally) }, now, mission)
    }

    /// Sends the remaining spans and closes the connection.
    ///
    /// # Errors
    /// Fails if the collector did not accept all spans in time.
    pub(crate) fn end(self) -> Result<(), String> {
        let ended = self.provider.shutdown_with_timeout(LAST);
        let (begun, sent) =
            (self.tally.begun.load(Ordering::Relaxed), self.tally.sent.load(Ordering::Relaxed));
        if sent >= begun {
            return Ok(());
        }
        let refusal = self.tally.refusal.lock().unwrap_or_else(PoisonError::into_inner).take();
        let why = refusal.or_else(|| ended.err().map(|error| error.to_string()));
        let why = why.unwrap_or_else(|| "too many spans at once".to_owned());
        Err(format!("{} of its {begun} spans were not sent: {why}", begun - sent))
    }
}

/// The attributes of a mission's trace that are known when the mission begins.
#[derive(Clone, Debug)]
pub(crate) struct About {
    pub(crate) scenario: String,
    pub(crate) session: Option<String>,
    pub(crate) robots: usize,
}

#[derive(Clone, Debug)]
struct Spans {
    tracer: SdkTracer,
    tally: Arc<Tally>,
}

impl Spans {
    fn begin(
        &self,
        parent: &Context,
        name: String,
        begins: Timestamp<Server>,
        attributes: Vec<KeyValue>,
    ) -> Context {
        self.tally.begun.fetch_add(1, Ordering::Relaxed);
        let builder = SpanBuilder::from_name(name).with_start_time(time(begins)).with_attributes(attributes);
        parent.with_span(self.tracer.build_with_context(builder, parent))
    }
}

/// The open spans of a mission.
#[derive(Debug)]
pub(crate) struct MissionTrace {
    spans: Spans,
    mission: Context,
    greeting: Option<Context>,
    /// Acts that were sent and have not ended, oldest first: one plays while the next is prepared.
    acts: VecDeque<ActTrace>,
}

/// The open spans of an act that was sent to robots.
#[derive(Debug)]
struct ActTrace {
    name: String,
    span: Context,
    sent: Timestamp<Server>,
    /// The open span of the act's current part: a phase before its start, or its playing time.
    part: Option<Context>,
    /// The open spans for the parts of robots in this act, by robot id.
    robots: HashMap<RobotId, Context>,
}

impl MissionTrace {
    fn begin(spans: Spans, now: Timestamp<Server>, about: About) -> Self {
        let mut attributes = vec![
            KeyValue::new("downbeat.scenario", about.scenario),
            KeyValue::new("downbeat.robots", count(about.robots)),
        ];
        attributes.extend(about.session.map(|session| KeyValue::new("downbeat.session", session)));
        let mission = spans.begin(&Context::new(), "mission".to_owned(), now, attributes);
        let greeting = Some(spans.begin(&mission, "greet".to_owned(), now, Vec::new()));
        Self { spans, mission, greeting, acts: VecDeque::new() }
    }

    /// Returns the latest act with this name.
    fn act(&mut self, name: &str) -> Option<&mut ActTrace> {
        self.acts.iter_mut().rev().find(|act| act.name == name)
    }

    /// Returns the span of a robot's part in the oldest act in which this part has not ended.
    fn part_of(&self, robot: &RobotId) -> Option<&Context> {
        self.acts.iter().find_map(|act| act.robots.get(robot))
    }

    /// Ends the span of an act's current phase and begins the span of the next phase.
    fn go_on(&mut self, name: &str, part: &'static str, at: Timestamp<Server>, attributes: Vec<KeyValue>) {
        let spans = self.spans.clone();
        if let Some(act) = self.act(name) {
            end(act.part.take(), at);
            act.part = Some(spans.begin(&act.span, part.to_owned(), at, attributes));
        }
    }

    fn failed(&self, at: Timestamp<Server>, failure: &Failure) {
        let text = failure.kind.to_string();
        let kind = serde_json::to_value(&failure.kind).ok();
        let kind = kind.as_ref().and_then(|kind| kind.get("failure")?.as_str()).unwrap_or("failed");
        let attributes = vec![
            KeyValue::new("downbeat.robot", failure.robot.to_string()),
            KeyValue::new("downbeat.failure", kind.to_owned()),
            KeyValue::new("downbeat.text", text.clone()),
        ];
        if let Some(part) = self.part_of(&failure.robot) {
            part.span().set_status(Status::error(text));
        }
        self.mission.span().add_event_with_timestamp("failed", time(at), attributes);
    }

    fn close(&mut self, now: Timestamp<Server>, outcome: Option<&Outcome>) {
        end(self.greeting.take(), now);
        self.acts.drain(..).for_each(|act| act.end(now));
        let named = outcome.map_or_else(|| "unknown".to_owned(), name);
        let is_done = matches!(
            outcome,
            Some(Outcome::Done | Outcome::DoneWithout | Outcome::DoneSkipping { .. } | Outcome::Ready)
        );
        self.mission.span().set_attribute(KeyValue::new("downbeat.outcome", named.clone()));
        if !is_done {
            self.mission.span().set_status(Status::error(named));
        }
        end(Some(self.mission.clone()), now);
    }

    /// Adds an event to the span of the mission.
    fn happened(
        &self,
        at: Timestamp<Server>,
        event: &'static str,
        robot: Option<&RobotId>,
        text: Option<&str>,
    ) {
        let robot = robot.map(|robot| KeyValue::new("downbeat.robot", robot.to_string()));
        let text = text.map(|text| KeyValue::new("downbeat.text", text.to_owned()));
        let attributes = robot.into_iter().chain(text).collect();
        self.mission.span().add_event_with_timestamp(event, time(at), attributes);
    }
}

impl Watch for MissionTrace {
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress) {
        match progress {
            Progress::Greeted { clock_offset_max, .. } => {
                let offset = clock_offset_max.map(|offset| millis("downbeat.clock_offset_max_ms", offset));
                if let Some(greeting) = &self.greeting {
                    greeting.span().set_attributes(offset);
                }
                end(self.greeting.take(), at);
            }
            Progress::Preparing { act, timestamp, start, lead, skew, slowest } => {
                let mut attributes = vec![
                    KeyValue::new("downbeat.act", act.clone()),
                    KeyValue::new("downbeat.start", start.to_string()),
                    millis("downbeat.lead_ms", *start - *timestamp),
                    millis("downbeat.lease_ms", lead.lease),
                ];
                attributes
                    .extend(skew.as_ref().map(|skew| millis("downbeat.skew_predicted_ms", skew.predicted)));
                attributes.extend(
                    slowest.as_ref().map(|robot| KeyValue::new("downbeat.slowest", robot.to_string())),
                );
                let act_span = self.spans.begin(&self.mission, format!("act {act}"), *timestamp, attributes);
                let part = self.spans.begin(&act_span, "prepare".to_owned(), *timestamp, Vec::new());
                self.acts.push_back(ActTrace {
                    name: act.clone(),
                    span: act_span,
                    sent: *timestamp,
                    part: Some(part),
                    robots: HashMap::new(),
                });
            }
            Progress::Accepted { robot } => {
                if let Some(act) = self.acts.back_mut() {
                    let name = format!("robot {robot}");
                    let attributes = vec![KeyValue::new("downbeat.robot", robot.to_string())];
                    let part = self.spans.begin(&act.span, name, act.sent, attributes);
                    part.span().add_event_with_timestamp("accepted", time(at), Vec::new());
                    act.robots.insert(robot.clone(), part);
                }
            }
            Progress::Decided { act, doubt, .. } => {
                self.go_on(act, "commit", at, vec![millis("downbeat.doubt_ms", *doubt)]);
            }
            Progress::Committed { act, window } => {
                let window = window.map(|window| millis("downbeat.window_ms", window));
                self.go_on(act, "play", at, window.into_iter().collect());
            }
            Progress::Started { robot, error } => {
                if let Some(part) = self.part_of(robot) {
                    let error = error.map(|error| millis("downbeat.start_error_ms", error));
                    part.span().add_event_with_timestamp("started", time(at), error.into_iter().collect());
                }
            }
            Progress::Finished { robot, .. } => {
                let act = self.acts.iter_mut().find(|act| act.robots.contains_key(robot));
                end(act.and_then(|act| act.robots.remove(robot)), at);
            }
            Progress::ActEnded { act } | Progress::ActWithdrawn { act } => {
                if let Some(place) = self.acts.iter().position(|other| other.name == *act) {
                    self.acts.remove(place).into_iter().for_each(|act| act.end(at));
                }
            }
            Progress::Failed(failure) => self.failed(at, failure),
            Progress::ActSkipped { act, .. } => self.happened(at, "act skipped", None, Some(act)),
            Progress::LinkLost { robot, reason, .. } => {
                self.happened(at, "link lost", Some(robot), Some(reason));
            }
            Progress::Reattached { robot } => self.happened(at, "reattached", Some(robot), None),
            Progress::Dropped { robot } => self.happened(at, "dropped", Some(robot), None),
            Progress::GoingHome { act, .. } => self.happened(at, "going home", None, Some(act)),
            Progress::AtHome => self.happened(at, "at home", None, None),
            Progress::Approaching { act, .. } => self.happened(at, "approaching", None, Some(act)),
            Progress::NotApproached { reason, .. } => {
                self.happened(at, "not approached", None, Some(reason));
            }
            Progress::NotHome { reason } => self.happened(at, "not home", None, Some(reason)),
            Progress::AtRest { robot } => self.happened(at, "at rest", Some(robot), None),
            Progress::NtpLost { .. } => self.happened(at, "ntp lost", None, None),
            Progress::NtpBack { .. } => self.happened(at, "ntp back", None, None),
            Progress::JournalWrittenAgain => self.happened(at, "journal written again", None, None),
            Progress::JournalLost { reason } => self.happened(at, "journal lost", None, Some(reason)),
            Progress::Stopping { reason, .. } => self.happened(at, "stopping", None, Some(reason)),
            Progress::Connected { .. }
            | Progress::Waiting { .. }
            | Progress::Heard { .. }
            | Progress::Reading { .. } => {}
        }
    }

    fn ended(&mut self, now: Timestamp<Server>, mission: &Mission) {
        self.close(now, mission.outcome());
    }
}

impl ActTrace {
    fn end(self, at: Timestamp<Server>) {
        self.robots.into_values().for_each(|robot| end(Some(robot), at));
        end(self.part, at);
        end(Some(self.span), at);
    }
}

fn end(span: Option<Context>, at: Timestamp<Server>) {
    if let Some(span) = span {
        span.span().end_with_timestamp(time(at));
    }
}

/// Returns the name of an outcome, as reports contain it.
fn name(outcome: &Outcome) -> String {
    match serde_json::to_value(outcome) {
        Ok(serde_json::Value::String(name)) => name,
        Ok(serde_json::Value::Object(fields)) => fields.keys().next().cloned().unwrap_or_default(),
        _ => String::new(),
    }
}

fn millis(name: &'static str, span: Span) -> KeyValue {
    KeyValue::new(name, span.as_millis_f64())
}

fn count(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// Converts a timestamp to system time. Times before 1970 become the start of 1970.
fn time(at: Timestamp<Server>) -> SystemTime {
    UNIX_EPOCH + Duration::from_nanos(u64::try_from(at.as_nanos()).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mission::{FailureKind, Greeting, LeadTime, Preflight, Rest};

    /// An exporter that stores the spans instead of sending them.
    #[derive(Clone, Debug, Default)]
    struct Kept(Arc<Mutex<Vec<SpanData>>>);

    impl Exporter for Kept {
        async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
            self.0.lock().unwrap().extend(batch);
            Ok(())
        }
    }

    fn at(millis: i64) -> Timestamp<Server> {
        Timestamp::from_nanos(1_800_000_000_000_000_000 + millis * 1_000_000)
    }

    fn ms(millis: i64) -> Span {
        Span::from_millis(millis)
    }

    fn id(robot: &str) -> RobotId {
        RobotId::new(robot).unwrap()
    }

    fn greeted() -> Progress {
        let preflight =
            Preflight { greeting: Greeting::Full, rows: Vec::new(), skew: None, after_failures: Vec::new() };
        Progress::Greeted { clock_offset_max: None, preflight }
    }

    fn preparing(act: &str, when: i64) -> Progress {
        let lead = LeadTime { prepare: ms(100), lease: ms(240), margin: ms(160) };
        Progress::Preparing {
            act: act.to_owned(),
            timestamp: at(when),
            start: at(when + 500),
            lead,
            skew: None,
            slowest: Some(id("b")),
        }
    }

    fn decided(act: &str) -> Progress {
        Progress::Decided {
            act: act.to_owned(),
            start: at(0),
            duration: ms(1),
            leases_end: at(0),
            no_return: at(0),
            doubt: ms(46),
        }
    }

    fn committed(act: &str) -> Progress {
        Progress::Committed { act: act.to_owned(), window: Some(ms(3)) }
    }

    /// Returns the spans of a mission with these progress reports and this outcome.
    fn spans(told: &[(i64, Progress)], outcome: Option<&Outcome>) -> Vec<SpanData> {
        let kept = Kept::default();
        let traces = Traces::through(kept.clone());
        let about = About { scenario: "show".to_owned(), session: Some("show@stage".to_owned()), robots: 2 };
        let mut trace = traces.watch(at(0), about);
        told.iter().for_each(|(when, progress)| trace.told(at(*when), progress));
        trace.close(at(10_000), outcome);
        traces.end().unwrap();
        let spans = kept.0.lock().unwrap();
        spans.clone()
    }

    fn named<'a>(spans: &'a [SpanData], name: &str) -> &'a SpanData {
        let mut found = spans.iter().filter(|span| span.name == name);
        let span = found.next().unwrap_or_else(|| panic!("no {name}"));
        assert!(found.next().is_none(), "two of {name}");
        span
    }

    fn lasts(span: &SpanData) -> (i64, i64) {
        let since = |time: SystemTime| {
            let nanos = i64::try_from(time.duration_since(UNIX_EPOCH).unwrap().as_nanos()).unwrap();
            (nanos - at(0).as_nanos()) / 1_000_000
        };
        (since(span.start_time), since(span.end_time))
    }

    fn value(span: &SpanData, key: &str) -> Option<String> {
        let found = span.attributes.iter().find(|attribute| attribute.key.as_str() == key);
        found.map(|attribute| attribute.value.to_string())
    }

    fn events(span: &SpanData) -> Vec<(String, String)> {
        let attributes = |event: &opentelemetry::trace::Event| {
            let all = event.attributes.iter().map(|attribute| attribute.value.to_string());
            all.collect::<Vec<_>>().join(" ")
        };
        span.events.iter().map(|event| (event.name.to_string(), attributes(event))).collect()
    }

    #[test]
    fn mission_trace_is_a_tree_of_start_phases_and_robot_activity() {
        let told = [
            (100, greeted()),
            (110, preparing("wave", 105)),
            (120, Progress::Accepted { robot: id("a") }),
            (130, Progress::Accepted { robot: id("b") }),
            (131, decided("wave")),
            (500, committed("wave")),
            (606, Progress::Started { robot: id("a"), error: Some(ms(1)) }),
            (900, Progress::Finished { robot: id("a"), number: 0 }),
            (950, Progress::Finished { robot: id("b"), number: 0 }),
            (951, Progress::ActEnded { act: "wave".to_owned() }),
        ];
        let spans = spans(&told, Some(&Outcome::Done));
        assert_eq!(spans.len(), 8);
        let mission = named(&spans, "mission");
        let act = named(&spans, "act wave");
        let under = |span: &SpanData, parent: &SpanData| {
            span.parent_span_id == parent.span_context.span_id()
                && span.span_context.trace_id() == mission.span_context.trace_id()
        };
        assert!(under(named(&spans, "greet"), mission) && under(act, mission));
        for part in ["prepare", "commit", "play", "robot a", "robot b"] {
            assert!(under(named(&spans, part), act), "{part}");
        }
        let times = ["mission", "greet", "act wave", "prepare", "commit", "play", "robot a", "robot b"]
            .map(|name| lasts(named(&spans, name)));
        let expected =
            [(0, 10_000), (0, 100), (105, 951), (105, 131), (131, 500), (500, 951), (105, 900), (105, 950)];
        assert_eq!(times, expected);
        assert_eq!(
            events(named(&spans, "robot a")),
            [("accepted".to_owned(), String::new()), ("started".to_owned(), "1".to_owned())]
        );
        assert_eq!(value(act, "downbeat.slowest").as_deref(), Some("b"));
        assert_eq!(value(act, "downbeat.lead_ms").as_deref(), Some("500"));
        assert_eq!(value(mission, "downbeat.outcome").as_deref(), Some("done"));
        assert_eq!(
            (mission.status.clone(), value(mission, "downbeat.session")),
            (Status::Unset, Some("show@stage".to_owned()))
        );
    }

    #[test]
    fn repeated_act_has_two_spans_and_robots_end_in_the_one_they_play() {
        let told = [
            (10, preparing("loop", 10)),
            (20, Progress::Accepted { robot: id("a") }),
            (21, decided("loop")),
            (30, committed("loop")),
            (40, preparing("loop", 40)),
            (50, Progress::Accepted { robot: id("a") }),
            (51, decided("loop")),
            (60, Progress::Finished { robot: id("a"), number: 0 }),
            (61, Progress::ActEnded { act: "loop".to_owned() }),
            (70, committed("loop")),
            (80, Progress::Finished { robot: id("a"), number: 1 }),
            (81, Progress::ActEnded { act: "loop".to_owned() }),
        ];
        let spans = spans(&told, Some(&Outcome::Done));
        let times = |name: &str| {
            let mut times: Vec<_> = spans.iter().filter(|span| span.name == name).map(lasts).collect();
            times.sort_unstable();
            times
        };
        assert_eq!(times("act loop"), [(10, 61), (40, 81)]);
        assert_eq!(times("robot a"), [(10, 60), (40, 80)]);
        assert_eq!(times("commit"), [(21, 30), (51, 70)]);
    }

    #[test]
    fn failure_is_marked_on_robot_and_mission_and_leaves_no_span_open() {
        let reason = "reset by peer".to_owned();
        let failure = Failure { robot: id("a"), kind: FailureKind::LinkDown { reason } };
        let told = [
            (10, preparing("wave", 10)),
            (20, Progress::Accepted { robot: id("a") }),
            (30, Progress::Failed(failure)),
            (31, Progress::Stopping { reason: "a failed".to_owned(), rest: Rest::InPlace }),
        ];
        let spans = spans(&told, Some(&Outcome::NotStarted));
        assert_eq!(spans.len(), 5, "the mission, the greeting, the act, its preparation and a robot");
        let mission = named(&spans, "mission");
        assert_eq!(mission.status, Status::error("not_started"));
        assert_eq!(named(&spans, "robot a").status, Status::error("link down: reset by peer"));
        assert_eq!(
            events(mission),
            [
                ("failed".to_owned(), "a link_down link down: reset by peer".to_owned()),
                ("stopping".to_owned(), "a failed".to_owned())
            ]
        );
        assert!(spans.iter().all(|span| lasts(span).1 == 10_000));
    }

    #[test]
    fn outcome_name_matches_the_report() {
        let late = Outcome::DecisionLate { by: ms(2) };
        assert_eq!(
            (name(&Outcome::DoneWithout), name(&late)),
            ("done_without".to_owned(), "decision_late".to_owned())
        );
    }

    #[test]
    fn missing_collector_is_reported_after_a_limited_wait() {
        let traces = Traces::to("http://127.0.0.1:9").unwrap();
        let about = About { scenario: "show".to_owned(), session: None, robots: 1 };
        traces.watch(at(0), about).close(at(1), Some(&Outcome::Done));
        let told = traces.end().unwrap_err();
        assert!(told.starts_with("2 of its 2 spans were not sent: "), "{told}");
    }
}
