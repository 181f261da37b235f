//! Spans of missions as an exporter sees them.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{SpanData, SpanExporter};

use super::*;

/// Keeps what it is to export.
#[derive(Clone, Debug, Default)]
struct Kept(Arc<Mutex<Vec<SpanData>>>);

impl SpanExporter for Kept {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        self.0.lock().unwrap().extend(batch);
        Ok(())
    }
}

fn at(millis: i64) -> Timestamp<Server> {
    Timestamp::from_nanos(1_700_000_000_000_000_000 + millis * 1_000_000)
}

/// The spans of these notes, each with its millisecond.
fn spans(notes: &[(i64, Note)]) -> Vec<SpanData> {
    let exporter = Kept::default();
    let provider = SdkTracerProvider::builder().with_simple_exporter(exporter.clone()).build();
    let (trace, watch) = Trace::begin(provider, "show".to_owned(), at(0)).unwrap();
    notes.iter().for_each(|(millis, note)| watch.hand_over(at(*millis), note.clone()));
    drop(watch);
    trace.thread.join().unwrap();
    exporter.0.lock().unwrap().clone()
}

fn robot() -> RobotId {
    RobotId::new("arm").unwrap()
}

fn act() -> Vec<(i64, Note)> {
    vec![
        (10, Note::Greeted),
        (20, Note::Preparing("one".to_owned())),
        (30, Note::Decided("one".to_owned())),
        (40, Note::Committed("one".to_owned())),
        (50, Note::Started(robot(), Some(0.25))),
        (60, Note::Finished(robot())),
        (70, Note::ActOver("one".to_owned(), None)),
        (80, Note::Ended("done".to_owned())),
    ]
}

/// Name, name of the parent, begin and end in milliseconds.
fn told(spans: &[SpanData]) -> Vec<(String, String, u128, u128)> {
    let begin = system_time(at(0));
    let since = |time: SystemTime| time.duration_since(begin).unwrap().as_millis();
    let parent = |span: &SpanData| spans.iter().find(|of| of.span_context.span_id() == span.parent_span_id);
    let mut told: Vec<_> = spans
        .iter()
        .map(|span| {
            let parent = parent(span).map_or(String::new(), |parent| parent.name.to_string());
            (span.name.to_string(), parent, since(span.start_time), since(span.end_time))
        })
        .collect();
    told.sort_by_key(|(_, _, begin, end)| (*begin, std::cmp::Reverse(*end)));
    told
}

#[test]
fn a_mission_is_a_tree_of_spans_at_the_instants_of_its_own_clock() {
    let of = |name: &str, parent: &str, begin, end| (name.to_owned(), parent.to_owned(), begin, end);
    assert_eq!(
        told(&spans(&act())),
        [
            of("mission", "", 0, 80),
            of("greeting", "mission", 0, 10),
            of("act", "mission", 20, 70),
            of("prepare", "act", 20, 30),
            of("commit", "act", 30, 40),
            of("play", "act", 40, 70),
            of("robot plays", "play", 50, 60),
        ]
    );
}

#[test]
fn a_failure_marks_the_robot_and_the_mission_and_all_spans_end_with_it() {
    let mut notes = act()[..5].to_vec();
    notes.extend([
        (55, Note::Failed(robot(), "link down".to_owned())),
        (56, Note::Stopping("why".to_owned())),
    ]);
    let spans = spans(&notes);
    let failed: Vec<_> = spans.iter().filter(|span| matches!(span.status, Status::Error { .. })).collect();
    assert_eq!(failed.iter().map(|span| &*span.name).collect::<Vec<_>>(), ["robot plays", "mission"]);
    assert_eq!(spans.len(), 8, "all that began have ended: {:?}", told(&spans));
}

#[test]
fn a_mission_never_waits_for_its_trace() {
    let (notes, _kept) = sync_channel(1);
    let watch = TraceWatch(notes);
    (0..1_000).for_each(|millis| watch.hand_over(at(millis), Note::Greeted));
}

#[test]
fn spans_are_sent_to_the_collector() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let collector = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let (mut heard, mut part) = (Vec::new(), [0; 4_096]);
        // The request of a mission is small; it is complete with the name of its last span.
        while !heard.windows(11).any(|window| window == b"robot plays") {
            let read = stream.read(&mut part).unwrap();
            assert!(read > 0, "{}", String::from_utf8_lossy(&heard));
            heard.extend_from_slice(&part[..read]);
        }
        stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n").unwrap();
        String::from_utf8_lossy(&heard).into_owned()
    });
    let provider = super::super::export::exporting_to(Some(&format!("http://{address}/v1/traces"))).unwrap();
    let (trace, watch) = Trace::begin(provider, "show".to_owned(), at(0)).unwrap();
    act().into_iter().for_each(|(millis, note)| watch.hand_over(at(millis), note));
    drop(watch);
    trace.finish();
    let heard = collector.join().unwrap();
    assert!(heard.starts_with("POST /v1/traces HTTP/1.1\r\n"), "{heard}");
    assert!(heard.to_lowercase().contains("content-type: application/x-protobuf"), "{heard}");
    assert!(heard.contains("downbeat.start_error_ms"), "{heard}");
}
