//! Refills: the time available for sending scripts that a device cannot hold from the start.
//!
//! A device holds at most `script_queue` scripts that have not ended. If its queue is full, the device's next script can be sent once
//! one of these has ended, also across acts that follow each other immediately. The script must arrive before its own start.

use std::collections::{HashMap, VecDeque};

use urrcp::{DeviceId, RobotId, Span};

use crate::choreography::{Act, Choreography, DeviceScript, Wait, Way};

/// Maximum number of acts that a line (acts that follow each other immediately) processes again after another line has processed them. It
/// uses the scripts that it has left on the devices.
const AGAIN: usize = 2;

/// A script that its device can only receive once an earlier script has ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Refill {
    /// Index of the script's act in the choreography.
    pub act: usize,
    /// Id of the robot that plays the script.
    pub robot: RobotId,
    /// Id of the device that plays the script.
    pub device: DeviceId,
    /// Index of the script among those of this device in this act, from 0.
    pub script: usize,
    /// The script whose end makes room in the device's queue.
    pub freed_by: Freed,
    /// Available time from the end of `freed_by` to the deadline: the script's own start or, for the first one of an act, the end of the
    /// previous act.
    pub time: Span,
    /// Consequence if `time` is too short.
    pub kind: RefillKind,
}

/// A script whose end makes room for another one in the device's queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Freed {
    /// Index of the script's act in the choreography.
    pub act: usize,
    /// Index of the script among those of this device in that act, from 0.
    pub script: usize,
}

/// Consequence of too little time for a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum RefillKind {
    /// The act is delayed: it is sent once every device has room for its first script, so it starts later than the previous act ends.
    First,
    /// The act is not delayed, because it already plays: a script that arrives late is rejected.
    Later,
}

/// Returns the refill with the least time for each act and kind, in the order of the acts. When an act that waits for a condition
/// begins, its devices are empty, since everything before it has ended.
///
/// `queue` returns the number of scripts that a device holds; devices without a number are skipped. `sending` is the shortest time for
/// sending a script: an act begins at least this long after all devices have room for its first scripts, which leaves its later scripts
/// more time.
#[must_use]
pub fn refills(
    choreography: &Choreography,
    queue: impl Fn(&RobotId, &DeviceId) -> Option<u32>,
    sending: Span,
) -> Vec<Refill> {
    let mut refills = refills_of_robots(choreography, queue, sending);
    refills.sort_by_key(|refill| (refill.act, refill.kind, refill.time));
    refills.dedup_by_key(|refill| (refill.act, refill.kind));
    refills
}

/// Like [`refills`], but separately for each robot of each act, since sending may take longer to some robots than to others.
#[must_use]
pub fn refills_of_robots(
    choreography: &Choreography,
    queue: impl Fn(&RobotId, &DeviceId) -> Option<u32>,
    sending: Span,
) -> Vec<Refill> {
    let acts = &choreography.acts;
    let mut walk = Walk { acts, queue, sending, tightest: HashMap::new() };
    let mut visited = vec![false; acts.len()];
    // Limits the work if many lines lead to one act.
    let mut left = 2 * acts.iter().map(scripts_of).sum::<usize>();
    let heads = (0..acts.len()).take(1).chain(heads(acts));
    // Acts that no line reaches from a head form a cycle.
    for head in heads.chain(0..acts.len()) {
        if !visited[head] {
            walk.line(head, &mut visited, &mut left);
        }
    }
    let mut refills: Vec<Refill> = walk.tightest.into_values().collect();
    refills.sort_by(|a, b| (a.act, a.kind, &a.robot).cmp(&(b.act, b.kind, &b.robot)));
    refills
}

/// Returns the refills of `act` directly after `before`, whatever condition the scenario makes `act` wait for: if it waits for a time
/// that has already passed, it follows immediately. It starts `pause` after the end of `before`, with the scripts that `before` left on
/// the devices.
#[must_use]
pub fn refills_behind(
    choreography: &Choreography,
    (before, act): (usize, usize),
    pause: Span,
    queue: impl Fn(&RobotId, &DeviceId) -> Option<u32>,
    sending: Span,
) -> Vec<Refill> {
    let acts = &choreography.acts;
    let (Some(first), Some(_)) = (acts.get(before), acts.get(act)) else { return Vec::new() };
    let mut walk = Walk { acts, queue, sending, tightest: HashMap::new() };
    let mut held = Held::new();
    let begin = walk.act(before, Span::ZERO, &mut held);
    walk.tightest.clear();
    walk.act(act, begin + first.plan.duration() + pause, &mut held);
    walk.tightest.into_values().collect()
}

fn scripts_of(act: &Act) -> usize {
    act.plan.robots.iter().map(|robot| robot.scripts.len()).sum()
}

/// Returns the act that begins as soon as `act` ends; `None` if no act does.
fn following(acts: &[Act], act: usize) -> Option<usize> {
    match acts[act].next {
        Way::Act(next) if acts.get(next)?.wait == Wait::Done => Some(next),
        _ => None,
    }
}

/// Returns the acts that do not immediately follow another one.
fn heads(acts: &[Act]) -> impl Iterator<Item = usize> {
    let mut follows = vec![false; acts.len()];
    for next in (0..acts.len()).filter_map(|act| following(acts, act)) {
        follows[next] = true;
    }
    (0..acts.len()).filter(move |act| !follows[*act])
}

/// A script that was sent. `ends` is the time of its end since the start of the line (the acts that follow each other immediately).
struct Sent {
    what: Freed,
    ends: Span,
}

/// The latest scripts of each device, at most as many as the device holds.
type Held<'a> = HashMap<(&'a RobotId, &'a DeviceId), VecDeque<Sent>>;

struct Walk<'a, Q> {
    acts: &'a [Act],
    queue: Q,
    sending: Span,
    tightest: HashMap<(usize, RefillKind, &'a RobotId), Refill>,
}

impl<'a, Q: Fn(&RobotId, &DeviceId) -> Option<u32>> Walk<'a, Q> {
    /// Processes the acts that follow each other immediately, starting with `head`.
    fn line(&mut self, head: usize, visited: &mut [bool], left: &mut usize) {
        let (mut held, mut begin, mut again) = (Held::new(), Span::ZERO, 0);
        let mut next = Some(head);
        while let Some(act) = next {
            if std::mem::replace(&mut visited[act], true) {
                again += 1;
                let room = left.checked_sub(scripts_of(&self.acts[act]));
                let Some(room) = room.filter(|_| again <= AGAIN) else { return };
                *left = room;
            }
            begin = self.act(act, begin, &mut held) + self.acts[act].plan.duration();
            next = following(self.acts, act);
        }
    }

    /// Adds the scripts of an act; the act before it ended at `ended`. Returns the start of the act.
    fn act(&mut self, act: usize, ended: Span, held: &mut Held<'a>) -> Span {
        let mut begin = ended;
        for chain in self.chains(act) {
            if let Some(freed) = held.get(&chain.key()).filter(|held| held.len() == chain.queue)
                && let Some(first) = freed.front()
            {
                begin = begin.max(first.ends + self.sending);
                self.note(&chain, 0, first.what, ended - first.ends);
            }
        }
        for chain in self.chains(act) {
            let held = held.entry(chain.key()).or_default();
            for (script, planned) in chain.scripts.iter().enumerate() {
                let starts = begin + planned.start.span();
                let freed = if held.len() == chain.queue { held.pop_front() } else { None };
                if let Some(freed) = freed.filter(|_| script > 0) {
                    self.note(&chain, script, freed.what, starts - freed.ends);
                }
                let ends = starts + planned.script.duration();
                held.push_back(Sent { what: Freed { act, script }, ends });
            }
        }
        begin
    }

    fn chains(&self, act: usize) -> Vec<Chain<'a>> {
        let robots = self.acts[act].plan.robots.iter();
        let chains = robots.flat_map(|robot| {
            let of_devices = robot.scripts.chunk_by(|a, b| a.device == b.device);
            of_devices.map(move |scripts| (&robot.robot, scripts))
        });
        let chain = |(robot, scripts): (&'a RobotId, &'a [DeviceScript])| {
            let queue = (self.queue)(robot, &scripts[0].device)?.max(1) as usize;
            Some(Chain { act, robot, scripts, queue })
        };
        chains.filter_map(chain).collect()
    }

    /// Stores the refill if it has the least time of its act, kind and robot.
    fn note(&mut self, chain: &Chain<'a>, script: usize, freed_by: Freed, time: Span) {
        let kind = if script == 0 { RefillKind::First } else { RefillKind::Later };
        let known = self.tightest.get(&(chain.act, kind, chain.robot));
        if known.is_none_or(|known| time < known.time) {
            let (robot, device) = (chain.robot.clone(), chain.scripts[script].device.clone());
            let refill = Refill { act: chain.act, robot, device, script, freed_by, time, kind };
            self.tightest.insert((chain.act, kind, chain.robot), refill);
        }
    }
}

/// Consecutive scripts of one device in an act.
struct Chain<'a> {
    act: usize,
    robot: &'a RobotId,
    /// Scripts of the device; not empty.
    scripts: &'a [DeviceScript],
    queue: usize,
}

impl<'a> Chain<'a> {
    fn key(&self) -> (&'a RobotId, &'a DeviceId) {
        (self.robot, &self.scripts[0].device)
    }
}

#[cfg(test)]
mod tests {
    use urrcp::{ControlType, Millis, Script, Setpoint, Step, StopCondition};

    use super::*;
    use crate::choreography::{FailurePolicy, OnDoubt, Plan, RobotPlan};
    use crate::requirements::Requirements;

    fn script(device: &str, start: i64, duration: i64) -> DeviceScript {
        let millis = |millis: i64| Millis::from_span(Span::from_millis(millis));
        let setpoint = Setpoint::new(ControlType::Position, 0.0);
        let step = Step { offset: millis(duration), setpoint, stop_condition: None };
        DeviceScript {
            device: device.parse().unwrap(),
            start: millis(start),
            stop_condition: StopCondition::default(),
            script: Script::new(vec![step]).unwrap(),
            rest: Span::ZERO,
        }
    }

    /// Builds an act for one robot with one device. Its consecutive scripts last `durations` milliseconds.
    fn act(durations: &[i64], next: Way) -> Act {
        let mut start = 0;
        let script = |duration: &i64| {
            start += duration;
            script("arm", start - duration, *duration)
        };
        act_of(durations.iter().map(script).collect(), next)
    }

    fn act_of(scripts: Vec<DeviceScript>, next: Way) -> Act {
        let plan = Plan {
            scenario: "s".into(),
            start_tolerance: Span::ZERO,
            lead: None,
            stop_condition: StopCondition::default(),
            robots: vec![RobotPlan { robot: "r".parse().unwrap(), scripts }],
        };
        let mut act = Choreography::of_plan(plan).acts.remove(0);
        (act.next, act.on_failure, act.on_doubt) = (next, FailurePolicy::default(), OnDoubt::Start);
        act
    }

    fn of(acts: Vec<Act>, queue: u32) -> Vec<(usize, RefillKind, i64)> {
        let refills = refills(
            &Choreography { scenario: "s".into(), acts, requirements: Requirements::default() },
            |_, _| Some(queue),
            Span::ZERO,
        );
        refills.iter().map(|r| (r.act, r.kind, r.time.as_nanos() / 1_000_000)).collect()
    }

    use RefillKind::{First, Later};

    #[test]
    fn time_for_next_script_is_that_of_the_scripts_in_between() {
        let acts = || vec![act(&[1_000, 2_000, 3_000, 4_000], Way::End)];
        assert_eq!(of(acts(), 2), [(0, Later, 2_000)]);
        assert_eq!(of(acts(), 3), [(0, Later, 5_000)]);
        assert_eq!(of(acts(), 4), []);
        // There is room once the previous script has ended, which is when the next one starts.
        assert_eq!(of(acts(), 1), [(0, Later, 0)]);
    }

    #[test]
    fn refill_chain_continues_across_acts_that_follow_at_once() {
        let acts = || vec![act(&[1_000, 500], Way::Act(1)), act(&[300, 700], Way::End)];
        assert_eq!(of(acts(), 2), [(1, First, 500), (1, Later, 300)]);
        assert_eq!(of(acts(), 3), [(1, Later, 800)]);
        assert_eq!(of(acts(), 4), []);
        let mut waiting = acts();
        waiting[1].wait = Wait::Operator;
        assert_eq!(of(waiting, 2), []);
    }

    #[test]
    fn act_waiting_for_a_passed_time_may_start_with_leftover_scripts() {
        let mut acts = vec![act(&[1_000, 500], Way::Act(1)), act(&[300, 700], Way::End)];
        acts[1].wait = Wait::Operator;
        let choreography = Choreography { scenario: "s".into(), acts, requirements: Requirements::default() };
        let later = |pause| {
            let pause = Span::from_millis(pause);
            let refills = refills_behind(&choreography, (0, 1), pause, |_, _| Some(2), Span::ZERO);
            let later = refills.iter().filter(|refill| refill.kind == Later);
            later.map(|refill| (refill.act, refill.time.as_nanos() / 1_000_000)).collect::<Vec<_>>()
        };
        assert_eq!((later(0), later(150)), (vec![(1, 300)], vec![(1, 450)]));
    }

    #[test]
    fn each_robot_has_its_own_refill_and_the_act_has_the_tightest() {
        let mut both = act(&[300, 300, 300], Way::End);
        let slower = act(&[500, 500, 500], Way::End).plan.robots.remove(0);
        both.plan.robots.push(RobotPlan { robot: "s".parse().unwrap(), ..slower });
        let choreography =
            Choreography { scenario: "s".into(), acts: vec![both], requirements: Requirements::default() };
        let of_each = refills_of_robots(&choreography, |_, _| Some(2), Span::ZERO);
        let of_each: Vec<_> = of_each.iter().map(|it| (it.robot.as_str(), it.time)).collect();
        assert_eq!(of_each, [("r", Span::from_millis(300)), ("s", Span::from_millis(500))]);
        assert_eq!(refills(&choreography, |_, _| Some(2), Span::ZERO).len(), 1);
    }

    #[test]
    fn device_finishing_before_its_act_frees_room_earlier() {
        let first = act_of(vec![script("arm", 0, 1_000), script("leg", 0, 3_000)], Way::Act(1));
        assert_eq!(of(vec![first, act(&[1_000], Way::End)], 1), [(1, First, 2_000)]);
    }

    #[test]
    fn act_without_the_device_gives_it_more_time() {
        let pause = act_of(vec![script("leg", 0, 700)], Way::Act(2));
        let acts = vec![act(&[1_000], Way::Act(1)), pause, act(&[1_000], Way::End)];
        assert_eq!(of(acts, 1), [(2, First, 700)]);
    }

    #[test]
    fn circular_and_merging_lines_of_acts_are_followed() {
        assert_eq!(of(vec![act(&[1_000, 200], Way::Act(0))], 2), [(0, First, 200), (0, Later, 1_000)]);
        // The second act also leads to the third, and leaves more scripts on the device.
        let mut second = act(&[1_000, 100], Way::Act(2));
        second.wait = Wait::Operator;
        let acts = vec![act(&[1_000], Way::Act(2)), second, act(&[50, 50], Way::End)];
        assert_eq!(of(acts, 2), [(2, First, 100), (2, Later, 50)]);
    }

    #[test]
    fn tightest_refill_of_an_act_names_the_script_that_frees_room() {
        let acts = vec![act(&[900, 100], Way::Act(1)), act(&[400, 300, 200, 100], Way::End)];
        let choreography = Choreography { scenario: "s".into(), acts, requirements: Requirements::default() };
        let refills_of = |queue| refills(&choreography, |_, _| queue, Span::ZERO);
        let all = refills_of(Some(2));
        let tightest = all.iter().find(|refill| refill.act == 1 && refill.kind == Later).unwrap();
        assert_eq!(tightest.script, 3);
        assert_eq!((tightest.freed_by, tightest.time), (Freed { act: 1, script: 1 }, Span::from_millis(200)));
        assert_eq!(refills_of(None), []);
    }

    #[test]
    fn act_waiting_for_room_gives_its_later_scripts_more_time() {
        // The first act leaves two scripts on the device, which end when it ends.
        let mut first = act(&[1_000, 0], Way::Act(1));
        first.plan.robots[0].scripts.remove(0);
        first.plan.robots[0].scripts.push(script("arm", 1_000, 0));
        let choreography = Choreography {
            scenario: "s".into(),
            acts: vec![first, act(&[0, 500], Way::End)],
            requirements: Requirements::default(),
        };
        let times = |sending: i64| {
            let refills = refills(&choreography, |_, _| Some(2), Span::from_millis(sending));
            refills.iter().map(|refill| refill.time.as_nanos() / 1_000_000).collect::<Vec<_>>()
        };
        assert_eq!(times(0), [0, 0]);
        assert_eq!(times(80), [0, 80]);
    }

    #[test]
    fn thousands_of_merging_lines_in_a_long_act_are_processed_quickly() {
        let long = act(&vec![10; 20_000], Way::End);
        let short = |_| Act { wait: Wait::Operator, ..act(&[10], Way::Act(0)) };
        let acts: Vec<Act> = std::iter::once(long).chain((0..20_000).map(short)).collect();
        assert_eq!(of(acts, 2), [(0, Later, 10)]);
    }
}
