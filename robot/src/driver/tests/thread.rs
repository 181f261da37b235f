//! Tests a driver's thread alone: its reports about hardware that fails, returns, and sends unsolicited reports.

use std::time::Instant;

use super::*;
use crate::hardware::ReadingId;
use crate::tolerance::STALE;

/// Test hardware: the test determines the answer to each call.
struct AnsweringDriver<F> {
    answer: F,
    pushes: Option<Pushes>,
    frames: bool,
}

impl<F: FnMut(&str, &Pushes) -> Result<(), DriverError> + Send> AnsweringDriver<F> {
    fn call(&mut self, what: &str) -> Result<(), DriverError> {
        (self.answer)(what, self.pushes.as_ref().unwrap())
    }
}

impl<F: FnMut(&str, &Pushes) -> Result<(), DriverError> + Send> Driver for AnsweringDriver<F> {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.call("connect")
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.call(&format!("{device} {}", setpoint.value))
    }

    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        self.call(&format!("{} values", values.len()))
    }

    fn takes_frames(&self) -> bool {
        self.frames
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        self.call(&format!("read {sensor}")).map(|()| 7.0)
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        self.call("ping")
    }

    fn take_pushes(&mut self, pushes: Pushes) {
        self.pushes = Some(pushes);
    }
}

/// Summarizes a report of a driver's thread.
fn in_words(news: &News) -> String {
    match news {
        News::There { connection, .. } => format!("there {connection}"),
        News::Away { reason } => reason.clone(),
        News::Reading { reading, .. } => format!("reading {reading:?}"),
        News::Confirmed(tickets) => format!("confirmed {}", tickets.len()),
        News::Plan(PlanNews::Refused { first, error, .. }) => format!("refused {first}: {}", error.message),
        News::Plan(PlanNews::Cancelled(plan)) => format!("cancelled {}", plan.0),
        News::Plan(PlanNews::Word { plan, event, .. }) => format!("{event:?} {}", plan.0),
        News::Stale { device, .. } => format!("stale {device}"),
    }
}

/// Runs a driver's thread in the current thread until its mailbox is closed. `on` handles each report.
fn driven(
    block: &str,
    frames: bool,
    answer: impl FnMut(&str, &Pushes) -> Result<(), DriverError> + Send + 'static,
    on: impl Fn(&str, &Mailbox) + Send + 'static,
) -> (Result<(), String>, Vec<String>) {
    driven_within(Tolerance::default(), block, frames, answer, on)
}

/// Like `driven`, with these maximum delays.
fn driven_within(
    tolerance: Tolerance,
    block: &str,
    frames: bool,
    answer: impl FnMut(&str, &Pushes) -> Result<(), DriverError> + Send + 'static,
    on: impl Fn(&str, &Mailbox) + Send + 'static,
) -> (Result<(), String>, Vec<String>) {
    let (mailbox, (said, news)) = (Arc::new(Mailbox::tolerating(tolerance)), channel());
    let driver = Box::new(AnsweringDriver { answer, pushes: None, frames });
    let told = Arc::clone(&mailbox);
    let tell = move |news: News| {
        let word = in_words(&news);
        on(&word, &told);
        said.send(word).unwrap();
    };
    let block = serde_json::from_str(block).unwrap();
    let worker = Worker::new(driver, block, mailbox, DriverOptions::default(), Box::new(tell));
    (worker.run(), news.try_iter().collect())
}

fn set_order(device: &str, value: f64) -> mailbox::Order {
    let key = (DeviceId::new(device).unwrap(), ControlType::Speed);
    let setpoint = Setpoint::new(ControlType::Speed, value);
    mailbox::Order::Set(key, mailbox::Value { setpoint, due: None })
}

fn read_order(id: u64) -> mailbox::Order {
    mailbox::Order::Read(ReadingId(id), DeviceId::new("eye").unwrap())
}

fn post(mailbox: &Mailbox, connection: u64, orders: Vec<mailbox::Order>) {
    mailbox.post(connection, orders.into_iter(), Demand::default());
}

fn away(why: &str) -> Result<(), DriverError> {
    Err(DriverError::Away(why.to_owned()))
}

#[test]
fn hardware_that_reconnects_too_late_for_commands_is_reported() {
    let answer = |what: &str, _: &Pushes| if what == "wheel 4" { away("cut") } else { Ok(()) };
    let (ended, news) = driven(BLOCK, false, answer, |news, mailbox| match news {
        "there 1" => post(mailbox, 1, vec![set_order("wheel", 4.0)]),
        "there 2" => mailbox.close(),
        _ => {}
    });
    assert_eq!(news, ["there 1", "the hardware is not available: cut", "there 2"]);
    assert_eq!(ended, Err("the hardware was reconnected too late to receive commands".to_owned()));
}

#[test]
fn unavailable_hardware_is_reported_only_if_it_was_moved() {
    for (moves, expected) in [(true, Err("the hardware is not available: cut".to_owned())), (false, Ok(()))] {
        let answer = move |what: &str, pushes: &Pushes| match what {
            "wheel 4" => away("cut"),
            "connect" if !moves => {
                pushes.fault("no effect before the connection");
                away("cut")
            }
            _ => Ok(()),
        };
        let (ended, _) = driven(BLOCK, false, answer, |news, mailbox| match news {
            "there 1" => post(mailbox, 1, vec![set_order("wheel", 4.0)]),
            _ => mailbox.close(),
        });
        assert_eq!(ended, expected);
    }
}

#[test]
fn frame_is_sent_in_one_call_and_its_refusal_names_the_first_values() {
    let answer = |what: &str, _: &Pushes| match what {
        "10 values" => Err(DriverError::Refused("too hot".to_owned())),
        "2 values" | "read eye" | "connect" | "ping" => Ok(()),
        other => panic!("{other}"),
    };
    let frame = |count: u32| (0..count).map(|i| set_order(&format!("d{i}"), 1.0)).collect();
    let (_, news) = driven(BLOCK, true, answer, move |news, mailbox| match news {
        "there 1" => {
            post(mailbox, 1, vec![set_order("a", 1.0), set_order("b", 2.0), read_order(1)]);
        }
        reading if reading.starts_with("reading") => post(mailbox, 1, frame(10)),
        _ => mailbox.close(),
    });
    let refused: Vec<_> = (0..8).map(|i| format!("speed 1 of `d{i}`")).collect();
    assert_eq!(news.last(), Some(&format!("the hardware refused {}: too hot", refused.join(", "))));
}

#[test]
fn failed_reading_keeps_the_connection_unless_the_hardware_is_away() {
    let mut answers = [Err(DriverError::Refused("dark".to_owned())), Ok(()), away("cut")].into_iter();
    let answer =
        move |what: &str, _: &Pushes| if what == "read eye" { answers.next().unwrap() } else { Ok(()) };
    let (ended, news) = driven(BLOCK, false, answer, |news, mailbox| match news {
        "there 1" => post(mailbox, 1, vec![read_order(1), read_order(2), read_order(3)]),
        "the hardware is not available: cut" => mailbox.close(),
        _ => {}
    });
    let expected = [
        "there 1",
        "reading Err(\"dark\")",
        "reading Ok(7.0)",
        "reading Err(\"cut\")",
        "the hardware is not available: cut",
    ];
    assert_eq!((news, ended), (expected.map(str::to_owned).to_vec(), Ok(())), "nothing was moved");
}

#[test]
fn unrequested_reading_answers_requests_within_the_sensor_delay() {
    let at_once = BLOCK.replace(r#""max_delay": 60000"#, r#""max_delay": 0"#);
    for (block, expected) in [(BLOCK, "reading Ok(3.0)"), (&at_once, "reading Ok(7.0)")] {
        let answer = |what: &str, pushes: &Pushes| {
            if what == "wheel 4" {
                pushes.reading(&DeviceId::new("eye").unwrap(), 3.0);
            }
            Ok(())
        };
        let (_, news) = driven(block, false, answer, |news, mailbox| match news {
            "there 1" => post(mailbox, 1, vec![set_order("wheel", 4.0), read_order(1)]),
            _ => mailbox.close(),
        });
        assert_eq!(news, ["there 1", expected]);
    }
}

#[test]
fn fault_reported_by_the_hardware_ends_its_connection() {
    let mut faults = 0;
    let answer = move |what: &str, pushes: &Pushes| {
        if what == "wheel 4" && faults == 0 {
            faults += 1;
            pushes.fault("stuck");
        }
        Ok(())
    };
    let (ended, news) = driven(BLOCK, false, answer, |news, mailbox| match news {
        "there 1" => post(mailbox, 1, vec![set_order("wheel", 4.0)]),
        "there 2" => {
            post(mailbox, 2, vec![set_order("wheel", 4.0)]);
            mailbox.close();
        }
        _ => {}
    });
    assert_eq!(news, ["there 1", "the hardware reports a fault: stuck", "there 2"]);
    assert_eq!(ended, Ok(()), "it received a command after its reconnection");
}

#[test]
fn values_without_acknowledgement_are_confirmed_by_the_next_answer() {
    let (asked, pings) = channel();
    let answer = move |what: &str, _: &Pushes| {
        if what == "ping" {
            asked.send(()).unwrap();
        }
        Ok(())
    };
    let (_, news) = driven(BLOCK, false, answer, |news, mailbox| match news {
        "there 1" => {
            let ask = mailbox::Order::Confirm(Ticket(1), DeviceId::new("wheel").unwrap());
            let demand = Demand { held: true, confirmation: true, ..Demand::default() };
            mailbox.post(1, [set_order("wheel", 4.0), ask].into_iter(), demand);
        }
        _ => mailbox.close(),
    });
    assert_eq!(news, ["there 1", "confirmed 1"]);
    assert!(pings.try_iter().count() >= 1);
}

/// Returns an order to take steps of a script of the arm. The first of them is due `due` milliseconds from now.
fn take(first: usize, due: i64) -> mailbox::Order {
    let clock = HostClock::anchored();
    let at = |millis: i64| (clock.now() + Span::from_millis(millis)).assume_clock();
    let setpoint = Setpoint::new(ControlType::Position, 5.0);
    let part = PlanPart {
        plan: crate::PlanId(1),
        device: DeviceId::new("arm").unwrap(),
        start: at(due),
        begin_by: at(due + 50),
        interpolation: urrcp::Interpolation::Hold,
        first,
        steps: vec![crate::plans::PlanStep { at: at(due), setpoint }],
        is_last: true,
    };
    mailbox::Order::Plan(mailbox::PlanOrder::Take(part, clock))
}

#[test]
fn script_that_reaches_the_driver_too_late_is_not_handed_over() {
    let refused = "this driver cannot play scripts by itself";
    let late = "s too late to be played";
    // A first step must not start too late. A later step may be an hour late.
    for (first, due, expected) in [
        (0, 60_000, refused),
        (0, -1_000, late),
        (2, 60_000, refused),
        (2, -1_000, refused),
        (2, -7_200_000, late),
    ] {
        let (_, news) = driven_within(
            Tolerance::AN_HOUR,
            BLOCK,
            false,
            |_, _| Ok(()),
            move |news, mailbox| match news {
                "there 1" => post(mailbox, 1, vec![take(first, due)]),
                _ => mailbox.close(),
            },
        );
        let told = &news[1];
        assert!(told.starts_with(&format!("refused {first}: ")) && told.ends_with(expected), "{due}: {told}");
    }
}

#[test]
fn cancelled_script_that_the_driver_never_received_is_over() {
    let cancel = || PlanCancel {
        plan: crate::PlanId(1),
        device: DeviceId::new("arm").unwrap(),
        then: crate::Then::Keep,
        why: String::new(),
    };
    let (_, news) = driven(
        BLOCK,
        false,
        |_, _| Ok(()),
        move |news, mailbox| match news {
            "there 1" => {
                post(mailbox, 1, vec![mailbox::Order::Plan(mailbox::PlanOrder::Cancel(cancel()))]);
            }
            _ => mailbox.close(),
        },
    );
    assert_eq!(news, ["there 1", "cancelled 1"]);
}

#[test]
fn driver_that_reports_on_an_unknown_script_has_failed() {
    for plan in [0, 2, 9] {
        let answer = move |what: &str, pushes: &Pushes| {
            if what == "wheel 4" {
                // The first script was refused, and reports about it are permitted.
                for plan in [1, plan] {
                    pushes.plan(crate::PlanId(plan), Timestamp::from_nanos(0), PlanEvent::Done);
                }
            }
            Ok(())
        };
        let (_, news) = driven(BLOCK, false, answer, move |news, mailbox| match news {
            "there 1" => post(mailbox, 1, vec![take(0, 60_000), set_order("wheel", 4.0)]),
            refused if refused.starts_with("refused") => {}
            _ => mailbox.close(),
        });
        let expected = format!(
            "the hardware reports a fault: the driver reported on plan {plan}, which it never received"
        );
        assert_eq!(news.get(2), Some(&expected), "{news:?}");
    }
}

#[test]
fn stale_value_is_reported_and_not_set_while_others_are_set() {
    let (told, calls) = channel();
    let answer = move |what: &str, _: &Pushes| {
        told.send(what.to_owned()).unwrap();
        Ok(())
    };
    let old = HostClock::anchored().instant_of(Timestamp::from_nanos(0)) - 2 * STALE;
    let mailbox::Order::Set(key, value) = set_order("arm", 4.0) else { panic!() };
    let (_, news) = driven(BLOCK, false, answer, move |news, mailbox| match news {
        "there 1" => {
            let stale = mailbox::Value { due: Some(old), ..value.clone() };
            post(mailbox, 1, vec![mailbox::Order::Set(key.clone(), stale), set_order("wheel", 4.0)]);
        }
        _ => mailbox.close(),
    });
    assert_eq!(news, ["there 1", "stale arm"]);
    let calls: Vec<_> = calls.try_iter().filter(|call| call != "ping").collect();
    assert_eq!(calls, ["connect", "wheel 4"]);
}

#[test]
fn hardware_counts_as_moved_once_its_driver_has_received_a_script() {
    let (ended, _) = driven(
        BLOCK,
        false,
        |_, _| Ok(()),
        |news, mailbox| match news {
            "there 1" => post(mailbox, 1, vec![take(0, 60_000)]),
            refused if refused.starts_with("refused") => mailbox.failed_by_itself("stuck".to_owned()),
            _ => mailbox.close(),
        },
    );
    assert_eq!(ended, Err("the hardware reports a fault: stuck".to_owned()));
}

#[test]
#[expect(clippy::disallowed_methods, reason = "real pauses may be longer, and not shorter")]
fn unavailable_or_failing_hardware_is_reconnected_ever_less_often() {
    for is_there in [false, true] {
        let answer = move |what: &str, _: &Pushes| {
            if what == "connect" && is_there { Ok(()) } else { away("cut") }
        };
        let (told, times) = channel();
        let left = std::sync::atomic::AtomicUsize::new(4);
        let (_, news) = driven(BLOCK, false, answer, move |news, mailbox| {
            told.send((news.to_owned(), Instant::now())).unwrap();
            match news.strip_prefix("there ") {
                Some(connection) => {
                    post(mailbox, connection.parse().unwrap(), vec![set_order("wheel", 4.0)]);
                }
                None if left.fetch_sub(1, Ordering::SeqCst) == 1 => mailbox.close(),
                None => {}
            }
        });
        let rounds = if is_there { 8 } else { 4 };
        assert_eq!(news.len(), rounds, "{news:?}");
        let times: Vec<_> = times.try_iter().collect();
        let between = |pair: &[(String, Instant)]| (pair[0].0.starts_with("there"), pair[1].1 - pair[0].1);
        let (connected, pauses): (Vec<_>, Vec<_>) =
            times.windows(2).map(between).partition(|(is_there, _)| *is_there);
        // Hardware that was connected for a long time is connected again at once.
        if connected.iter().any(|(_, lasted)| *lasted > Duration::from_secs(5)) {
            return;
        }
        for (pause, least) in pauses.iter().zip([100, 200, 400]) {
            assert!(pause.1 >= Duration::from_millis(least), "{pauses:?}");
        }
    }
}

#[test]
fn unrequested_reading_is_valid_for_the_sensor_delay_or_a_second() {
    let without = BLOCK.replace(r#", "max_delay": 60000"#, "");
    for (block, expected) in [(BLOCK, Duration::from_secs(60)), (&without, Duration::from_secs(1))] {
        let driver =
            Box::new(AnsweringDriver { answer: |_: &str, _: &Pushes| Ok(()), pushes: None, frames: false });
        let (block, options) = (serde_json::from_str(block).unwrap(), DriverOptions::default());
        let worker = Worker::new(driver, block, Arc::default(), options, Box::new(|_| {}));
        assert_eq!(worker.reading_counts_for(&DeviceId::new("eye").unwrap()), expected);
    }
}
