//! Tests which work a driver's thread receives, and which orders it skips.

use super::*;
use crate::tolerance::STALE;

#[test]
fn value_is_stale_only_beyond_its_limit() {
    let due = Instant::now();
    let value = |due| Value { setpoint: Setpoint::new(ControlType::Position, 1.0), due };
    let beyond = STALE + Duration::from_nanos(1);
    assert_eq!(value(Some(due)).stale(due + STALE, STALE), None);
    assert_eq!(value(Some(due)).stale(due + beyond, STALE), Some(beyond));
    assert_eq!(value(None).stale(due + beyond, STALE), None, "the default state is never too old");
}

const MANNERS: DriverTraits = DriverTraits {
    acknowledges: false,
    takes_frames: false,
    ping_period: Duration::from_millis(25),
    silence_max: None,
};
const MS: Duration = Duration::from_millis(1);

fn id(device: &str) -> DeviceId {
    DeviceId::new(device).unwrap()
}

fn set(device: &str, value: f64) -> Order {
    let value = Value { setpoint: Setpoint::new(ControlType::Speed, value), due: None };
    Order::Set((id(device), ControlType::Speed), value)
}

fn confirm(ticket: u64, device: &str) -> Order {
    Order::Confirm(Ticket(ticket), id(device))
}

/// Returns an order to cancel a script. The mailbox keeps its position relative to values, as for a script.
fn plan(device: &str) -> Order {
    let (plan, then) = (crate::PlanId(1), crate::Then::Keep);
    let cancel = PlanCancel { plan, device: id(device), then, why: String::new() };
    Order::Plan(PlanOrder::Cancel(cancel))
}

fn word(plan: u64) -> PlanReport {
    let (plan, at) = (crate::PlanId(plan), urrcp::Timestamp::from_nanos(0));
    PlanReport { plan, at, event: crate::plans::PlanEvent::Began }
}

/// Returns a mailbox without a connection. Its clock is stopped, so that no ping becomes due while a test runs.
fn empty() -> Mailbox {
    Mailbox::stopped_at(Instant::now())
}

/// Returns a mailbox that has its first connection and contains these orders.
fn with<const N: usize>(orders: [Order; N]) -> Mailbox {
    let mailbox = empty();
    mailbox.connected(1, MANNERS);
    mailbox.post(1, orders.into_iter(), Demand::default());
    mailbox
}

/// Summarizes the next work of a driver's thread.
fn next(mailbox: &Mailbox) -> String {
    match mailbox.next(mailbox.now()) {
        Work::Drive(drives) => {
            let shown = |(key, value, movement): &Drive| {
                let value = value.as_ref().map(|value| format!(" {}", value.setpoint.value));
                let movement = movement.map_or("", |_| " and on");
                format!("{}{}{movement}", key.0, value.unwrap_or_default())
            };
            drives.iter().map(shown).collect::<Vec<_>>().join(", ")
        }
        Work::Read(reading, sensor) => format!("read {sensor} {}", reading.0),
        Work::Plan(order) => format!("plan of {}", order.device()),
        Work::Words(words) => format!("{} words", words.len()),
        Work::Confirm(tickets) => {
            format!("confirm {:?}", tickets.iter().map(|t| t.0).collect::<Vec<_>>())
        }
        Work::Ping => "ping".to_owned(),
        Work::HungUp(reason) => format!("hung up: {reason}"),
        Work::Fault(reason) => format!("fault: {reason}"),
        Work::Nothing => "nothing".to_owned(),
        Work::Closed => "closed".to_owned(),
    }
}

#[test]
fn answer_confirms_completed_orders_of_a_device_and_no_pending_ones() {
    let mailbox = with([set("a", 1.0), confirm(1, "a"), confirm(2, "b"), set("b", 2.0), set("a", 3.0)]);
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [2]", "later requests do not count");
    assert_eq!(next(&mailbox), "a 3");
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "b 2", "the driver has it in hand");
    mailbox.called(MS, Sign::Unknown);
    assert_eq!(next(&mailbox), "nothing", "the hardware itself has not answered");
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [1]");
    assert_eq!(next(&mailbox), "nothing");
}

#[test]
fn device_is_confirmed_while_orders_for_other_devices_are_pending() {
    let mailbox = with([set("a", 1.0), set("b", 2.0), plan("c"), confirm(1, "d")]);
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [1]");
    mailbox.post(1, [confirm(2, "d")].into_iter(), Demand::default());
    assert_eq!(next(&mailbox), "a 1");
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [2]");
}

#[test]
fn script_that_waits_or_is_being_sent_is_not_confirmed() {
    let mailbox = with([plan("a"), confirm(1, "a")]);
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "plan of a");
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "nothing");
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [1]");
    let mailbox = with([confirm(1, "a"), plan("a")]);
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "confirm [1]", "it was wanted later");
}

#[test]
fn acknowledged_values_are_confirmed_without_a_ping() {
    let mailbox = empty();
    mailbox.connected(1, DriverTraits { acknowledges: true, ..MANNERS });
    mailbox.post(1, [set("a", 1.0), confirm(1, "a")].into_iter(), Demand::default());
    assert_eq!([next(&mailbox), next(&mailbox)], ["a 1", "confirm [1]"]);
}

#[test]
fn values_and_scripts_keep_the_order_of_their_requests() {
    let mailbox = with([set("a", 1.0), plan("b"), set("a", 2.0), set("c", 3.0)]);
    let all: Vec<_> = std::iter::repeat_with(|| next(&mailbox)).take(4).collect();
    assert_eq!(all, ["a 2", "plan of b", "c 3", "nothing"], "the newer value keeps the place of the older");
}

#[test]
fn movement_follows_its_value_and_ends_with_a_newer_value() {
    let signal = Signal::resting(1.0, urrcp::Timestamp::from_nanos(0));
    let movement = Movement { signal, clock: HostClock::anchored() };
    let follow = || Order::Follow((id("a"), ControlType::Speed), movement);
    assert_eq!(next(&with([set("a", 1.0), follow()])), "a 1 and on");
    assert_eq!(next(&with([set("a", 1.0), follow(), set("a", 2.0)])), "a 2");
}

#[test]
fn script_reports_alternate_with_other_work_and_precede_fault_and_end() {
    let mailbox = with([set("a", 1.0), set("b", 2.0)]);
    mailbox.told_of_plan(word(1));
    assert_eq!(next(&mailbox), "1 words");
    mailbox.told_of_plan(word(1));
    mailbox.told_of_plan(word(2));
    assert_eq!([next(&mailbox), next(&mailbox), next(&mailbox)], ["a 1", "2 words", "b 2"]);
    mailbox.told_of_plan(word(1));
    mailbox.hung_up(1, "cut".to_owned());
    mailbox.failed_by_itself("hot".to_owned());
    assert_eq!([next(&mailbox), next(&mailbox), next(&mailbox)], ["1 words", "fault: hot", "hung up: cut"]);
    mailbox.told_of_plan(word(1));
    assert_eq!(mailbox.words().len(), 1);
    assert_eq!(next(&mailbox), "nothing");
    mailbox.told_of_plan(word(1));
    assert_eq!(next(&mailbox), "1 words");
    mailbox.told_of_plan(word(1));
    assert_eq!(next(&mailbox), "1 words", "nothing else waits for its turn");
}

#[test]
fn driver_that_sends_too_many_script_reports_at_once_has_failed() {
    let mailbox = with([]);
    (0..WORDS_MAX).for_each(|_| mailbox.told_of_plan(word(1)));
    assert_eq!([next(&mailbox), next(&mailbox)], ["10000 words", "nothing"]);
    (0..=WORDS_MAX).for_each(|_| mailbox.told_of_plan(word(1)));
    assert_eq!(next(&mailbox), "10000 words");
    assert_eq!(next(&mailbox), "fault: the driver sent more than 10000 reports about scripts at once");
}

#[test]
fn events_without_a_connection_do_not_reach_the_next_connection() {
    let mailbox = empty();
    mailbox.told_of_plan(word(1));
    mailbox.failed_by_itself("hot".to_owned());
    mailbox.hung_up(1, "cut".to_owned());
    mailbox.read_by_itself(&id("eye"), 1.0);
    mailbox.connected(1, MANNERS);
    assert_eq!(next(&mailbox), "nothing");
    assert_eq!(mailbox.pushed(&id("eye"), Duration::MAX), None);
    mailbox.hung_up(2, "cut".to_owned());
    assert_eq!(next(&mailbox), "nothing", "of another connection");
}

#[test]
fn end_of_a_connection_discards_everything_pending() {
    let mailbox = with([set("a", 1.0), plan("a"), Order::Read(ReadingId(1), id("eye")), confirm(1, "b")]);
    mailbox.told_of_plan(word(1));
    mailbox.hung_up(1, "cut".to_owned());
    mailbox.failed_by_itself("hot".to_owned());
    mailbox.disconnected();
    mailbox.connected(2, MANNERS);
    mailbox.called(MS, Sign::Answered);
    assert_eq!(next(&mailbox), "nothing");
    mailbox.post(2, [set("a", 2.0)].into_iter(), Demand::default());
    assert_eq!(next(&mailbox), "a 2");
}

#[test]
fn reading_waits_for_time_without_movements_but_not_for_long() {
    let mailbox = with([Order::Read(ReadingId(1), id("eye")), set("a", 1.0)]);
    let due = |after: Duration| Demand { next_due: Some(mailbox.now() + after), ..Demand::default() };
    mailbox.post(1, std::iter::empty(), due(QUIET / 2));
    assert_eq!([next(&mailbox), next(&mailbox)], ["a 1", "nothing"], "a movement is near");
    mailbox.post(1, std::iter::empty(), due(Duration::from_secs(600)));
    assert_eq!(next(&mailbox), "read eye 1");
    let long_ago = mailbox.now() - READ_WAIT_MAX;
    mailbox.lock().readings.push_back((ReadingId(2), id("eye"), long_ago));
    mailbox.post(1, std::iter::empty(), due(QUIET / 2));
    assert_eq!(next(&mailbox), "read eye 2", "it has waited long enough");
}

#[test]
fn waiting_readings_are_limited_to_the_maximum_of_open_readings() {
    let mailbox = with([]);
    let reads = (0..2 * READINGS_MAX as u64).map(|reading| Order::Read(ReadingId(reading), id("eye")));
    mailbox.post(1, reads, Demand::default());
    let asked = std::iter::repeat_with(|| next(&mailbox)).take_while(|what| what != "nothing");
    assert_eq!(asked.count(), READINGS_MAX);
}

#[test]
fn ping_waits_for_values_and_movements_until_it_is_overdue() {
    let since = |silent: Duration, due: Option<Duration>| {
        let mailbox = with([set("a", 1.0)]);
        let now = mailbox.now();
        let mut pulse = Pulse::new(now - silent, MANNERS.ping_period);
        let next_due = due.map(|due| now + due);
        pulse.demand(now, Demand { next_due, ..Demand::default() });
        mailbox.lock().pulse = Some(pulse);
        [next(&mailbox), next(&mailbox)]
    };
    assert_eq!(since(10 * MS, None), ["a 1", "nothing"]);
    assert_eq!(since(600 * MS, None), ["a 1", "ping"]);
    assert_eq!(since(600 * MS, Some(Duration::ZERO)), ["a 1", "nothing"]);
    assert_eq!(since(3_000 * MS, Some(Duration::ZERO)), ["ping", "ping"], "until it is answered");
}

#[test]
fn silence_ends_with_a_sign_of_life_and_pauses_during_a_reading() {
    let mailbox = with([]);
    assert_eq!(mailbox.silence(), None);
    let begin = mailbox.now() - Duration::from_secs(2);
    let mut pulse = Pulse::new(begin, MANNERS.ping_period);
    pulse.demand(begin, Demand { held: true, ..Demand::default() });
    mailbox.lock().pulse = Some(pulse);
    mailbox.called(Duration::ZERO, Sign::Unknown);
    assert!(mailbox.silence().is_some());
    mailbox.begin_reading();
    assert_eq!(mailbox.silence(), None);
    mailbox.end_reading();
    assert!(mailbox.silence().is_some());
    mailbox.called(Duration::ZERO, Sign::Answered);
    assert_eq!(mailbox.silence(), None);
}

#[test]
fn demand_before_a_connection_applies_to_it() {
    let mailbox = empty();
    let demand = Demand { held: true, ..Demand::default() };
    mailbox.post(0, std::iter::empty(), demand);
    mailbox.connected(1, MANNERS);
    let state = mailbox.lock();
    let next = state.pulse.as_ref().unwrap().next_ping(mailbox.now());
    assert_eq!(next, mailbox.now() + 2 * MANNERS.ping_period);
}

#[test]
fn closing_mailbox_first_delivers_values_but_no_readings() {
    let mailbox = with([Order::Read(ReadingId(1), id("eye")), set("a", 1.0), set("b", 2.0)]);
    assert!(!mailbox.is_closed());
    mailbox.close();
    assert!(mailbox.is_closed());
    assert_eq!([next(&mailbox), next(&mailbox), next(&mailbox)], ["a 1", "b 2", "closed"]);
}

#[test]
fn wait_ends_immediately_if_already_tried_or_closed() {
    let later = Duration::from_secs(3_600);
    let tried = Mailbox::default();
    tried.await_tried(Instant::now());
    tried.tried();
    tried.await_tried(Instant::now() + later);
    let closed = Mailbox::default();
    closed.close();
    closed.await_tried(Instant::now() + later);
    closed.pause(later);
    let begun = Instant::now();
    Mailbox::default().pause(Duration::from_millis(5));
    assert!(begun.elapsed() >= Duration::from_millis(5));
}

#[test]
fn known_sensor_updates_its_pushed_reading_and_sensors_are_limited() {
    let mailbox = with([]);
    for sensor in 0..PUSHED_MAX + 1 {
        mailbox.read_by_itself(&id(&format!("s{sensor}")), 1.0);
    }
    mailbox.read_by_itself(&id("s0"), 2.0);
    let told = |sensor: usize| mailbox.pushed(&id(&format!("s{sensor}")), Duration::MAX);
    assert_eq!([told(0), told(PUSHED_MAX - 1), told(PUSHED_MAX)], [Some(2.0), Some(1.0), None]);
}
