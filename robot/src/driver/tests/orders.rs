//! Tests the orders that wait between the robot and its driver's thread.

use std::time::Instant;

use super::*;

/// Returns a mailbox whose clock is stopped, and the time of this clock, so that no ping becomes due while a test runs.
#[expect(clippy::disallowed_methods, reason = "an instant for a stopped clock")]
fn stopped() -> (Mailbox, Instant) {
    let now = Instant::now();
    (Mailbox::stopped_at(now), now)
}

#[test]
fn script_cancelled_before_delivery_never_reaches_the_driver() {
    let (mailbox, now) = stopped();
    mailbox.connected(1, mailbox::DriverTraits { acknowledges: true, ..MANNERS });
    let arm = DeviceId::new("arm").unwrap();
    let part = empty_plan(&arm);
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
    assert!(matches!(mailbox.next(now), mailbox::Work::Plan(mailbox::PlanOrder::Cancel(_))));
    assert!(matches!(mailbox.next(now), mailbox::Work::Confirm(tickets) if tickets == [Ticket(1)]));
}

#[test]
fn orders_of_earlier_connections_are_void_and_newer_values_replace_older() {
    let (mailbox, now) = stopped();
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
    let values: Vec<_> = std::iter::from_fn(|| match mailbox.next(now) {
        mailbox::Work::Drive(drives) => {
            let [(key, Some(value), None)] = drives.as_slice() else { panic!("{drives:?}") };
            Some((key.0.to_string(), value.setpoint.value))
        }
        _ => None,
    })
    .collect();
    assert_eq!(values, [("a".to_owned(), 5.0), ("b".to_owned(), 4.0)]);
    mailbox.connected(1, MANNERS);
    mailbox.post(1, [set("a", 6.0)].into_iter(), Demand::default());
    mailbox.disconnected();
    mailbox.connected(2, MANNERS);
    mailbox.post(1, [set("a", 7.0)].into_iter(), Demand::default());
    assert!(matches!(mailbox.next(now), mailbox::Work::Closed));
}

#[test]
fn driver_with_frames_receives_all_pending_values_at_once() {
    let (mailbox, now) = stopped();
    mailbox.connected(1, mailbox::DriverTraits { acknowledges: true, takes_frames: true, ..MANNERS });
    let set = |device: &str, value| {
        let setpoint = Setpoint::new(ControlType::Speed, value);
        let key = (DeviceId::new(device).unwrap(), ControlType::Speed);
        mailbox::Order::Set(key, mailbox::Value { setpoint, due: None })
    };
    mailbox.post(1, [set("a", 1.0), set("b", 2.0)].into_iter(), Demand::default());
    let mailbox::Work::Drive(frame) = mailbox.next(now) else { panic!("nothing to drive") };
    let frame: Vec<_> = frame.iter().map(|(key, ..)| key.0.as_str()).collect();
    assert_eq!(frame, ["a", "b"]);
    mailbox.close();
    assert!(matches!(mailbox.next(now), mailbox::Work::Closed));
}

#[tokio::test]
async fn unrequested_reading_expires_with_its_time_and_its_connection() {
    let mailbox = Arc::new(Mailbox::default());
    let pushes = Pushes::into(Arc::clone(&mailbox));
    let eye = DeviceId::new("eye").unwrap();
    pushes.reading(&eye, 1.0);
    assert_eq!(mailbox.pushed(&eye, Duration::MAX), None, "nothing is connected");
    mailbox.connected(1, MANNERS);
    pushes.reading(&eye, 2.0);
    assert_eq!(mailbox.pushed(&eye, Duration::from_secs(600)).map(|reading| reading.value), Some(2.0));
    tokio::time::sleep(Duration::from_millis(2)).await;
    assert_eq!(mailbox.pushed(&eye, Duration::from_millis(1)), None, "too old");
    pushes.fault("stuck");
    let soon = HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    assert!(matches!(mailbox.next(soon), mailbox::Work::Fault(reason) if reason == "stuck"));
    mailbox.disconnected();
    assert_eq!(mailbox.pushed(&eye, Duration::MAX), None);
}

#[test]
fn driver_reports_about_a_script_are_passed_on_unchanged() {
    let mailbox = Arc::new(Mailbox::default());
    let pushes = Pushes::into(Arc::clone(&mailbox));
    mailbox.connected(1, MANNERS);
    let soon = HostClock::anchored().instant_of(Timestamp::from_nanos(0));
    pushes.plan(crate::PlanId(1), Timestamp::from_nanos(5), PlanEvent::Began);
    let mailbox::Work::Words(words) = mailbox.next(soon) else { panic!("no report arrived") };
    assert_eq!(
        (words[0].plan, words[0].at, &words[0].event),
        (crate::PlanId(1), Timestamp::from_nanos(5), &PlanEvent::Began)
    );
}
