//! Checks of connections: many messages at once, peers that do not read, and several consecutive or concurrent connections.

use serde_json::json;
use urrcp::{Message, Span};

use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::trial::Trial;

pub(super) const ALL: [Requirement; 5] = [
    Requirement {
        name: "many-messages",
        number: "core-93",
        demands: "A thousand messages that arrive in one write are all answered, in order.",
        section: "Sessions and connections (D)",
        check: many_messages,
    },
    Requirement {
        name: "slow-reader",
        number: "core-94",
        demands: "A server that sends requests but does not read the answers does not delay other servers.",
        section: "Sessions and connections (D)",
        check: slow_reader,
    },
    Requirement {
        name: "reconnect",
        number: "core-95",
        demands: "Twenty connections, one after the other, are all served.",
        section: "Sessions and connections (D)",
        check: reconnect,
    },
    Requirement {
        name: "two-links",
        number: "core-96",
        demands: "A second connection is served while the first one is open.",
        section: "Sessions and connections (D)",
        check: two_links,
    },
    Requirement {
        name: "silent-peers",
        number: "core-97",
        demands: "Sixteen connections that send nothing, or only half a message, block a server for at most 10 s.",
        section: "Strangers (D)",
        check: silent_peers,
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
                _ => return Err(differs(&what, &heard.text, "only availability responses")),
            },
            None => {
                let came = format!("{} answers within {}", shown.len(), trial.options().patience);
                return Err(differs(&what, &came, &format!("{COUNT} answers")));
            }
        }
    }
    // The requirement `availability` checks whether the robot echoes the timestamp.
    let echoed: Vec<_> = shown.into_iter().flatten().collect();
    if echoed.is_sorted() {
        pass()
    } else {
        Err(differs(&what, "answers in a different order", "the answers in the order of the requests"))
    }
}

fn slow_reader(trial: &Trial) -> Checked {
    let mut other = trial.connect_second()?;
    let mut deaf = trial.connect()?;
    let asked = deaf.overfill()?;
    let what = format!("{asked} initialization requests on another connection, whose answers are not read,");
    // All buffers between the two sides take a while to fill.
    let until = trial.soon(1_000);
    while trial.now() < until {
        other.survives(&what)?;
        trial.pause(Span::from_millis(50))?;
    }
    drop(deaf);
    trial.connect()?.survives(&what)?;
    Ok(format!("{asked} answers were left unread"))
}

fn reconnect(trial: &Trial) -> Checked {
    for n in 1..=20 {
        let served = trial.connect().and_then(|mut line| line.availability().map(drop));
        served.map_err(|unmet| {
            unmet.within(|why| {
                format!(
                    "connection {n} of 20, each of which was closed before the next one was opened: {why}"
                )
            })
        })?;
    }
    pass()
}

fn two_links(trial: &Trial) -> Checked {
    let mut first = trial.connect()?;
    first.availability()?;
    let mut second = trial.connect()?;
    second.survives("a second connection was opened while the first one was open")?;
    first.survives("a second connection was opened")?;
    second.survives("both connections had been served")?;
    pass()
}

fn silent_peers(trial: &Trial) -> Checked {
    const PEERS: usize = 16;
    const OUT_MAX: Span = Span::from_millis(10_000);
    drop(trial.connect_second()?);
    let half = json!({"availability_request": {"timestamp": trial.stamp()}}).to_string();
    let mut peers = Vec::new();
    for n in 0..PEERS {
        // The robot may refuse or close such connections.
        let Ok(mut peer) = trial.connect_silently() else { break };
        if n % 2 == 1 {
            let _hung_up = peer.send(&half.as_bytes()[..half.len() / 2]);
        }
        peers.push(peer);
    }
    let began = trial.now();
    loop {
        let served = trial.connect().and_then(|mut line| line.availability().map(drop));
        let out = trial.now() - began;
        match served {
            Ok(()) => {
                return Ok(format!(
                    "the robot answered {out} after {} of these connections had been opened",
                    peers.len()
                ));
            }
            Err(Unmet::Failed(why)) if out > OUT_MAX + trial.slack() => {
                let silent = format!("{PEERS} connections sent nothing or only half a message");
                return Err(Unmet::Failed(format!("{silent}, and {out} later: {why}")));
            }
            Err(Unmet::Failed(_)) => trial.pause(Span::from_millis(100))?,
            Err(other) => return Err(other),
        }
    }
}
