//! Tests of the room in devices' queues, against a brute-force model of a device.

use std::collections::VecDeque;
use std::sync::Arc;

use proptest::prelude::*;
use urrcp::{Span, Status};

use super::*;
use crate::act::Timing;
use crate::act::timing::{Leases, Measured, Pace};
use crate::bench::{self, Planned, R0, Tells, at, ms, response};
use crate::lead::LeadTime;
use crate::{ActIndex, ActNumber, MemberIndex};

/// Whether an act's requests may be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Open {
    Yes,
    No,
}

/// An act of one robot. `scripts` contains each device and the number of scripts that it plays.
fn act(number: u32, scripts: &[(&str, usize)], open: Open, robots: &Robots) -> Act {
    let planned: Vec<Planned> = scripts
        .iter()
        .flat_map(|(device, count)| (0..*count).map(move |index| (*device, 10 * index as i64, 10)))
        .collect();
    let act =
        Act::new(bench::played(&[&planned]), ActIndex::new(0), ActNumber::new(number), robots, at(0), None);
    if open == Open::Yes { opened(act, robots) } else { act }
}

fn opened(mut act: Act, robots: &Robots) -> Act {
    let _ = act.advance(at(0), robots, &crate::MissionOptions::default());
    let _ = act.promise(timing(at(0)), robots, None, |_| Span::ZERO);
    let _ = act.recorded();
    act
}

fn timing(now: urrcp::Timestamp<urrcp::Server>) -> Timing {
    let (lease, leases) = (ms(240), Leases::Shortened);
    let (early, late, record, lateness) = (ms(1), ms(1), ms(20), ms(0));
    let pace = Pace::of(
        &Measured {
            robots: 1,
            scripts: 1,
            questions: 1,
            leases,
            round_trip: ms(1),
            early,
            late,
            record,
            lateness,
        },
        lease,
    );
    let lead = LeadTime::needed(ms(1), 1, 1_000, &pace, lease);
    Timing::new(now, lead, pace, ms(100))
}

fn robots(queue: usize) -> Robots {
    vec![bench::robot("r0", Tells::Everything, queue)].into()
}

/// Sends all scripts that may be sent, and returns them by act and by index in the act. Each script is accepted at once, because the
/// following scripts of its device wait for that.
fn send_all(acts: &mut [Act], robots: &Robots) -> Vec<(u32, usize)> {
    let mut sent = Vec::new();
    loop {
        let sendable = sendable(acts, R0, &robots[R0]);
        let now: Vec<_> = sendable.iter().map(|script| (script.act.get(), script.script)).collect();
        assert!(now.is_sorted(), "in order of start: {now:?}");
        if now.is_empty() {
            return sent;
        }
        sent.extend(now);
        for script in sendable {
            let act = acts.iter_mut().find(|act| act.number() == script.act).unwrap();
            act.sent(at(1), script);
            says(act, script, Status::Accepted, robots);
        }
    }
}

fn ends(acts: &mut [Act], number: u32, script: usize, robots: &Robots) {
    let number = ActNumber::new(number);
    let act = acts.iter_mut().find(|act| act.number() == number).unwrap();
    says(act, ScriptRef { act: number, member: MemberIndex::new(0), script }, Status::Ok, robots);
}

fn says(act: &mut Act, script: ScriptRef, status: Status, robots: &Robots) {
    let state = act.script(script);
    let said = response(&state.plan.device.clone(), state.request_id(), status, at(2));
    let _ = act.answered(script, &said, at(3_600_000), robots);
}

#[test]
fn end_of_a_script_lets_the_next_one_follow_from_any_act() {
    let robots = robots(2);
    let mut acts = [act(0, &[("a", 2)], Open::Yes, &robots), act(1, &[("a", 2)], Open::Yes, &robots)];
    assert_eq!(send_all(&mut acts, &robots), [(0, 0), (0, 1)]);
    assert_eq!(send_all(&mut acts, &robots), []);
    ends(&mut acts, 0, 0, &robots);
    assert_eq!(send_all(&mut acts, &robots), [(1, 0)]);
    ends(&mut acts, 0, 1, &robots);
    assert_eq!(send_all(&mut acts, &robots), [(1, 1)]);
}

#[test]
fn no_script_overtakes_a_waiting_one_even_of_an_unopened_act() {
    let robots = robots(4);
    let mut acts =
        [act(0, &[("a", 1), ("b", 1)], Open::No, &robots), act(1, &[("a", 1), ("c", 1)], Open::Yes, &robots)];
    assert_eq!(send_all(&mut acts, &robots), [(1, 1)], "only where nothing is ahead of it");
}

#[test]
fn at_most_two_long_scripts_are_outstanding_with_a_measured_clock() {
    let mut robots = robots(8);
    for (clock, lease, length, expected) in [
        (ClockMode::Ntp, 2_000, 6_000, 4),
        (ClockMode::Measured, 2_000, 6_000, 2),
        // The device could continue without this machine for longer than that script.
        (ClockMode::Measured, 8_000, 6_000, 4),
        (ClockMode::Measured, 2_000, 4_000, 4),
    ] {
        robots[R0].settings.clock = clock;
        let planned: Vec<Planned> = (0..4).map(|index| ("a", length * index, length)).collect();
        let mut choreography = bench::played(&[&planned]);
        let scripts = &mut Arc::make_mut(&mut choreography).acts[0].plan.robots[0].scripts;
        let lease = Some(urrcp::Millis::from_span(ms(lease)));
        scripts.iter_mut().for_each(|script| script.stop_condition.running = lease);
        let mut acts = [opened(
            Act::new(choreography, ActIndex::new(0), ActNumber::new(0), &robots, at(0), None),
            &robots,
        )];
        let sent = send_all(&mut acts, &robots);
        assert_eq!(sent.len(), expected, "{clock:?}, lease {lease:?}, scripts of {length} ms");
        if expected < 4 {
            ends(&mut acts, 0, 0, &robots);
            assert_eq!(send_all(&mut acts, &robots), [(0, 2)]);
            // The fate of the next script is never known, so nothing waits for it.
            acts[0].mark_unknown(ScriptRef {
                act: ActNumber::new(0),
                member: MemberIndex::new(0),
                script: 1,
            });
            assert_eq!(send_all(&mut acts, &robots), [(0, 3)]);
        }
    }
}

#[test]
fn each_device_has_its_own_queue_space() {
    let robots = robots(1);
    let mut acts = [act(0, &[("a", 2), ("b", 2)], Open::Yes, &robots)];
    assert_eq!(send_all(&mut acts, &robots), [(0, 0), (0, 2)]);
    ends(&mut acts, 0, 2, &robots);
    assert_eq!(send_all(&mut acts, &robots), [(0, 3)]);
}

#[test]
fn script_left_on_a_left_out_robot_takes_space_and_no_other_is_sent() {
    let robots = robots(1);
    let mut acts = [act(0, &[("a", 1)], Open::Yes, &robots), act(1, &[("a", 1)], Open::Yes, &robots)];
    assert_eq!(send_all(&mut acts, &robots).len(), 1);
    acts[0].drop_robot(R0);
    assert_eq!(sendable(&acts, R0, &robots[R0]), []);
    acts[1].drop_robot(R0);
    ends(&mut acts, 0, 0, &robots);
    assert_eq!(sendable(&acts, R0, &robots[R0]), []);
}

#[test]
fn act_fits_when_its_first_scripts_have_room_behind_all_earlier_ones() {
    let robots = robots(3);
    for (ahead, fit) in [(1, true), (2, true), (3, false), (4, false)] {
        let acts = [act(0, &[("a", ahead)], Open::Yes, &robots), act(1, &[("a", 2)], Open::No, &robots)];
        assert_eq!(fits(&acts, 1, &robots), fit, "{ahead} ahead");
        let elsewhere = [act(0, &[("b", ahead)], Open::Yes, &robots), act(1, &[("a", 2)], Open::No, &robots)];
        assert!(fits(&elsewhere, 1, &robots));
    }
}

/// A brute-force device: it holds at most `queue` scripts, and all others wait in one line.
struct Device {
    queue: usize,
    held: VecDeque<(u32, usize)>,
    line: VecDeque<(u32, usize, Open)>,
}

impl Device {
    fn takes(&mut self) -> Vec<(u32, usize)> {
        let mut taken = Vec::new();
        while self.held.len() < self.queue && self.line.front().is_some_and(|(.., open)| *open == Open::Yes) {
            let Some((act, script, _)) = self.line.pop_front() else { break };
            self.held.push_back((act, script));
            taken.push((act, script));
        }
        taken
    }
}

proptest! {
    #[test]
    fn ledger_behaves_like_a_queue_for_each_device(
        queue in 1_usize..=4,
        counts in prop::collection::vec((0_usize..5, 0_usize..5, any::<bool>()), 1..4),
        ends_on in prop::collection::vec(any::<bool>(), 0..24),
    ) {
        let robots = robots(queue);
        let open = |open| if open { Open::Yes } else { Open::No };
        let mut acts: Vec<Act> = (0..).zip(&counts)
            .map(|(number, (a, b, is_open))| act(number, &[("a", *a), ("b", *b)], open(*is_open), &robots))
            .collect();
        let mut devices = ["a", "b"].map(|_| Device { queue, held: VecDeque::new(), line: VecDeque::new() });
        for (number, (a, b, is_open)) in (0..).zip(&counts) {
            devices[0].line.extend((0..*a).map(|script| (number, script, open(*is_open))));
            devices[1].line.extend((0..*b).map(|script| (number, a + script, open(*is_open))));
        }
        for which in std::iter::once(None).chain(ends_on.into_iter().map(Some)) {
            if let Some(ended) = which.and_then(|which| devices[usize::from(which)].held.pop_front()) {
                ends(&mut acts, ended.0, ended.1, &robots);
            }
            let mut expected = [devices[0].takes(), devices[1].takes()].concat();
            let mut sent = send_all(&mut acts, &robots);
            expected.sort_unstable();
            sent.sort_unstable();
            prop_assert_eq!(sent, expected);
        }
    }
}
