//! The free slots in the script queues of devices, across all acts in order of their start.
//!
//! A device holds as many scripts as its queue has slots. When a slot becomes free, the next script in order of start is sent, regardless
//! of the act to which it belongs.

use std::collections::HashMap;

use urrcp::{DeviceId, Span};

use super::act::Act;
use super::robot_state::{RobotState, Robots};
use super::script::{Script, ScriptRef};
use super::{ClockMode, RobotIndex};

/// The scripts that may be sent to a robot now, in order of start. `acts` must be in order of start.
pub(crate) fn sendable(acts: &[Act], robot: RobotIndex, state: &RobotState) -> Vec<ScriptRef> {
    let mut room = room_of(acts, robot, state);
    let mut sendable = Vec::new();
    for act in acts {
        let Some(place) = act.place_of(robot) else { continue };
        for chain in act.members()[place].chains() {
            let corrected = state.settings.clock == ClockMode::Measured;
            let mut ahead = Vec::new();
            for (index, script) in chain {
                let waits = corrected && waits_for_its_clock(&ahead);
                if script.is_out() || script.is_planned() {
                    ahead.push(script);
                }
                if !script.is_planned() {
                    continue;
                }
                let Some(room) = room.get_mut(&script.plan.device) else { break };
                if waits || *room == 0 || !act.is_open() || !act.lets_follow(place, index) {
                    // No script overtakes a waiting one.
                    *room = 0;
                    break;
                }
                *room -= 1;
                sendable.push(ScriptRef { act: act.number(), member: place, script: index });
            }
        }
    }
    sendable
}

/// Whether to send a script only when the drift of its robot's clock is known. The script can wait if at least two scripts are ahead of
/// it and the last of them is long. If this machine failed, a lease would end that script anyway.
fn waits_for_its_clock(ahead: &[&Script]) -> bool {
    let [.., _, last] = ahead else { return false };
    last.duration() >= LONG_ENOUGH && last.longest_lease().is_some_and(|lease| lease <= last.duration())
}

/// The minimum duration of a script that certainly leaves enough time to send the next script while it plays.
const LONG_ENOUGH: Span = Span::from_millis(5_000);

/// The number of free queue slots of each device to which scripts remain to be sent.
fn room_of<'a>(acts: &'a [Act], robot: RobotIndex, state: &RobotState) -> HashMap<&'a DeviceId, usize> {
    let mut room = HashMap::new();
    let members = || acts.iter().filter_map(|act| act.member(robot));
    let scripts = || members().flat_map(|member| member.under_way().map(|(_, script)| script));
    for script in scripts().filter(|script| script.is_planned()) {
        room.entry(&script.plan.device).or_insert_with(|| state.queue_of(&script.plan.device));
    }
    for script in scripts().filter(|script| script.is_out()) {
        if let Some(room) = room.get_mut(&script.plan.device) {
            *room = room.saturating_sub(1);
        }
    }
    room
}

/// Whether the queue of every device has a slot for the device's first script of an act. The scripts of earlier acts that the device
/// holds or will receive come first.
pub(crate) fn fits(acts: &[Act], index: usize, robots: &Robots) -> bool {
    let (before, act) = (&acts[..index], &acts[index]);
    act.present().all(|member| {
        let robot = &robots[member.robot];
        let mut taken: HashMap<&DeviceId, usize> = HashMap::new();
        let earlier = before.iter().filter_map(|act| act.member(member.robot));
        let left = |script: &&Script| script.is_out() || script.is_planned();
        let mut waiting = earlier.clone().flat_map(|member| member.scripts());
        if robot.settings.clock == ClockMode::Measured && waiting.any(Script::is_planned) {
            // The start of the waiting script may still be corrected, and this act begins after that script by the same clock.
            return false;
        }
        for script in earlier.flat_map(|member| member.scripts()).filter(left) {
            *taken.entry(&script.plan.device).or_default() += 1;
        }
        let has_room = |script: &Script| {
            taken.get(&script.plan.device).is_none_or(|taken| *taken < robot.queue_of(&script.plan.device))
        };
        taken.is_empty() || member.scripts().iter().all(has_room)
    })
}

#[cfg(test)]
mod tests;
