//! Stops: how they are sent, repeated, and named.

use urrcp::ControlRequest;

use super::*;
use crate::mission::bench::ms;

fn stops_in(actions: &[Action]) -> Vec<ControlRequest> {
    let stop = |action: &Action| match action {
        Action::Send { message: Message::ControlRequest(request), .. } => Some(request.clone()),
        _ => None,
    };
    actions.iter().filter_map(stop).collect()
}

fn asked_to_stop(mission: &mut Mission, now: i64, rest: Rest) -> Vec<ControlRequest> {
    stops_in(&mission.handle(at(now), Event::StopRequested { rest, by: None }))
}

fn sent() -> Mission {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: 0 });
    mission
}

#[test]
fn a_robot_holds_where_it_is_or_goes_to_rest_as_the_operator_says() {
    for (rest, holds) in [(Rest::Hold, true), (Rest::Default, false)] {
        let stops = asked_to_stop(&mut sent(), 1, rest);
        assert_eq!(stops.iter().map(|stop| stop.hold).collect::<Vec<_>>(), [holds], "{rest:?}");
    }
}

#[test]
fn the_operators_latest_word_counts_and_the_same_word_again_sends_nothing() {
    let mut mission = sent();
    assert_eq!(asked_to_stop(&mut mission, 1, Rest::Default).len(), 1);
    assert_eq!(asked_to_stop(&mut mission, 2, Rest::Default).len(), 0);
    let stops = asked_to_stop(&mut mission, 3, Rest::Hold);
    assert_eq!(stops.iter().map(|stop| stop.hold).collect::<Vec<_>>(), [true]);
}

#[test]
fn a_stop_that_is_not_confirmed_is_sent_again_and_given_up_when_patience_ends() {
    let mut mission = sent();
    let first = asked_to_stop(&mut mission, 1, Rest::Default);
    let (again, ends) = (at(201), at(1) + mission.options.patience);
    assert_eq!(mission.next_wakeup(), Some(again));
    assert_eq!(mission.advance(again - Span::from_nanos(1)).len(), 0);
    assert_eq!(stops_in(&mission.advance(again)), first, "the same request");
    assert_eq!(mission.robots[0].totals.retries, 1);
    assert_eq!(mission.next_wakeup(), Some(at(401)));
    let _ended = mission.advance(ends);
    assert!(mission.outcome().is_some());
}

#[test]
fn on_a_slow_link_a_stop_has_three_round_trips_to_be_confirmed() {
    let mut mission = sent();
    let there = by_robot(at(100));
    mission.robots[0].clock.add(ClockSample::from_exchange(at(0), there, there, at(200)));
    let _stops = asked_to_stop(&mut mission, 300, Rest::Default);
    assert_eq!(mission.next_wakeup(), Some(at(900)));
}

#[test]
fn the_names_of_stops_begin_with_the_session() {
    for (session, begin) in [(None, "stop/"), (Some("show"), "show/stop/")] {
        let mut mission = begins_at_once(Everything);
        mission.options.session = session.map(|name| Session::named(name.parse().unwrap()));
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: 0 });
        let stops = asked_to_stop(&mut mission, 1, Rest::Default);
        let name = stops[0].request_id.as_ref().unwrap().as_str();
        assert!(name.starts_with(begin), "{name}");
        assert_eq!(stops[0].timestamp, Some(at(1)), "what was sent before it is taken back");
    }
}

#[test]
fn a_robot_is_stopped_otherwise_only_if_it_was_stopped_in_another_way() {
    let mut mission = sent();
    let otherwise =
        |mission: &Mission| [Rest::Default, Rest::Hold].map(|rest| mission.robots[0].stops_otherwise(rest));
    assert_eq!(otherwise(&mission), [false, false], "no stop was sent");
    mission.stop_robot(at(1), 0, Rest::Hold);
    assert_eq!(otherwise(&mission), [true, false]);
    mission.robots[0].stop = Stop::Confirmed(Rest::Default);
    assert_eq!(otherwise(&mission), [false, true]);
}

#[test]
fn what_a_failure_has_stopped_stays_as_it_is_whatever_the_operator_says() {
    let mut mission = sent();
    mission.abort(at(1), Outcome::Failed, Rest::Hold, Some(0));
    assert_eq!(stops_in(&std::mem::take(&mut mission.actions)).len(), 1);
    assert_eq!(mission.then, Some(0));
    assert_eq!(asked_to_stop(&mut mission, 2, Rest::Default).len(), 0);
    assert_eq!((mission.then, mission.outcome.clone()), (None, Some(Outcome::Stopped)), "nothing follows");
    let _ends = mission.advance(at(1) + mission.options.patience + ms(1));
    assert_eq!(mission.outcome(), Some(&Outcome::Stopped));
}

#[test]
fn a_journal_that_is_lost_stops_the_mission_and_lets_nothing_follow_a_stop() {
    let lost = || Event::JournalLost { reason: "full".to_owned() };
    let mut mission = begins_at_once(Everything);
    let _refused = mission.handle(at(0), lost());
    assert!(matches!(mission.outcome(), Some(Outcome::JournalLost { .. })), "{:?}", mission.outcome());

    let mut mission = sent();
    assert_eq!(stops_in(&mission.handle(at(1), lost())).len(), 1);
    assert!(matches!(mission.outcome, Some(Outcome::JournalLost { .. })));

    let mut mission = sent();
    mission.abort(at(1), Outcome::Failed, Rest::Hold, Some(0));
    let _told = mission.handle(at(2), lost());
    assert_eq!(mission.then, None);
}
