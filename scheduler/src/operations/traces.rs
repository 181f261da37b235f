//! A mission as spans: the mission, its greeting, each act with what it is prepared, committed and played in, and what each robot plays.
//!
//! Spans begin and end at the instants of the mission's own clock. The mission's loop hands over what happens, if there is room; a
//! thread makes spans of it, and another one, of OpenTelemetry's, exports them.

use std::collections::HashMap;
use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use opentelemetry::trace::{SpanBuilder, Status, TraceContextExt, Tracer, TracerProvider};
use opentelemetry::{Context, KeyValue};
use opentelemetry_sdk::trace::{SdkTracer, SdkTracerProvider};
use urrcp::{RobotId, Server, Timestamp};

use crate::mission::{Mission, Progress};
use crate::run::watch::Watch;

/// What may wait to be made spans of; what is more is left out of the trace.
const WAITING_MAX: usize = 8_192;
/// Robots that have spans of their own at the same time; what others play is left out.
const ROBOTS_MAX: usize = 256;
/// So long the last spans may take to be exported, after the mission.
const EXPORT_MAX: Duration = Duration::from_secs(2);

/// Something that begins or ends a span, or is noted in one.
#[derive(Clone, Debug)]
enum Note {
    Greeted,
    Preparing(String),
    Decided(String),
    Committed(String),
    Started(RobotId, Option<f64>),
    Finished(RobotId),
    ActOver(String, Option<String>),
    Failed(RobotId, String),
    LinkLost(RobotId, String),
    Stopping(String),
    Ended(String),
}

fn note(progress: &Progress) -> Option<Note> {
    Some(match progress {
        Progress::Greeted { .. } => Note::Greeted,
        Progress::Preparing { act, .. } => Note::Preparing(act.clone()),
        Progress::Decided { act, .. } => Note::Decided(act.clone()),
        Progress::Committed { act, .. } => Note::Committed(act.clone()),
        Progress::Started { robot, error } => {
            Note::Started(robot.clone(), error.map(urrcp::Span::as_millis_f64))
        }
        Progress::Finished { robot, .. } => Note::Finished(robot.clone()),
        Progress::ActEnded { act } => Note::ActOver(act.clone(), None),
        Progress::ActSkipped { act, fate } => Note::ActOver(act.clone(), Some(fate.to_string())),
        Progress::Failed(failure) => Note::Failed(failure.robot.clone(), failure.kind.to_string()),
        Progress::LinkLost { robot, reason, .. } => Note::LinkLost(robot.clone(), reason.clone()),
        Progress::Stopping { reason, .. } => Note::Stopping(reason.clone()),
        _ => return None,
    })
}

/// The mission's end of its trace.
#[derive(Debug)]
pub(crate) struct TraceWatch(SyncSender<(SystemTime, Note)>);

/// The trace of one mission. It is exported when this is finished.
#[derive(Debug)]
pub(crate) struct Trace {
    provider: SdkTracerProvider,
    thread: JoinHandle<()>,
}

impl Trace {
    /// Begins one of a mission of this scenario.
    ///
    /// # Errors
    /// The system gives no thread.
    pub(crate) fn begin(
        provider: SdkTracerProvider,
        scenario: String,
        at: Timestamp<Server>,
    ) -> io::Result<(Self, TraceWatch)> {
        let (notes, told) = sync_channel(WAITING_MAX);
        let tracer = provider.tracer("downbeat");
        // Ends when the mission's end is dropped.
        let thread = std::thread::Builder::new().name("traces".to_owned()).spawn(move || {
            let spans = Spans::begin(tracer, scenario, system_time(at));
            spans.follow(&told);
        })?;
        Ok((Self { provider, thread }, TraceWatch(notes)))
    }

    /// Waits for the last spans to be exported, for a while. The mission's end has been dropped.
    pub(crate) fn finish(self) {
        let _panicked = self.thread.join();
        if let Err(error) = self.provider.shutdown_with_timeout(EXPORT_MAX) {
            tracing::warn!("the trace of the mission may not be complete: {error}");
        }
    }
}

impl TraceWatch {
    /// Where too much waits, the trace has a gap.
    fn hand_over(&self, at: Timestamp<Server>, note: Note) {
        let _full = self.0.try_send((system_time(at), note));
    }
}

impl Watch for TraceWatch {
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress) {
        if let Some(note) = note(progress) {
            self.hand_over(at, note);
        }
    }

    fn ended(&mut self, now: Timestamp<Server>, mission: &Mission) {
        let outcome = mission.outcome().map_or_else(|| "left".to_owned(), ToString::to_string);
        self.hand_over(now, Note::Ended(outcome));
    }
}

fn system_time(at: Timestamp<Server>) -> SystemTime {
    let nanos = u64::try_from(at.as_nanos()).unwrap_or(0);
    SystemTime::UNIX_EPOCH + Duration::from_nanos(nanos)
}

/// An act that is under way.
struct ActSpans {
    name: String,
    act: Context,
    /// The part of it that is under way.
    part: Context,
}

/// The spans of a mission that have not ended.
struct Spans {
    tracer: SdkTracer,
    mission: Context,
    greeting: Option<Context>,
    acts: Vec<ActSpans>,
    robots: HashMap<RobotId, Context>,
    stop: Option<Context>,
    last: SystemTime,
}

impl Spans {
    fn begin(tracer: SdkTracer, scenario: String, at: SystemTime) -> Self {
        let builder = SpanBuilder::from_name("mission")
            .with_start_time(at)
            .with_attributes([KeyValue::new("downbeat.scenario", scenario)]);
        let mission = Context::new().with_span(tracer.build_with_context(builder, &Context::new()));
        let greeting = child(&tracer, &mission, "greeting", at);
        Self {
            mission,
            greeting: Some(greeting),
            acts: Vec::new(),
            robots: HashMap::new(),
            stop: None,
            last: at,
            tracer,
        }
    }

    fn follow(mut self, told: &Receiver<(SystemTime, Note)>) {
        while let Ok((at, note)) = told.recv() {
            self.last = at;
            self.take(at, note);
        }
        // A mission that is left, or a trace with a gap.
        self.end_all(self.last);
    }

    fn take(&mut self, at: SystemTime, note: Note) {
        match note {
            Note::Greeted => end(self.greeting.take(), at),
            Note::Preparing(name) => self.prepare(at, name),
            Note::Decided(name) => self.next_part(at, &name, "commit"),
            Note::Committed(name) => self.next_part(at, &name, "play"),
            Note::Started(robot, error) => self.started(at, robot, error),
            Note::Finished(robot) => end(self.robots.remove(&robot), at),
            Note::ActOver(name, why) => self.act_over(at, &name, why),
            Note::Failed(robot, why) => self.failed(at, &robot, why),
            Note::LinkLost(robot, why) => self.note_in_mission(at, "link lost", &robot, why),
            Note::Stopping(why) => {
                let stop = child(&self.tracer, &self.mission, "stop", at);
                stop.span().set_attribute(KeyValue::new("downbeat.reason", why));
                end(self.stop.replace(stop), at);
            }
            Note::Ended(outcome) => {
                self.mission.span().set_attribute(KeyValue::new("downbeat.outcome", outcome));
                self.end_all(at);
            }
        }
    }

    fn prepare(&mut self, at: SystemTime, name: String) {
        let act = child(&self.tracer, &self.mission, "act", at);
        act.span().set_attribute(KeyValue::new("downbeat.act", name.clone()));
        let part = child(&self.tracer, &act, "prepare", at);
        self.acts.push(ActSpans { name, act, part });
    }

    fn next_part(&mut self, at: SystemTime, name: &str, part: &'static str) {
        if let Some(act) = self.acts.iter_mut().rev().find(|act| act.name == name) {
            let next = child(&self.tracer, &act.act, part, at);
            end(Some(std::mem::replace(&mut act.part, next)), at);
        }
    }

    /// Of a robot with several devices the first one begins its span.
    fn started(&mut self, at: SystemTime, robot: RobotId, error_ms: Option<f64>) {
        if self.robots.len() >= ROBOTS_MAX || self.robots.contains_key(&robot) {
            return;
        }
        let Some(act) = self.acts.first() else { return };
        let span = child(&self.tracer, &act.part, "robot plays", at);
        span.span().set_attribute(KeyValue::new("downbeat.robot", robot.to_string()));
        if let Some(error) = error_ms {
            span.span().set_attribute(KeyValue::new("downbeat.start_error_ms", error));
        }
        self.robots.insert(robot, span);
    }

    fn act_over(&mut self, at: SystemTime, name: &str, why: Option<String>) {
        let Some(place) = self.acts.iter().position(|act| act.name == name) else { return };
        let act = self.acts.remove(place);
        if let Some(why) = why {
            act.act.span().set_status(Status::error(why));
        }
        end(Some(act.part), at);
        end(Some(act.act), at);
    }

    fn failed(&mut self, at: SystemTime, robot: &RobotId, why: String) {
        if let Some(span) = self.robots.remove(robot) {
            span.span().set_status(Status::error(why.clone()));
            end(Some(span), at);
        }
        self.mission.span().set_status(Status::error(why.clone()));
        self.note_in_mission(at, "failure", robot, why);
    }

    fn note_in_mission(&self, at: SystemTime, what: &'static str, robot: &RobotId, why: String) {
        let attributes =
            vec![KeyValue::new("downbeat.robot", robot.to_string()), KeyValue::new("downbeat.reason", why)];
        self.mission.span().add_event_with_timestamp(what, at, attributes);
    }

    /// Inner ones first. What has ended already stays as it is.
    fn end_all(&mut self, at: SystemTime) {
        self.robots.drain().for_each(|(_, robot)| end(Some(robot), at));
        for act in self.acts.drain(..).rev() {
            end(Some(act.part), at);
            end(Some(act.act), at);
        }
        end(self.greeting.take(), at);
        end(self.stop.take(), at);
        self.mission.span().end_with_timestamp(at);
    }
}

fn child(tracer: &SdkTracer, parent: &Context, name: &'static str, at: SystemTime) -> Context {
    let builder = SpanBuilder::from_name(name).with_start_time(at);
    parent.with_span(tracer.build_with_context(builder, parent))
}

fn end(span: Option<Context>, at: SystemTime) {
    if let Some(span) = span {
        span.span().end_with_timestamp(at);
    }
}

#[cfg(test)]
mod tests;
