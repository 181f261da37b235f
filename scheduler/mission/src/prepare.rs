//! Decides when the scripts of an act are sent, and with which lead time. The decision depends on the whole mission, not only on the act.

use urrcp::{Command, ControlRequest, Message, Millis, RobotId, Server, Span, Timestamp, encode};

use super::act::timing::{CLOCK_UNKNOWN, Leases, Measured, Pace};
use super::act::{Act, Member, Timing};
use super::failure_kind::{FailureKind, Slow};
use super::lead::{self, LeadTime};
use super::robot_state::{Link, RobotState, Standing};
use super::skew::SkewBudget;
use super::{ClockMode, Greeting, Mission, Outcome, RobotIndex, ledger};

/// How long before its latest sending time an act that follows another is sent at the earliest.
const AHEAD: Span = Span::from_millis(2_000);
/// The longest pending lease of an act that is sent before its latest sending time. With it, the act survives a link that freezes for a
/// moment while other acts play.
const LEASE_AHEAD_MAX: Span = Span::from_millis(2_000);

/// Interval between checks whether the next act may be sent, given the clocks of robots that still play.
const LOOK_AGAIN: Span = Span::from_millis(100);

/// The smallest allowance for the delay of a slow machine that is still halved to fit into a lease. A smaller allowance is dropped.
const HOLD_UP_LEAST: Span = Span::from_millis(5);

/// Additional time for robots to accept an act if the round trip of a link is unknown, as with `handshake: skip`. The first answer of a
/// robot may be slow.
const UNMEASURED: Span = Span::from_millis(500);

/// Time for robots to answer before an act is promised, in addition to three round trips.
const ANSWERED_WITHIN: Span = Span::from_millis(200);

/// The timing that an act needs: its lead time, its pace, and the robot with the slowest link.
struct Need {
    lead: LeadTime,
    pace: Pace,
    slowest: Option<(RobotId, Span)>,
}

impl Mission {
    /// Sends the act once its time has come and the devices have room for it.
    pub(super) fn prepare_if_it_fits(&mut self, now: Timestamp<Server>, index: usize) {
        let act = &self.acts[index];
        if !act.is_looked_at(now) || act.present().next().is_none() {
            return;
        }
        if !self.disk_is_known() {
            return self.await_disk(now, index);
        }
        let fits = || ledger::fits(&self.acts, index, &self.robots) && !self.is_too_tight_behind(now, index);
        if !act.is_alone() && !fits() {
            // Room is checked again whenever something ends.
            return self.acts[index].look_again_at(Some(now + AHEAD));
        }
        let unknown = self.unknown_clocks(act);
        if !unknown.is_empty() {
            return self.await_clocks(now, index, unknown);
        }
        let unmeasured = self.unmeasured_on_new_links(now, act);
        if !unmeasured.is_empty() {
            return self.await_answers(now, index, unmeasured);
        }
        let skew = self.skew_of(act, now);
        let slow = self.too_slow(act, skew.as_ref());
        if !slow.is_empty() {
            return self.refuse_or_look_again(now, index, slow);
        }
        let need = match self.need(now, act, skew.as_ref()) {
            Ok(need) => need,
            Err(outcome) => return self.cannot_prepare(now, outcome),
        };
        if self.leaves_alone(index, need.pace.silence()) {
            return self.acts[index].look_again_at(Some(now + LOOK_AGAIN));
        }
        let from = act.target().map(|target| target - need.lead.total() - AHEAD);
        if let Some(from) = from.filter(|from| now < *from) {
            return self.acts[index].look_again_at(Some(from));
        }
        let start = (now + need.lead.total()).max(act.target().unwrap_or(now));
        let offenders = self.skew_ahead(act, now, start).map(|skew| skew.offenders()).unwrap_or_default();
        if !offenders.is_empty() {
            let at = |id| self.robots.position(|robot| robot.id == id);
            let failing = offenders.into_iter().filter_map(|(id, kind)| Some((at(id)?, kind))).collect();
            return self.refuse_or_look_again(now, index, failing);
        }
        if let Some(until) = self.links_known_at(&self.acts[index]).filter(|until| now < *until) {
            return self.acts[index].look_again_at(Some(until));
        }
        if let Some(until) = self.await_links(now, index, need.lead.total()) {
            return self.acts[index].look_again_at(Some(until));
        }
        let send_by = self.acts[index].start_to_keep(&self.options).map(|start| start - need.lead.total());
        if let Some(due) = self.await_positions(now, index, send_by) {
            return self.acts[index].look_again_at(Some(due));
        }
        let jumping = self.unplaced_that_jump(index);
        if !jumping.is_empty() {
            return self.refuse_jumps(now, index, jumping);
        }
        self.send_act(now, index, need);
    }

    /// Handles robots whose devices would have to jump at the start of an act. Robots that joined late are left out, whatever the policy,
    /// because the others could begin without them. Any other robot fails.
    fn refuse_jumps(
        &mut self,
        now: Timestamp<Server>,
        index: usize,
        jumping: Vec<(RobotIndex, FailureKind)>,
    ) {
        let (joined, failing): (Vec<_>, Vec<_>) =
            jumping.into_iter().partition(|(robot, _)| self.robots[*robot].joined_late);
        for (robot, kind) in joined {
            self.note_failure(robot, kind);
            if self.robots[robot].standing == Standing::In {
                self.drop_robot(now, robot);
            }
        }
        // The act may have no robots left.
        self.acts[index].look_again_at(Some(now));
        if !failing.is_empty() {
            self.fail_all(now, failing);
        }
    }

    /// Fails these robots, unless one of them still has a part in an earlier act. In that case, checks again later.
    fn refuse_or_look_again(
        &mut self,
        now: Timestamp<Server>,
        index: usize,
        failing: Vec<(RobotIndex, FailureKind)>,
    ) {
        if failing.iter().any(|(robot, _)| self.plays_before(index, *robot)) {
            return self.acts[index].look_again_at(Some(now + LOOK_AGAIN));
        }
        self.fail_all(now, failing);
    }

    /// The robots for which the act would need a longer lease than permitted. No robot may make all others wait without bound.
    fn too_slow(&self, act: &Act, skew: Option<&SkewBudget>) -> Vec<(RobotIndex, FailureKind)> {
        let longest = lead::LEASE_MAX;
        let prescribed = act.written().plan.stop_condition.pending;
        let round_trip = lead::counted(self.slowest(act).map_or(Span::ZERO, |(_, round_trip)| round_trip));
        let lease = self.measured(act, round_trip, None, skew).lease_least();
        if prescribed.is_some() || lease <= longest {
            return Vec::new();
        }
        let needs = |member: &Member| {
            let robot = &self.robots[member.robot];
            let (early, late) = skew.and_then(|skew| skew.early_and_late_of(&robot.id)).unwrap_or_default();
            let round_trip = lead::counted(robot.round_trip());
            let slow = Slow::Lease { lease, longest, round_trip, early, late };
            (early + late + round_trip * 5, member.robot, FailureKind::TooSlow { slow })
        };
        let needs: Vec<_> = act.present().map(needs).collect();
        let most = needs.iter().map(|(needed, ..)| *needed).max().unwrap_or_default();
        let slow = needs.into_iter().filter(|(needed, ..)| *needed >= most.min(longest));
        slow.map(|(_, robot, kind)| (robot, kind)).collect()
    }

    /// The time by which the pending answers are due that show whether a link is always slow or was slow only once; `None` if no such
    /// answer is pending. Waiting for them takes less time than they may save in the lead time.
    fn links_known_at(&self, act: &Act) -> Option<Timestamp<Server>> {
        let members = act.present().map(|member| &self.robots[member.robot]);
        let unknown = members.filter(|robot| robot.is_up() && !robot.clock.tells_outliers());
        unknown
            .filter_map(|robot| {
                Some(robot.contact.questions.last_unanswered()? + lead::counted(robot.round_trip()))
            })
            .max()
    }

    /// Whether a robot still has a part in an act before this one. Such a robot can finish the earlier act, even if it does not fit this
    /// one.
    fn plays_before(&self, index: usize, robot: RobotIndex) -> bool {
        self.acts[..index].iter().any(|act| act.has_something_on(robot))
    }

    /// Whether a robot would lose its lease of an earlier act that it still plays or holds, if it received nothing for `silence`. The
    /// error of its clock can cause this: the robot may not even have begun a script that the others have already ended.
    fn leaves_alone(&self, index: usize, silence: Span) -> bool {
        let (before, act) = (&self.acts[..index], &self.acts[index]);
        let both = |other: &&Act| act.present().any(|member| other.has_something_on(member.robot));
        let leases = before.iter().filter(both).filter_map(|other| other.lease_with(act));
        leases.min().is_some_and(|lease| lease < silence)
    }

    /// Waits for the disk, because a promise must be stored before it is sent. If the disk stalls for longer than `patience`, the mission
    /// ends.
    fn await_disk(&mut self, now: Timestamp<Server>, index: usize) {
        let (within, since) = (self.options.patience, self.acts[index].since());
        if now < since + within {
            return self.acts[index].look_again_at(Some(since + within));
        }
        self.journal_lost(
            now,
            format!("the disk has not stored the first record of the journal within {within}"),
        );
    }

    pub(super) fn skew_of(&self, act: &Act, now: Timestamp<Server>) -> Option<SkewBudget> {
        SkewBudget::of(act.present(), &self.robots, act.written().plan.start_tolerance, now)
    }

    /// The expected skew of the starts, if the act is sent now.
    fn skew_ahead(&self, act: &Act, now: Timestamp<Server>, start: Timestamp<Server>) -> Option<SkewBudget> {
        let tolerance = act.written().plan.start_tolerance;
        SkewBudget::ahead(act.present(), &self.robots, tolerance, now, start)
    }

    /// The indices of robots of the act whose clocks must be measured but have not been, for example after a mission was resumed.
    fn unknown_clocks(&self, act: &Act) -> Vec<RobotIndex> {
        let full = self.options.greeting == Greeting::Full;
        let unknown = |robot: &RobotIndex| {
            let robot = &self.robots[*robot];
            robot.clock.samples() == 0 && (full || robot.settings.clock == ClockMode::Measured)
        };
        act.present().map(|member| member.robot).filter(unknown).collect()
    }

    fn await_clocks(&mut self, now: Timestamp<Server>, index: usize, unknown: Vec<RobotIndex>) {
        let (within, since) = (self.options.patience, self.acts[index].since());
        if now < since + within {
            for robot in unknown {
                // The next round may come too late.
                if self.robots[robot].contact.questions.last_unanswered().is_none() {
                    self.ask(now, robot);
                }
            }
            return self.acts[index].look_again_at(Some(since + within));
        }
        let silent = |robot| {
            let awaited = "answer with its clock times".to_owned();
            (robot, FailureKind::Silent { awaited, within })
        };
        self.fail_all(now, unknown.into_iter().map(silent).collect());
    }

    /// The robots of an act whose clocks were measured only on an earlier link, each with its deadline for an answer on its new link. A
    /// robot that does not identify itself by that deadline is treated like one without a link.
    fn unmeasured_on_new_links(
        &self,
        now: Timestamp<Server>,
        act: &Act,
    ) -> Vec<(RobotIndex, Timestamp<Server>)> {
        let unmeasured = |robot: RobotIndex| {
            let state = &self.robots[robot];
            let (linked, within) = (state.unmeasured_since()?, answers_within(state));
            if state.is_up() {
                return Some((robot, state.contact.questions.unanswered().unwrap_or(now) + within));
            }
            Some((robot, linked + within)).filter(|(_, until)| now < *until)
        };
        act.present().filter_map(|member| unmeasured(member.robot)).collect()
    }

    /// Tries to reach robots of the act without a link, because such a robot may come back with a different clock. If an attempt is still
    /// pending, returns the deadline of the attempts. The act is promised even to a robot that cannot be reached, because it may come
    /// back in time.
    fn await_links(&mut self, now: Timestamp<Server>, index: usize, lead: Span) -> Option<Timestamp<Server>> {
        let act = &mut self.acts[index];
        let failed = |robot: RobotIndex| match &self.robots[robot].link {
            Link::Lost(lost) if lost.connecting => Some((robot, lost.failed)),
            _ => None,
        };
        let lost: Vec<_> = act.present().filter_map(|member| failed(member.robot)).collect();
        let within = lost.iter().map(|(robot, _)| answers_within(&self.robots[*robot])).max()?;
        let begun = act.links_tried().unwrap_or(now);
        if act.links_tried().is_none() {
            act.tries_links(now);
            lost.iter().for_each(|(robot, _)| self.reconnect_at_once(*robot));
        }
        let until = begun + within;
        let until = self.acts[index].target().map_or(until, |target| until.min(target - lead));
        let lasts = now < until && lost.iter().any(|(_, failed)| *failed <= begun);
        lasts.then_some(until)
    }

    fn await_answers(
        &mut self,
        now: Timestamp<Server>,
        index: usize,
        unmeasured: Vec<(RobotIndex, Timestamp<Server>)>,
    ) {
        let (waits, silent): (Vec<_>, Vec<_>) = unmeasured.into_iter().partition(|(_, until)| now < *until);
        if !silent.is_empty() {
            let kind = |robot: RobotIndex| FailureKind::Silent {
                awaited: "answer on its new link".to_owned(),
                within: answers_within(&self.robots[robot]),
            };
            let failing = silent.into_iter().map(|(robot, _)| (robot, kind(robot))).collect();
            return self.refuse_or_look_again(now, index, failing);
        }
        for (robot, _) in &waits {
            // The question that begins the link may have had to wait for another act.
            if self.robots[*robot].contact.questions.last_unanswered().is_none() {
                self.ask(now, *robot);
            }
        }
        let due = waits.into_iter().map(|(_, until)| until).min();
        self.acts[index].look_again_at(due);
    }

    /// Ends the mission because a lead time or a lease is too short. If no robot holds anything that could move it, not even a stop is
    /// sent.
    fn cannot_prepare(&mut self, now: Timestamp<Server>, outcome: Outcome) {
        if self.robots.iter().all(RobotState::holds_nothing) {
            self.refuse(outcome)
        } else {
            self.abort(now, outcome, super::robot_state::Rest::InPlace, None)
        }
    }

    /// The timing that an act needs. It allows for the lateness of this machine if the times that the scenario or the operator prescribes
    /// leave room for that.
    fn need(&self, now: Timestamp<Server>, act: &Act, skew: Option<&SkewBudget>) -> Result<Need, Outcome> {
        let need = |lateness| self.need_with_lateness(lateness, now, act, skew);
        need(self.machine.lateness.largest()).or_else(|_| need(Span::ZERO))
    }

    /// The timing that an act needs on a machine with this lateness. It also allows for the last delay of this machine (`hold_up`), which
    /// is halved until it fits into a lease that the scenario prescribes.
    fn need_with_lateness(
        &self,
        lateness: Span,
        now: Timestamp<Server>,
        act: &Act,
        skew: Option<&SkewBudget>,
    ) -> Result<Need, Outcome> {
        let mut hold_up = self.machine.hold_up;
        loop {
            match self.need_with(hold_up, lateness, now, act, skew) {
                Err(Outcome::LeaseTooShort { .. }) if hold_up > Span::ZERO => {
                    hold_up = if hold_up > HOLD_UP_LEAST { hold_up / 2 } else { Span::ZERO };
                }
                need => return need,
            }
        }
    }

    fn need_with(
        &self,
        hold_up: Span,
        lateness: Span,
        now: Timestamp<Server>,
        act: &Act,
        skew: Option<&SkewBudget>,
    ) -> Result<Need, Outcome> {
        let plan = &act.written().plan;
        let slowest = self.slowest(act);
        let prescribed = plan.stop_condition.pending.map(Millis::span);
        let slow = slowest.as_ref().map_or(Span::ZERO, |(_, round_trip)| *round_trip);
        let round_trip = lead::counted(slow + hold_up);
        let measured = Measured { lateness, ..self.measured(act, round_trip, prescribed, skew) };
        let least = (LeadTime::lease_needed(round_trip) + measured.lateness * 2).max(measured.lease_least());
        if let Some(lease) = prescribed.filter(|lease| *lease < least) {
            return Err(Outcome::LeaseTooShort { lease, needed: least });
        }
        let (requests, bytes) = (measured.scripts, request_bytes(act, now));
        let with = |lease: Span| {
            let pace = Pace::of(&measured, lease);
            let needed = LeadTime::needed(round_trip, requests, bytes, &pace, lease);
            (LeadTime { prepare: needed.prepare + measured.record + lateness * 2, ..needed }, pace)
        };
        let lease = prescribed.unwrap_or(least);
        let (needed, _) = with(lease);
        self.check_start(now, act, &needed)?;
        let spare = act.target().map_or(Span::ZERO, |target| target - now - needed.total());
        let longer = match measured.leases {
            // The other half is reserved for the answers.
            Leases::Shortened if prescribed.is_none() => lease.max((lease + spare / 2).min(LEASE_AHEAD_MAX)),
            _ => lease,
        };
        let (needed, pace) = with(longer);
        let unmeasured = act.target().is_none()
            && act.present().any(|member| self.robots[member.robot].clock.samples() == 0);
        let usual = needed.total() + if unmeasured { UNMEASURED } else { Span::ZERO };
        let wanted = self.wanted_lead(act).unwrap_or(usual);
        Ok(Need { lead: needed.stretched_to(wanted), pace, slowest })
    }

    fn measured(
        &self,
        act: &Act,
        round_trip: Span,
        prescribed: Option<Span>,
        skew: Option<&SkewBudget>,
    ) -> Measured {
        let tolerance = act.written().plan.start_tolerance.min(CLOCK_UNKNOWN);
        let (early, late) = skew.map_or((tolerance, tolerance), SkewBudget::early_and_late);
        let inquiries = act.present().all(|member| self.robots[member.robot].takes_inquiries());
        Measured {
            robots: act.present().count(),
            scripts: act.present().map(|member| member.scripts().len()).sum(),
            questions: act.present().map(Member::questions).max().unwrap_or(1),
            leases: if inquiries && prescribed.is_none() { Leases::Shortened } else { Leases::Fixed },
            round_trip,
            early,
            late,
            record: self.recording_time(),
            lateness: Span::ZERO,
        }
    }

    /// The robot of an act with the slowest link, and its round trip.
    fn slowest(&self, act: &Act) -> Option<(RobotId, Span)> {
        let robots = act.present().map(|member| &self.robots[member.robot]);
        let slowest = robots.max_by_key(|robot| robot.round_trip());
        slowest.map(|robot| (robot.id.clone(), robot.round_trip()))
    }

    fn wanted_lead(&self, act: &Act) -> Option<Span> {
        self.options.lead.or(act.written().plan.lead).filter(|_| act.target().is_none())
    }

    /// Checks the prescribed start or lead time of an act. The act keeps it or is refused; its start is never silently delayed.
    fn check_start(&self, now: Timestamp<Server>, act: &Act, needed: &LeadTime) -> Result<(), Outcome> {
        let safe_start = now + needed.total();
        let wanted = self.wanted_lead(act).filter(|_| self.machine.hold_up == Span::ZERO);
        if let Some(lead) = wanted.filter(|lead| *lead < needed.total()) {
            return Err(Outcome::LeadTooShort { lead, needed: *needed, safe_start });
        }
        // The act begins after the end of the previous act, even if it was planned earlier.
        let safe_start = act.target().map_or(safe_start, |target| safe_start.max(target));
        let is_late = |start: &Timestamp<Server>| *start + self.options.fixed.within < safe_start;
        match act.must_start_at().filter(is_late) {
            Some(start) => Err(Outcome::StartTooSoon { start, safe_start }),
            None => Ok(()),
        }
    }

    fn send_act(&mut self, now: Timestamp<Server>, index: usize, need: Need) {
        // The act is sent later than any stop, because a stop takes back everything sent before it.
        let now = self.timers.stopped_at.map_or(now, |stopped| now.max(stopped + Span::from_nanos(1)));
        let act = &self.acts[index];
        let target = act.target();
        let slip = self.slip(act, now);
        let lead = need.lead.stretched_to(target.unwrap_or(now) + slip - now);
        let timing = Timing::new(now, lead, need.pace, act.written().plan.duration());
        let gap = target.map(|target| timing.start - target);
        let skew = self.skew_ahead(act, now, timing.start);
        let played = self.acts[..index].iter().filter_map(|before| before.lease_with(act)).min();
        let timing = Timing { skew, slowest: need.slowest, gap, played, ..timing };
        let shift_of = |robot: &RobotState| {
            let measured = robot.clock_at(now).filter(|_| robot.settings.clock == ClockMode::Measured);
            measured.map_or(Span::ZERO, |reading| reading.offset)
        };
        let session = self.options.session_name();
        let (names, actions) = self.acts[index].promise(timing, &self.robots, session, shift_of);
        for (robot, id, script) in names {
            self.robots[robot].requests.add_script(id, script);
        }
        for member in self.acts[index].members() {
            let robot = &mut self.robots[member.robot];
            robot.shift = member.shift();
            member.scripts().iter().for_each(|script| _ = robot.pose.adrift.remove(&script.plan.device));
        }
        let number = self.acts[index].number();
        self.carry_out(now, number, actions);
        let lease = self.acts.get(index).and_then(Act::shortest_lease);
        self.quicken_rounds(now, lease);
    }

    /// The largest amount by which a robot's measured clock has gone back since the robot's scripts of another act were translated to
    /// that clock. The next act starts later by this amount, so that it does not overlap those scripts.
    fn slip(&self, act: &Act, now: Timestamp<Server>) -> Span {
        let earlier = |member: &Member| {
            let robot = &self.robots[member.robot];
            let plays = |other: &Act| other.number() != act.number() && other.member(member.robot).is_some();
            let playing = self.acts.iter().any(plays);
            let offset = robot
                .clock_at(now)
                .filter(|_| playing && robot.settings.clock == ClockMode::Measured)?
                .offset;
            Some(robot.shift - offset)
        };
        act.present().filter_map(earlier).max().unwrap_or(Span::ZERO).max(Span::ZERO)
    }
}

/// The time within which a robot must answer a request for its positions, or any question after it has reconnected.
pub(super) fn answers_within(robot: &RobotState) -> Span {
    lead::counted(robot.round_trip()) * 3 + ANSWERED_WITHIN
}

/// The number of bytes in the requests of an act, estimated from the real encoding of its largest script.
fn request_bytes(act: &Act, now: Timestamp<Server>) -> usize {
    let scripts = || act.present().flat_map(|member| member.scripts());
    let Some(largest) = scripts().max_by_key(|script| script.plan.script.steps().len()) else { return 0 };
    let mut line = Vec::new();
    let command = Command::Script(largest.plan.script.clone());
    let mut request = ControlRequest::immediate(largest.plan.device.clone(), command);
    request.timestamp = Some(now);
    encode(&Message::ControlRequest(request), &mut line);
    let steps: usize = scripts().map(|script| script.plan.script.steps().len()).sum();
    let step_bytes = line.len() / largest.plan.script.steps().len().max(1);
    steps * step_bytes + scripts().count() * 256
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::bench::{R0, Tells, at, played, robot};
    use crate::clock::{ClockEstimate, ClockSample};
    use crate::robot_state::Robots;
    use crate::{ActIndex, ActNumber, Event, MissionOptions, Participant};

    #[test]
    fn upload_size_is_estimated_from_steps_and_requests() {
        let robots = Robots::from_iter([robot("r0", Tells::Everything, 2)]);
        let bytes = |scripts: &[(&str, i64, i64)]| {
            request_bytes(
                &Act::new(played(&[scripts]), ActIndex::new(0), ActNumber::new(0), &robots, at(0), None),
                at(0),
            )
        };
        let one = bytes(&[("a", 0, 400)]);
        // Two steps of about a hundred bytes, and the remaining request.
        assert!((300..1_000).contains(&one), "{one}");
        assert_eq!(bytes(&[("a", 0, 400), ("b", 0, 400)]), 2 * one);
    }

    /// A mission with `acts` acts of one robot. The robot's clock is ahead by `ahead`, but the times last sent to it were 7 ms ahead.
    fn plays(acts: u32, clock: ClockMode, ahead: Span) -> Mission {
        let choreography = played(&[&[("a", 0, 400)]]);
        let participants = vec![Participant::new(RobotId::new("r0").unwrap(), None)];
        let options = MissionOptions::default();
        let mut mission = Mission::new(Arc::clone(&choreography), participants, options, at(0)).unwrap();
        mission.robots[R0].settings.clock = clock;
        mission.robots[R0].shift = Span::from_millis(7);
        let there = at(0).assume_clock::<urrcp::Robot>() + ahead;
        mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(0)));
        for number in 0..acts {
            mission.acts.push(Act::new(
                Arc::clone(&choreography),
                ActIndex::new(0),
                ActNumber::new(number),
                &mission.robots,
                at(0),
                None,
            ));
        }
        mission
    }

    #[test]
    fn following_act_is_delayed_by_as_much_as_a_measured_clock_went_back() {
        let millis = Span::from_millis;
        for (acts, clock, ahead, slip) in [
            (2, ClockMode::Measured, 3, 4),
            (2, ClockMode::Measured, 9, 0),
            (2, ClockMode::Ntp, 3, 0),
            (1, ClockMode::Measured, 3, 0),
        ] {
            let mission = plays(acts, clock, millis(ahead));
            let told = mission.slip(mission.acts.last().unwrap(), at(0));
            let off = (told - millis(slip)).abs();
            assert!(off < Span::from_micros(2), "{acts} acts, {clock:?}, {ahead} ms ahead: {told}");
        }
    }

    #[test]
    fn link_with_unknown_round_trip_is_awaited_until_its_response_is_due() {
        let mut mission = plays(1, ClockMode::Ntp, Span::ZERO);
        let known_at = |mission: &Mission| mission.links_known_at(&mission.acts[0]);
        mission.robots[R0].contact.questions.asked(at(10));
        assert_eq!(known_at(&mission), None, "there is no link");
        mission.robots[R0].connected(at(0));
        mission.robots[R0].named();
        assert_eq!(known_at(&mission), None, "nothing was asked on it");
        mission.robots[R0].contact.questions.asked(at(10));
        let there = at(5).assume_clock();
        mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(8)));
        assert_eq!(known_at(&mission), Some(at(10) + Span::from_millis(8)));
        mission.robots[R0].contact.questions.answer(at(10));
        assert_eq!(known_at(&mission), None);
    }

    #[test]
    fn robot_plays_before_an_act_if_it_has_scripts_of_an_earlier_one() {
        let mut mission = plays(0, ClockMode::Ntp, Span::ZERO);
        mission.robots[R0].block = robot("r0", Tells::Everything, 2).block;
        mission.options.greeting = Greeting::Skip;
        let _asked = mission.handle(at(0), Event::LinkUp { robot: R0 });
        let _waits = mission.advance(at(0));
        for count in 1..=2 {
            let _stored = mission.handle(at(0), Event::Recorded { count });
            let _sent = mission.advance(at(0));
        }
        let act = Act::new(
            mission.choreography.clone(),
            ActIndex::new(0),
            ActNumber::new(1),
            &mission.robots,
            at(0),
            None,
        );
        mission.acts.push(act);
        assert_eq!([0, 1].map(|index| mission.plays_before(index, R0)), [false, true]);
        mission.refuse_or_look_again(at(1), 1, vec![(R0, broken())]);
        assert!(!mission.robots[R0].has_failed(), "that it fits, whatever comes next");
        mission.refuse_or_look_again(at(1), 0, vec![(R0, broken())]);
        assert!(mission.robots[R0].has_failed());
    }

    #[test]
    fn robot_with_unknown_round_trip_has_longer_to_accept() {
        let lead = |measured: bool, lead| {
            let mut mission = plays(1, ClockMode::Ntp, Span::ZERO);
            mission.options.lead = lead;
            if !measured {
                mission.robots[R0].clock = ClockEstimate::default();
            }
            mission.need(at(0), &mission.acts[0], None).ok().map(|need| need.lead.total())
        };
        let usual = lead(true, None).unwrap();
        assert_eq!(lead(false, None), Some(usual + UNMEASURED));
        assert_eq!(lead(false, Some(usual)), Some(usual), "a requested lead is kept");
    }

    fn broken() -> FailureKind {
        FailureKind::Garbled { reason: "x".to_owned() }
    }
}
