//! Robots that move without a command.

use std::time::Duration;

use serde_json::{Value, json};

use super::super::proxy::{Memory, More, Passing, Then};
use super::{Mutant, edit, is_cancel, mutant, remove};

/// The requirements to check for these robots. The others also stop devices and reconnect, so an unrequested movement would break them
/// too.
const MOVEMENTS: &[&str] = &[
    "inquiry-position",
    "stays-stopped",
    "stays-connected",
    "lease-stays-pending",
    "lease-stays-running",
    "home-position",
];
const PLANTED: &str = "planted";

pub fn of_movements() -> Vec<Mutant> {
    let among_movements = |mutant: Mutant| Mutant { only: MOVEMENTS, ..mutant };
    vec![
        mutant("a stop goes to the default state", &["stays-stopped"], |_, passing| {
            edit(passing, |request| {
                if is_cancel(request) {
                    request["home"] = json!(true);
                }
            })
        }),
        mutant("home is a stop", &["home-position"], |_, passing| {
            edit(passing, |request| remove(request, "home"))
        }),
        among_movements(mutant(
            "a lease that ends before the start goes to the default state",
            &["lease-stays-pending"],
            |memory, passing| at_the_end_of_a_lease(memory, passing, false),
        )),
        among_movements(mutant(
            "a lease that ends after the start goes to the default state",
            &["lease-stays-running"],
            |memory, passing| at_the_end_of_a_lease(memory, passing, true),
        )),
        among_movements(mutant(
            "a new connection goes to the default state",
            &["stays-connected"],
            |memory, passing| {
                if is_planted(passing) {
                    return Then::Drop;
                }
                let device = passing.json.pointer("/control_request/device_id").and_then(Value::as_str);
                memory.order.extend(device.map(str::to_owned));
                let greets = passing.json.get("availability_request").is_some();
                let messages = memory.count.entry(passing.link).or_default();
                *messages += 1;
                match memory.order.first() {
                    Some(device) if *messages == 1 && greets => {
                        // The robot belongs to the earlier connection until it has noticed its end.
                        Then::With(vec![home(passing.link, device, Duration::from_millis(150))])
                    }
                    _ => Then::Pass,
                }
            },
        )),
    ]
}

fn home(link: u64, device: &str, after: Duration) -> More {
    let line = json!({"control_request": {"device_id": device, "request_id": PLANTED,
        "control_type": "script", "control_value": [], "home": true}});
    More { after, link, line }
}

fn is_planted(passing: &mut Passing) -> bool {
    passing.response().is_some_and(|response| response["request_id"] == PLANTED)
}

fn at_the_end_of_a_lease(memory: &mut Memory, passing: &mut Passing, started: bool) -> Then {
    if is_planted(passing) {
        return Then::Drop;
    }
    let link = passing.link;
    let Some(response) = passing.response() else { return Then::Pass };
    let name = (0, response["request_id"].to_string());
    if response["status"] == "Started" {
        memory.seen.insert(name.clone());
    }
    match response["device_id"].as_str() {
        Some(device)
            if response["error"]["code"] == "link_lost" && memory.seen.contains(&name) == started =>
        {
            Then::With(vec![home(link, device, Duration::ZERO)])
        }
        _ => Then::Pass,
    }
}
