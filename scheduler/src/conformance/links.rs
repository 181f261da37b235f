//! Connections: many messages at once, peers that do not read, one connection after another and at the same time as another.

use urrcp::{Message, Span};

use super::requirement::{Checked, Requirement, differs, pass};
use super::trial::Trial;

pub(super) const ALL: [Requirement; 4] = [
    Requirement {
        name: "many-messages",
        demands: "A thousand messages in one write are all answered, in their order.",
        section: "Sessions and connections (D)",
        check: many_messages,
    },
    Requirement {
        name: "slow-reader",
        demands: "A server that sends and does not read delays no other.",
        section: "Sessions and connections (D)",
        check: slow_reader,
    },
    Requirement {
        name: "reconnect",
        demands: "Twenty connections, one after the other, are all served.",
        section: "Sessions and connections (D)",
        check: reconnect,
    },
    Requirement {
        name: "two-links",
        demands: "A second connection is served while the first one stands.",
        section: "Sessions and connections (D)",
        check: two_links,
    },
];

fn many_messages(trial: &Trial) -> Checked {
    const COUNT: usize = 1_000;
    let mut line = trial.connect()?;
    let first = trial.stamp();
    let stamps: Vec<_> =
        (0..COUNT).map(|n| first + Span::from_nanos(1_000_000 * i64::try_from(n).unwrap_or(0))).collect();
    let request = |stamp| serde_json::json!({"availability_request": {"timestamp": stamp}});
    let bytes: String = stamps.iter().map(|stamp| format!("{}\n", request(stamp))).collect();
    line.send(bytes.as_bytes())?;
    let until = trial.patience();
    let what = format!("{COUNT} availability requests in one write");
    let mut shown = Vec::new();
    while shown.len() < COUNT {
        match line.other(until)? {
            Some(heard) => match heard.message {
                Message::AvailabilityResponse(response) => shown.push(response.originate_timestamp),
                _ => return Err(differs(&what, &heard.text, "availability responses alone")),
            },
            None => {
                let came = format!("{} answers within {}", shown.len(), trial.options().patience);
                return Err(differs(&what, &came, &format!("{COUNT} answers")));
            }
        }
    }
    // Whether the time is echoed is the concern of `availability`.
    let echoed: Vec<_> = shown.into_iter().flatten().collect();
    match echoed.is_sorted() {
        true => pass(),
        false => Err(differs(&what, "answers in another order", "each answer in the order of its request")),
    }
}

fn slow_reader(trial: &Trial) -> Checked {
    let mut other = trial.connect_beside()?;
    let mut deaf = trial.connect()?;
    let asked = deaf.overfill()?;
    let what = format!("{asked} initialization requests on another connection, whose answers are not read,");
    // It takes a while until all that lies between the two is full.
    let until = trial.soon(1_000);
    while trial.now() < until {
        other.goes_on_after(&what)?;
        trial.pause(Span::from_millis(50))?;
    }
    drop(deaf);
    trial.connect()?.goes_on_after(&what)?;
    Ok(format!("{asked} answers were left unread"))
}

fn reconnect(trial: &Trial) -> Checked {
    for n in 1..=20 {
        let served = trial.connect().and_then(|mut line| line.availability().map(drop));
        served.map_err(|unmet| {
            unmet.within(|why| format!("connection {n} of 20, each closed before the next: {why}"))
        })?;
    }
    pass()
}

fn two_links(trial: &Trial) -> Checked {
    let mut first = trial.connect()?;
    first.availability()?;
    let mut second = trial.connect()?;
    second.goes_on_after("a second connection was opened while the first one stood")?;
    first.goes_on_after("a second connection was opened")?;
    second.goes_on_after("both connections were served once")?;
    pass()
}
