//! The table of the preflight.

use super::*;

#[track_caller]
fn verdict(mission: &Mission, check: Check, now: i64) -> Verdict {
    let table = preflight::table(mission, at(now));
    table.rows[0].checks.iter().find(|(of, _)| *of == check).unwrap().1.clone()
}

fn asked() -> Mission {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    mission
}

#[test]
fn identity_version_and_description_are_checked_once_reported() {
    let mut mission = asked();
    for (introduced, identity, version, description) in [
        (false, Verdict::NotChecked, Verdict::NotChecked, Verdict::NotChecked),
        (true, Verdict::Pass("r0".into()), Verdict::Pass("1".into()), Verdict::Pass("fits".into())),
    ] {
        mission.robots[R0].greeted.introduced = introduced;
        assert_eq!(verdict(&mission, Check::Identity, 0), identity);
        assert_eq!(verdict(&mission, Check::Version, 0), version);
        assert_eq!(verdict(&mission, Check::Description, 0), description);
    }
}

#[test]
fn link_delays_and_clock_offset_are_shown_in_milliseconds() {
    let mut mission = asked();
    assert_eq!(verdict(&mission, Check::Link, 0), Verdict::Warning("not there".into()));
    assert_eq!(verdict(&mission, Check::Clock, 0), Verdict::NotChecked);
    mission.robots[R0].connected(at(0));
    assert_eq!(verdict(&mission, Check::Link, 0), Verdict::Pass("up".into()), "it has not said its name");
    mission.robots[R0].named();
    assert_eq!(verdict(&mission, Check::Link, 0), Verdict::Pass("up".into()));
    let there = by_robot(at(7));
    mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(4)));
    assert_eq!(verdict(&mission, Check::Link, 4), Verdict::Pass("4.00 to 4.00 ms".into()));
    let Verdict::Pass(clock) = verdict(&mission, Check::Clock, 4) else { panic!() };
    assert!(clock == "5.00 ±3.00 ms", "{clock}");
    let offset = preflight::table(&mission, at(4)).rows[0].clock_offset.unwrap();
    assert!((offset - Span::from_millis(5)).abs() < Span::from_micros(1), "{offset}");
    mission.robots[R0].settings.clock = ClockMode::Measured;
    let Verdict::Pass(clock) = verdict(&mission, Check::Clock, 4) else { panic!() };
    assert!(clock.ends_with(" ms, measured"), "{clock}");
}

#[test]
fn lost_link_is_reported_with_its_reason() {
    let mut mission = asked();
    let down = Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() };
    let _reconnects = mission.handle(at(0), down);
    assert_eq!(verdict(&mission, Check::Link, 0), Verdict::Warning("it broke".into()));
}

#[test]
fn certificate_expiring_within_a_month_is_reported_in_days() {
    const DAY: i64 = 24 * 3_600 * 1_000;
    for (days, expected) in
        [(None, None), (Some(31), None), (Some(30), None), (Some(29), Some("expires in 29 days"))]
            .into_iter()
            .chain([(Some(1), Some("expires in 1 day:")), (Some(-3), Some("expires in 0 days"))])
    {
        let mut mission = asked();
        mission.robots[R0].greeted.introduced = true;
        mission.robots[R0].identity.certified_until = days.map(|days| at(days * DAY));
        let verdict = verdict(&mission, Check::Identity, 0);
        match (&verdict, expected) {
            (Verdict::Pass(_), None) => {}
            (Verdict::Warning(text), Some(expected)) => assert!(text.contains(expected), "{text}"),
            other => panic!("{days:?}: {other:?}"),
        }
    }
}

#[test]
fn certificate_of_a_replaced_authority_is_reported() {
    let mut mission = asked();
    mission.robots[R0].greeted.introduced = true;
    let proven =
        |is_of_replaced_authority| Event::Proven { robot: R0, until: None, is_of_replaced_authority };
    for (is_replaced, expected) in [(true, true), (false, false)] {
        let _nothing = mission.handle(at(0), proven(is_replaced));
        let verdict = verdict(&mission, Check::Identity, 0);
        let is_reported = matches!(&verdict, Verdict::Warning(text) if text.contains("is being replaced"));
        assert_eq!(is_reported, expected, "{verdict:?}");
    }
}

#[test]
fn hardware_passes_once_an_asked_robot_has_responded() {
    let mut mission = asked();
    assert_eq!(verdict(&mission, Check::Hardware, 0), Verdict::NotChecked);
    let there = by_robot(at(1));
    mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(2)));
    assert_eq!(verdict(&mission, Check::Hardware, 2), Verdict::Pass("there".into()));
    mission.options.greeting = Greeting::Skip;
    assert_eq!(verdict(&mission, Check::Hardware, 2), Verdict::NotChecked);
}

#[test]
fn read_positions_are_counted() {
    let mut mission = asked();
    assert_eq!(verdict(&mission, Check::Position, 0), Verdict::NotChecked);
    mission.robots[R0].pose.read = vec![("a".parse().unwrap(), 1.0), ("b".parse().unwrap(), 2.0)];
    assert_eq!(verdict(&mission, Check::Position, 0), Verdict::Pass("2 read".into()));
}

#[test]
fn robot_seized_from_another_session_is_reported() {
    let mut mission = asked();
    mission.options.session = Some(Session::named("s".parse().unwrap()));
    mission.robots[R0].connected(at(0));
    mission.robots[R0].named();
    mission.robots[R0].identity.ownership = super::super::seize::Ownership::Seized;
    let text = "ours, taken over from another session";
    assert_eq!(verdict(&mission, Check::Free, 0), Verdict::Warning(text.into()));
}

#[test]
fn failures_are_in_their_column_and_omitted_ones_counted_in_the_first() {
    let mut mission = asked();
    mission.note_failure(R0, FailureKind::Garbled { reason: "x".into() });
    let Verdict::Failure(one) = verdict(&mission, Check::Link, 0) else { panic!() };
    assert!(!one.contains("more failures"), "{one}");
    for _ in 0..65 {
        mission.note_failure(R0, FailureKind::Garbled { reason: "x".into() });
    }
    mission.note_failure(R0, FailureKind::WrongVersion { version: "2".into() });
    let Verdict::Failure(link) = verdict(&mission, Check::Link, 0) else { panic!() };
    assert!(link.ends_with("; 2 more failures"), "{link}");
    let Verdict::Failure(version) = verdict(&mission, Check::Version, 0) else { panic!() };
    assert!(!version.contains("more"), "{version}");
}

#[test]
fn readings_are_required_sensors_then_positions_then_shown_devices() {
    for (greeting, count) in [(Greeting::Full, 4), (Greeting::Skip, 3)] {
        let mut mission = asked();
        mission.options.greeting = greeting;
        let state = &mut mission.robots[R0];
        state.block.as_mut().unwrap().devices[0].interpolation = urrcp::Interpolation::Linear;
        let range = SensorRange::Above(50.0);
        state.settings.require = vec![Requirement { sensor: "eye".parse().unwrap(), range }];
        state.greeted.readings = vec![None];
        state.pose.read = vec![("a".parse().unwrap(), 44.0)];
        state.greeted.shown = vec![("b".parse().unwrap(), None), ("c".parse().unwrap(), Some(3.0))];
        for device in ["eye", "b", "c"] {
            state.greeted.unread.insert(device.parse().unwrap(), "it is dark".to_owned());
        }
        let readings = preflight::table(&mission, at(0)).rows[0].readings.clone();
        assert_eq!(readings.len(), count);
        let of = |device: &str| readings.iter().find(|reading| reading.device.as_str() == device);
        if let Some(eye) = of("eye") {
            assert_eq!((eye.reading, eye.why.as_deref()), (None, Some("it is dark")));
            assert!(eye.expected.is_some());
        }
        assert!(of("a").unwrap().expected.as_ref().is_some_and(|text| text.starts_with("45 ±")));
        assert_eq!(of("b").unwrap().why.as_deref(), Some("it is dark"));
        assert_eq!((of("c").unwrap().reading, of("c").unwrap().why.as_deref()), (Some(3.0), None));
    }
}

#[test]
fn sensors_are_not_checked_if_none_is_required() {
    let mut mission = asked();
    assert!(mission.robots[R0].settings.require.is_empty());
    mission.robots[R0].greeted.readings.clear();
    assert_eq!(verdict(&mission, Check::Sensors, 0), Verdict::NotChecked);
}
