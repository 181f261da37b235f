//! Checks for scripts that can only be sent to their device when it is too late.

use urrcp::{DeviceId, RobotId, Span};

use super::cast::Cast;
use crate::composed::is_same;
use crate::fields::Reader;
use crate::finding::{Code, Place, SharedFault};
use crate::plan::{Choreography, Refill, RefillKind, refills};
use crate::render::counted;
use crate::scenario::Scenario;
use crate::shown::shortened;

/// Time within which a script can be sent during its act on an ordinary link: a round trip, and a resend after a loss.
const SENDING: Span = Span::from_millis(100);
/// Time within which an act can be prepared on fast links: its scripts are sent and the start is decided, and leases may first have to
/// expire.
const PREPARING: Span = Span::from_millis(500);
/// Number of larger script queues that are tried for a hint.
const QUEUES_TRIED: u32 = 4;
/// Maximum number of findings for which larger queues are tried.
const TRIALS_MAX: usize = 16;

/// Compares the time available for sending each act's scripts with the time that sending takes.
pub(super) fn check(
    findings: &mut Reader,
    scenario: &Scenario,
    cast: &Cast<'_>,
    choreography: &Choreography,
) {
    let lines = Lines { scenario, cast, choreography };
    let tight = refills(choreography, |robot, device| lines.queue(robot, device), SENDING);
    // An act that `at_end` adds may start late: this does not delay any act of the scenario.
    let may_wait = |refill: &Refill| refill.kind == RefillKind::First && refill.act >= scenario.acts.len();
    let tight = tight.into_iter().filter(|refill| refill.time < needed(refill.kind) && !may_wait(refill));
    // If acts have no end or are unreachable, their successors are unknown.
    let is_flawed =
        findings.found.iter().any(|found| matches!(found.code, Code::DeadEnd | Code::Unreachable));
    let tight = tight.filter(|refill| !is_flawed || refill.kind == RefillKind::Later);
    for (index, refill) in tight.enumerate() {
        let queue = if index < TRIALS_MAX { lines.queue_that_does(&refill) } else { None };
        lines.tell(findings, &refill, queue);
    }
}

const fn needed(kind: RefillKind) -> Span {
    match kind {
        RefillKind::First => PREPARING,
        RefillKind::Later => SENDING,
    }
}

struct Lines<'a> {
    scenario: &'a Scenario,
    cast: &'a Cast<'a>,
    choreography: &'a Choreography,
}

impl Lines<'_> {
    fn queue(&self, robot: &RobotId, device: &DeviceId) -> Option<u32> {
        let robot = self.cast.index(robot)?;
        let device = self.cast.devices(robot).iter().find(|known| known.id == *device)?;
        Some(device.script_queue.max(1))
    }

    /// Returns the smallest queue that gives the device enough time in every act, among the larger queues that are tried.
    fn queue_that_does(&self, refill: &Refill) -> Option<u32> {
        let queue = self.queue(&refill.robot, &refill.device)?;
        let does = |queue: &u32| {
            let only = |robot: &RobotId, device: &DeviceId| {
                (*robot == refill.robot && *device == refill.device).then_some(*queue)
            };
            refills(self.choreography, only, SENDING).iter().all(|refill| refill.time >= needed(refill.kind))
        };
        (queue.saturating_add(1)..=queue.saturating_add(QUEUES_TRIED)).find(does)
    }

    fn tell(&self, findings: &mut Reader, refill: &Refill, queue: Option<u32>) {
        // The next act and its time are known only if the scenario has no errors.
        if refill.kind == RefillKind::First && findings.errors() > 0 {
            return;
        }
        let needed = needed(refill.kind);
        let holds = self.queue(&refill.robot, &refill.device).unwrap_or(1);
        let (act, before) = (self.name(refill.act), self.name(refill.freed_by.act));
        let device = &refill.device;
        let holds = counted(holds as usize, "script");
        let room = format!(
            "the queue has room again when script {} of `{before}` has ended",
            refill.freed_by.script + 1
        );
        let time = refill.time;
        let (code, message, expected) = match refill.kind {
            RefillKind::First => (
                Code::ActHasToWait,
                [
                    format!("the act `{act}` cannot follow immediately: `{device}` of "),
                    format!(" can hold {holds}; {room}, {time} before the act starts"),
                ],
                format!("room in the queue at least {needed} before the act starts"),
            ),
            RefillKind::Later => (
                if time > Span::ZERO { Code::LittleTimeToSend } else { Code::NoTimeToSend },
                [
                    format!(
                        "too little time to send script {} of `{act}`: `{device}` of ",
                        refill.script + 1
                    ),
                    format!(" can hold {holds}; {room}, {time} before the start of this script"),
                ],
                format!("at least {needed} to send the script"),
            ),
        };
        let hint = Some(ways_out(refill, needed - time, queue));
        let place = self.place(refill);
        findings.add_shared(SharedFault {
            code,
            cause: format!("{place:?} {holds}"),
            size: -time.as_millis_f64(),
            device: device.to_string(),
            robots: [refill.robot.clone()].into(),
            place,
            message,
            expected,
            hint,
        });
    }

    fn name(&self, act: usize) -> String {
        shortened(&self.choreography.acts[act].name)
    }

    /// Returns the place of the track that moves the device when the script starts.
    fn place(&self, refill: &Refill) -> Place {
        let Some(written) = self.scenario.acts.get(refill.act) else {
            return self.scenario.at_end.as_ref().map(|at_end| at_end.place.clone()).unwrap_or_default();
        };
        let act = &self.choreography.acts[refill.act];
        let starts = act
            .plan
            .robots
            .iter()
            .filter(|robot| robot.robot == refill.robot)
            .flat_map(|robot| &robot.scripts)
            .filter(|script| script.device == refill.device)
            .nth(refill.script)
            .map_or(Span::ZERO, |script| act.moves_at(&refill.robot, script));
        let cues = written.cues.iter().zip(&act.cues).filter_map(|(cue, planned)| {
            let members = self.cast.members(&mut Reader::default(), cue, self.scenario.horizon());
            let own = |member: &&super::cast::Member| *self.cast.id(member.robot) == refill.robot;
            let movement = cue.movement_of(members.all.iter().find(own)?);
            let track =
                movement.tracks.iter().find(|track| is_same(refill.device.as_str(), &track.device))?;
            Some((planned.start > starts, (planned.start - starts).abs(), &track.place))
        });
        let nearest = cues.min_by_key(|(later, distance, _)| (*later, *distance));
        nearest.map_or_else(|| written.place.clone(), |(_, _, place)| place.clone())
    }
}

/// Suggests changes that provide the missing time `lacking`.
fn ways_out(refill: &Refill, lacking: Span, queue: Option<u32>) -> String {
    let device = &refill.device;
    let pause = match refill.kind {
        RefillKind::First => {
            format!(
                "end the movement of `{device}` {lacking} earlier in the previous act, or make this act wait"
            )
        }
        RefillKind::Later => format!(
            "start `{device}` {lacking} later in this act, make the act wait, or remove keyframes until the device needs only {}",
            counted(refill.script, "script")
        ),
    };
    match queue {
        Some(queue) => format!("{pause}; a `script_queue` of {queue} would be enough"),
        None => pause,
    }
}

#[cfg(test)]
mod tests {
    use crate::{Fleet, FleetRobot, Source, compile};

    /// A fleet of one robot. Its device accepts `most` steps per script and holds `queue` scripts.
    fn fleet(queue: usize, most: usize) -> Fleet {
        let block = format!(
            r#"{{"id": "r", "api_version": "1", "devices": [{{"id": "d", "name": "d", "interpolation": "linear",
            "script_queue": {queue}, "available_control_types": {{
            "position": {{"min_value": 0, "max_value": 90, "granularity": 0.5}},
            "script": {{"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": {most}}}}}}}]}}"#
        );
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        let robot = FleetRobot { id: init.id.clone(), init: Some(init), ..crate::tests::robot() };
        Fleet { robots: vec![robot], ..Fleet::default() }
    }

    /// Writes consecutive acts. Each has the given number of steps, one every `pause` milliseconds.
    fn acts(steps: &[usize], pause: usize) -> String {
        let act = |(index, steps): (usize, &usize)| {
            let keyframe = |step: usize| format!("{{at: {}ms, to: {}}}", step * pause, step % 2 * 10);
            let keyframes: Vec<_> = (0..*steps).map(keyframe).collect();
            let track = format!("{{d: [{}]}}", keyframes.join(", "));
            format!("  - act: act {index}\n    cues: [{{robots: r, tracks: {track}}}]\n")
        };
        format!("scenario: s\nacts:\n{}", steps.iter().enumerate().map(act).collect::<String>())
    }

    /// Returns the code and the line of each finding about scripts that must be sent during an act.
    fn found(scenario: String, fleet: &Fleet) -> Vec<(&'static str, usize)> {
        let compiled = compile(&Source { name: "s.yaml".into(), text: scenario }, fleet, &crate::NoFiles);
        let refills =
            compiled.findings.iter().filter(|finding| ("DB0047"..="DB0049").contains(&finding.code.as_str()));
        refills.map(|finding| (finding.code.as_str(), finding.line)).collect()
    }

    #[test]
    fn scripts_of_one_second_are_refilled_in_time_in_every_act() {
        for queue in 2..=4 {
            for counts in 0..64 {
                // One to four scripts in each of three acts; each has two steps, one second apart.
                let scripts = [counts % 4, counts / 4 % 4, counts / 16].map(|count| 2 * (count + 1));
                assert_eq!(found(acts(&scripts, 1_000), &fleet(queue, 2)), [], "queue {queue}: {scripts:?}");
            }
        }
    }

    #[test]
    fn script_starting_when_queue_space_frees_up_is_refused_on_its_line() {
        assert_eq!(found(acts(&[2, 2], 2_000), &fleet(2, 1)), [("DB0047", 6)]);
        assert_eq!(found(acts(&[2, 2], 2_000), &fleet(3, 1)), []);
        // Here the act must wait for room, which gives its second script more time.
        assert_eq!(found(acts(&[2, 1, 2], 2_000), &fleet(2, 1)), [("DB0049", 8)]);
    }

    #[test]
    fn script_with_too_little_time_for_resend_gets_warning() {
        let late = |at: &str| {
            acts(&[2, 2], 2_000).replacen("    cues: [{robots", &format!("    cues: [{{at: {at}, robots"), 2)
        };
        assert_eq!(found(late("99ms"), &fleet(2, 1)), [("DB0048", 6)]);
        assert_eq!(found(late("100ms"), &fleet(2, 1)), []);
    }

    #[test]
    fn act_that_waits_for_operator_has_enough_time_to_refill() {
        let waiting =
            acts(&[2, 2], 2_000).replace("  - act: act 1\n", "  - act: act 1\n    wait: operator\n");
        assert_eq!(found(waiting, &fleet(2, 1)), []);
    }

    #[test]
    fn queue_of_one_leaves_gap_before_each_following_act() {
        assert_eq!(found(acts(&[2, 2, 2], 1_000), &fleet(1, 8)), [("DB0049", 6), ("DB0049", 8)]);
        assert_eq!(found(acts(&[2, 2, 2], 1_000), &fleet(2, 8)), []);
    }

    #[test]
    fn hint_names_remedies_with_figures() {
        let source = Source { name: "s.yaml".into(), text: acts(&[2, 2], 2_000) };
        let compiled = compile(&source, &fleet(2, 1), &crate::NoFiles);
        let finding = compiled.findings.iter().find(|finding| finding.code.as_str() == "DB0047").unwrap();
        assert!(compiled.choreography.is_none());
        let hint = finding.hint.as_deref().unwrap();
        assert!(
            finding.message.contains("script 2 of `act 1`: `d` of `r` can hold 2 scripts"),
            "{finding:?}"
        );
        assert!(hint.contains("start `d` 100 ms later") && hint.contains("`script_queue` of 3"), "{hint}");
    }
}
