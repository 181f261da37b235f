//! The certified properties: everything that changes the behaviour of robots. Each property is kept separately, so that a message can
//! name the one that differs. The code destructures structs completely. If a struct gets a new field, the code compiles only after that
//! field is classified as relevant or not.

use std::collections::BTreeMap;

use downbeat_scripts::{
    Act, Choreography, DeviceLatency, DeviceScript, FailurePolicy, Fleet, FleetRobot, Handshake,
    MissionSettings, Plan, RateLimits, Way,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use urrcp::{ContentHash, InitializationBlock, RobotId};

use super::{hash_of, sorted};
use downbeat_runtime::fleet;
use downbeat_runtime::journal::OperatorChoices;

/// The certified plan, and the fleet that the plan was made for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subject {
    /// The scenario's name.
    pub scenario: String,
    /// The options from the command line.
    pub options: Options,
    /// SHA-256 over the scenario's name, the acts and the options.
    pub plan_hash: ContentHash,
    /// SHA-256 over the part of the fleet that changes the behaviour of robots.
    pub fleet_hash: ContentHash,
    /// The acts, in the order of the scenario.
    pub acts: Vec<CertifiedAct>,
    /// Settings that apply to the whole fleet, by name.
    pub fleet: BTreeMap<String, Value>,
    /// The robots that play or whose sensors are read.
    pub robots: BTreeMap<RobotId, CertifiedRobot>,
}

/// Options that change the plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// The only act to play; `None`: all acts.
    pub act: Option<String>,
    /// The act to start with; `None`: the first act.
    pub from: Option<String>,
    /// The only robots to play; empty: all robots.
    pub only: Vec<RobotId>,
    /// Factor by which the speed of the scenario is multiplied.
    pub speed: f64,
}

/// An act of the certified plan. It contains the waits and transitions in full, and the scripts as hashes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertifiedAct {
    /// The name of the act; empty if the scenario does not define acts.
    pub act: String,
    /// Waits, transitions, policies and leases of the act, by name.
    pub settings: BTreeMap<String, Value>,
    /// SHA-256 over the scripts (starts, leases, steps) of each device; the key is `robot/device`.
    pub scripts: BTreeMap<String, ContentHash>,
}

/// The certified properties of a robot in the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertifiedRobot {
    /// The robot's settings in the fleet file: `clock`, `wake_up`, `encoding`, `require`, and `limits` by device.
    pub settings: BTreeMap<String, Value>,
    /// SHA-256 over the robot's description without its devices.
    pub description: ContentHash,
    /// SHA-256 over the description of each device, by device id.
    pub devices: BTreeMap<String, ContentHash>,
    /// SHA-256 over the robot's body: its position and shape in space.
    pub body: ContentHash,
}

impl Subject {
    /// Creates the subject from the selected part of a scenario, the robots that this part needs, and the options `asked`.
    #[must_use]
    pub fn of(choreography: &Choreography, fleet: &Fleet, asked: &OperatorChoices) -> Self {
        // Requirements are judged and do not change the plan.
        let Choreography { scenario, acts: played, requirements: _ } = choreography;
        let acts = certified_acts(played, choreography);
        let robots = fleet::robots_in(fleet, choreography);
        let robots: BTreeMap<RobotId, CertifiedRobot> =
            robots.into_iter().map(|robot| (robot.id.clone(), certified_robot(robot))).collect();
        // Groups are already resolved. The NTP server of this machine does not change the plan.
        let Fleet { ntp: _, handshake, space, robots: _, groups: _, identity: _, revoked: _, zenoh: _ } =
            fleet;
        let handshake = match handshake {
            Handshake::Full => "full",
            Handshake::Skip => "skip",
        };
        let settings = [("handshake", json!(handshake)), ("space", json!(hash_of(space)))];
        let settings: BTreeMap<String, Value> = named(settings);
        let options = options_of(asked);
        Self {
            scenario: scenario.clone(),
            plan_hash: hash_of_plan(scenario, &acts, &options),
            fleet_hash: hash_of(&(&settings, &robots)),
            options,
            acts,
            fleet: settings,
            robots,
        }
    }
}

/// SHA-256 over the scenario's name, the acts and the options: the `plan_hash` of a certificate.
#[must_use]
pub fn plan_hash(choreography: &Choreography, asked: &OperatorChoices) -> ContentHash {
    let acts = certified_acts(&choreography.acts, choreography);
    hash_of_plan(&choreography.scenario, &acts, &options_of(asked))
}

fn hash_of_plan(scenario: &str, acts: &[CertifiedAct], options: &Options) -> ContentHash {
    hash_of(&(scenario, acts, options))
}

fn certified_acts(acts: &[Act], choreography: &Choreography) -> Vec<CertifiedAct> {
    acts.iter().map(|act| certified_act(act, choreography)).collect()
}

fn options_of(asked: &OperatorChoices) -> Options {
    let OperatorChoices { act, from, only, speed, approach: _ } = asked.clone();
    Options { act, from, only, speed: speed.unwrap_or(1.0) }
}

fn named<const N: usize>(settings: [(&str, Value); N]) -> BTreeMap<String, Value> {
    settings.into_iter().map(|(key, value)| (key.to_owned(), sorted(value))).collect()
}

fn certified_act(act: &Act, choreography: &Choreography) -> CertifiedAct {
    // Latencies shift the starts of scripts; they are certified as properties of robots. The names of cues, the origin of steps and the
    // positions of bodies follow from other fields or move nothing.
    let Act {
        name,
        plan,
        lead_in: _,
        latencies: _,
        cues: _,
        devices: _,
        in_space: _,
        readings,
        wait,
        timeout,
        on_timeout,
        next,
        on_failure,
        on_doubt,
    } = act;
    let Plan { scenario: _, start_tolerance, lead, stop_condition, robots } = plan;
    let FailurePolicy { default, robots: by_robot, then } = on_failure;
    let called = |index: usize| choreography.acts.get(index).map(|act| act.name.clone());
    let way = |way: Way| match way {
        Way::Act(index) => json!({ "act": called(index) }),
        Way::End => json!("end"),
        Way::Fail => json!("fail"),
    };
    let settings = named([
        ("wait", json!(wait)),
        ("timeout_ms", json!(timeout)),
        ("otherwise", way(*on_timeout)),
        ("next", way(*next)),
        ("on_failure", json!(default)),
        ("on_failure_of", json!(by_robot)),
        ("on_failure_then", json!(then.map(called))),
        ("on_doubt", json!(on_doubt)),
        ("start_tolerance_ms", json!(start_tolerance)),
        ("lead_ms", json!(lead)),
        ("stop_condition", json!(stop_condition)),
        ("readings", json!(readings)),
    ]);
    let mut scripts: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for robot in robots {
        for DeviceScript { device, start, stop_condition, script, rest } in &robot.scripts {
            let one = json!({
                "start_ms": start, "stop_condition": stop_condition, "steps": script, "rest_ms": rest,
            });
            scripts.entry(format!("{}/{device}", robot.robot)).or_default().push(one);
        }
    }
    let scripts = scripts.into_iter().map(|(of, scripts)| (of, hash_of(&scripts))).collect();
    CertifiedAct { act: name.clone(), settings, scripts }
}

fn certified_robot(robot: &FleetRobot) -> CertifiedRobot {
    // A change of the address does not matter, and simulation settings do not apply to real robots.
    let FleetRobot { id: _, address: _, init, simulation: _, limits, body, mission } = robot;
    let MissionSettings { clock, wake_up, encoding, require, latencies, calibrate: _ } = mission;
    let mut settings = named([
        ("clock", json!(clock)),
        ("wake_up_ms", json!(wake_up)),
        ("encoding", json!(encoding.as_str())),
        ("require", json!(require)),
    ]);
    for (device, DeviceLatency { latency, from: _, lag: _ }) in latencies {
        settings.insert(format!("latency of `{device}`"), sorted(json!(latency)));
    }
    for (device, RateLimits { speed, acceleration }) in limits {
        let value = sorted(json!({ "speed": speed, "acceleration": acceleration }));
        settings.insert(format!("limits of `{device}`"), value);
    }
    let devices = init.iter().flat_map(|init| &init.devices);
    let devices = devices.map(|device| (device.id.to_string(), hash_of(device))).collect();
    let alone = init.as_ref().map(|init| InitializationBlock { devices: Vec::new().into(), ..init.clone() });
    CertifiedRobot { settings, description: hash_of(&alone), devices, body: hash_of(body) }
}
