//! Creates records of missions for tests.

use downbeat_mission::report::{ActFate, ActReport, DeviceReport, DeviceState};
use downbeat_mission::{ActFlaws, ActIndex, ActNumber, ActOver, LeadTime, Promise, PromisedScript, Record};
use urrcp::{ContentHash, Millis, Span, Timestamp};

/// A promised script for the device `d` of the robot `r`.
pub(crate) fn script(request: &str, content_hash: ContentHash) -> PromisedScript {
    PromisedScript {
        robot: "r".parse().unwrap(),
        device: "d".parse().unwrap(),
        request_id: request.parse().unwrap(),
        content_hash,
        shift: Span::ZERO,
        start: Millis::default(),
        duration: Span::ZERO,
        running: None,
    }
}

/// The record of an act that is sent at the start of 1970.
pub(crate) fn prepared(number: u32, scripts: Vec<PromisedScript>) -> Record {
    Record::Prepared(Promise {
        number: ActNumber::new(number),
        act: ActIndex::new(number as usize),
        timestamp: Timestamp::from_nanos(0),
        start: Timestamp::from_nanos(0),
        lease: Span::ZERO,
        prepared_again: 0,
        scripts,
    })
}

/// The record of an act that was played.
pub(crate) fn ended(report: ActReport) -> Record {
    Record::ActEnded {
        over: ActOver { act: ActIndex::new(report.number.get() as usize), fate: ActFate::Played },
        report: Box::new(report),
        flaws: ActFlaws::default(),
        again: false,
    }
}

/// The report of an act in which no robot plays.
pub(crate) fn report(act: &str, number: u32) -> ActReport {
    ActReport {
        act: act.to_owned(),
        number: ActNumber::new(number),
        timestamp: Timestamp::from_nanos(0),
        start: Timestamp::from_nanos(0),
        lead: LeadTime { prepare: Span::ZERO, lease: Span::ZERO, margin: Span::ZERO },
        slowest: None,
        gap: None,
        skew: None,
        spread: None,
        margin_left: None,
        window: None,
        doubt: Span::ZERO,
        prepared_again: 0,
        readings: Vec::new(),
        motions: Vec::new(),
        motion_spread: None,
        robots: Vec::new(),
    }
}

/// The report of a script that has not begun.
pub(crate) fn device(id: &str, state: DeviceState) -> DeviceReport {
    DeviceReport {
        device: id.parse().unwrap(),
        state,
        planned_start: None,
        started_at: None,
        start_error: None,
        steps_done: 0,
        steps_planned: 3,
        late_steps: 0,
        late_max: None,
    }
}
