//! Checks the acts and scripts in a report.

use downbeat_robot::set_log::LogEntry;
use urrcp::Span;

use super::{GRAIN, Said};
use crate::Happened;
use crate::check::facts::{SentAct, SentScript};
use downbeat_mission::{ActNumber, ActReport, ActRobot, DeviceReport, DeviceState, Progress, SkewBudget};

/// Delay after which a step is counted as late.
const LATE: Span = Span::from_millis(1);

impl Said<'_> {
    pub(super) fn acts(&self, wrong: &mut Vec<String>) {
        for said in &self.report.acts {
            let same = |act: &&SentAct<'_>| {
                act.promise.number == said.number && act.promise.timestamp + act.ahead == said.timestamp
            };
            match self.facts.acts.iter().rfind(same) {
                Some(act) => self.act(act, said, wrong),
                None => wrong
                    .push(format!("the report contains act {}, but no such act was promised", said.number)),
            }
        }
        let numbers: Vec<ActNumber> = self.report.acts.iter().map(|act| act.number).collect();
        let is_known = |act: &&SentAct<'_>| {
            let is_kept = self.resumed_at.is_none() || !act.superseded && self.facts.was_kept(act.at);
            !act.repeated && is_kept
        };
        let reported = self.facts.acts.iter().filter(is_known);
        let missing = reported.map(|act| act.promise.number).filter(|number| !numbers.contains(number));
        if !self.is_withdrawn && self.report.acts_omitted == 0 {
            wrong.extend(
                missing.map(|number| format!("act {number} was promised, but is missing from the report")),
            );
        }
    }

    fn act(&self, act: &SentAct<'_>, said: &ActReport, wrong: &mut Vec<String>) {
        let number = said.number;
        let promise = act.promise;
        if said.start != promise.start + act.ahead {
            wrong.push(format!(
                "act {number} starts at {} according to the report, but {} was promised",
                said.start, promise.start
            ));
        }
        if (said.lead.total() - (promise.start - promise.timestamp)).abs() > GRAIN {
            wrong.push(format!(
                "act {number} is reported with a lead of {}, which was not promised",
                said.lead.total()
            ));
        }
        if !self.facts.was_resumed(act) {
            // The skew budgets are compared in the form of the journal, which omits derived values.
            let json = |skew: Option<&SkewBudget>| serde_json::to_value(skew).ok();
            if json(said.skew.as_ref()) != json(act.skew) {
                wrong.push(format!("act {number} is reported with a different skew budget than announced"));
            }
            if act.decided.is_some_and(|decided| decided.doubt != said.doubt) {
                wrong.push(format!(
                    "act {number} is reported with a doubt of {}, which was not announced",
                    said.doubt
                ));
            }
        }
        self.window(act, said, wrong);
        let errors = || said.robots.iter().flat_map(firsts).filter_map(|script| script.start_error);
        let spread = errors().max().zip(errors().min()).map(|(most, least)| most - least);
        if spread != said.spread {
            wrong.push(format!(
                "act {number} is reported with a spread of {:?}, but its starts have a spread of {spread:?}",
                said.spread
            ));
        }
        for robot in &said.robots {
            self.robot(act, robot, wrong);
        }
    }

    /// Checks that a commitment window in the report was announced, and that every robot received a message within it.
    fn window(&self, act: &SentAct<'_>, said: &ActReport, wrong: &mut Vec<String>) {
        let number = said.number;
        let Some(window) = said.window else { return };
        let told = self.facts.ran.history.iter().find_map(|(at, happened)| match happened {
            Happened::Told(progress) => match &**progress {
                Progress::Committed { act: name, window: told }
                    if *name == said.act && *told == Some(window) =>
                {
                    Some(*at).filter(|at| *at >= act.at)
                }
                _ => None,
            },
            _ => None,
        });
        let Some(at) = told else {
            return wrong.push(format!(
                "act {number} is reported with a window of {window}, which was not announced"
            ));
        };
        for robot in act.robots() {
            let out = self.facts.dropped[robot].is_some_and(|dropped| dropped <= at);
            let heard = self.facts.between(at - window, at).iter();
            let heard =
                heard.filter(|(_, what)| matches!(what, Happened::AtRobot(r, _) if *r == robot)).count();
            if heard == 0 && !out && self.facts.honest(robot) && !self.facts.clock_was_set(robot) {
                wrong.push(format!(
                    "r{robot} received no message within the commitment window of act {number}"
                ));
            }
        }
    }

    fn robot(&self, act: &SentAct<'_>, said: &ActRobot, wrong: &mut Vec<String>) {
        let Some(robot) = self.facts.index_of(&said.robot) else { return };
        let number = act.promise.number;
        let ended = self.facts.ended(act);
        let at_the_end = self.facts.dropped[robot].is_some() && self.facts.dropped[robot] == ended;
        let dropped = self.facts.dropped[robot].filter(|at| ended.is_none_or(|ended| *at < ended));
        // Nothing waits until the record of a robot that was left out is on the disk.
        let loses_power = self.resumed_at.is_some() && self.facts.drawn().disk.loses_power;
        let is_kept = |at| self.facts.was_kept(at) && !loses_power;
        let is_lost = dropped.is_some_and(|at| !is_kept(at)) && !said.left_out;
        if !self.is_withdrawn && !at_the_end && !is_lost && said.left_out != dropped.is_some() {
            let was = if said.left_out { "was not" } else { "was" };
            wrong.push(format!("r{robot} {was} left out of act {number}, but the report says otherwise"));
        }
        if !self.facts.honest(robot) {
            return;
        }
        for device in &said.devices {
            let same = |script: &&SentScript<'_>| {
                script.promised.device == device.device
                    && Some(act.start_as_told(script) + script.starts_after) == device.planned_start
            };
            match act.of(robot).find(same) {
                Some(script) => self.script(act, script, device, wrong),
                // The robot was left out before anything was promised to it.
                None if said.left_out && device.state == DeviceState::Planned => {}
                None => wrong.push(format!(
                    "the report of r{robot} contains a script that is not part of act {number}"
                )),
            }
        }
    }

    /// Compares the report on a script with the robot's log.
    fn script(
        &self,
        act: &SentAct<'_>,
        script: &SentScript<'_>,
        said: &DeviceReport,
        wrong: &mut Vec<String>,
    ) {
        let robot = script.robot;
        let name = script.promised.request_id.as_str();
        let mut wrongly = |what: String| wrong.push(format!("{what}: r{robot}, {name}, {:?}", said.state));
        let (set, written) = (script.steps_set(), script.steps_written());
        let done = said.steps_done as usize;
        if said.steps_planned != written {
            wrongly(format!(
                "{} steps are reported as planned, but the script has {written}",
                said.steps_planned
            ));
        }
        let over = matches!(said.state, DeviceState::Ended | DeviceState::Failed);
        // If the clock was set between two processes, the robot's report about its script may seem impossible.
        let by_its_clock = act.ahead == self.facts.ran.server_ahead;
        let known = over && by_its_clock && !self.is_discredited(robot) && self.facts.counts_steps(robot);
        if done > set || (known && done != set) {
            wrongly(format!("{done} steps are reported as done, but {set} were executed"));
        }
        if said.state == DeviceState::Ended && set != written {
            wrongly(format!("reported as ended, but {set} of {written} steps were executed"));
        }
        if said.state == DeviceState::Planned && script.began() {
            wrongly("reported as not sent, but the script started".to_owned());
        }
        if said.state == DeviceState::Started && !script.began() {
            wrongly("reported as started, but the script did not start".to_owned());
        }
        let late = script.steps().filter(|entry| entry.set_at - entry.due > LATE).count();
        let said_late = said.late_steps as usize;
        if said_late > late || (said.state == DeviceState::Ended && known && said_late != late) {
            wrongly(format!("{said_late} late steps are reported, but {late} steps were late"));
        }
        // A response without a request id is assigned to the next matching script. If an earlier response was lost, that is the wrong
        // script.
        let named = self.facts.counts_steps(robot);
        let lost = self.facts.offset_may_be_lost(act, script);
        if let Some(what) = wrong_start(act, script, said, lost).filter(|_| named) {
            wrongly(what);
        }
    }
}

/// Describes the fault of a start in the report; `None` if the start is correct. It must be the start that the robot logged by its own
/// clock. If the script's clock offset may be lost, the reported error may be unknown.
fn wrong_start(
    act: &SentAct<'_>,
    script: &SentScript<'_>,
    said: &DeviceReport,
    lost: bool,
) -> Option<String> {
    let started = said.started_at?;
    let Some(first) = script.log.first() else {
        return Some(format!("reported as started at {started}, but the script did not start"));
    };
    if (first.set_at - started).abs() > GRAIN {
        return Some(format!("reported as started at {started}, but the script started at {}", first.set_at));
    }
    let error = error_by_its_clock(act, script, first);
    // If the record of the offset is lost, only the robot knows it.
    let by_robot = script.arrived_shift.filter(|_| lost).map(|shift| error + script.shift - shift);
    let is =
        |said: Span| (said - error).abs() <= GRAIN || by_robot.is_some_and(|it| (said - it).abs() <= GRAIN);
    let differs = said.start_error.map_or(!lost, |said| !is(said));
    differs.then(|| {
        format!(
            "reported as started {:?} off its plan, but the script started {error} off its plan",
            said.start_error
        )
    })
}

/// Returns the actual start of a script minus its planned start, by the robot's own clock.
pub(super) fn error_by_its_clock(act: &SentAct<'_>, script: &SentScript<'_>, first: &LogEntry) -> Span {
    let planned = act.start_as_told(script) + script.starts_after + script.shift;
    first.set_at - planned.assume_clock()
}

/// Returns the first script of each device. All of these start together.
fn firsts(robot: &ActRobot) -> impl Iterator<Item = &DeviceReport> {
    let devices = robot.devices.iter().enumerate();
    let first = |(index, script): &(usize, &DeviceReport)| {
        index.checked_sub(1).is_none_or(|before| robot.devices[before].device != script.device)
    };
    devices.filter(first).map(|(_, script)| script)
}
