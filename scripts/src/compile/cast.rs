//! The participants of a scenario: resolves names of robots, groups and roles against the fleet, and finds the devices of each robot.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, OnceLock};

use urrcp::{ControlType, Device, RobotId, Span};

use super::acts::Ways;
use crate::composed::{composed, is_same};
use crate::fields::{Name, Reader, Unset};
use crate::finding::{Code, SharedFault, one_of, robots_named};
use crate::fleet::{Fleet, FleetRobot, RateLimits, devices_of};
use crate::plan::{Act, Way};
use crate::render::counted;
use crate::scenario::{Canon, Cue, Movement};
use crate::shown::shortened;
use crate::slips;

const LISTED_TWICE: &str = "remove the duplicate: a group already includes all its robots";

/// The fleet with the scenario's roles.
pub(super) struct Cast<'a> {
    pub(super) fleet: &'a Fleet,
    roles: &'a HashMap<String, Vec<Name>>,
    /// Index of each robot in the fleet, by the robot's name in Unicode normalization form C.
    index_of: HashMap<Cow<'a, str>, usize>,
    /// Kind of each robot; robots of the same kind have the same devices and limits.
    kinds: Vec<usize>,
    /// Sorted names of robots, groups and roles; created for the first finding that lists them.
    known: OnceLock<Vec<String>>,
}

/// A robot in a cue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    pub(super) robot: usize,
    /// Number of the robot's movement: 0 for the cue's own movement, from 1 for its overrides in order, then for the movements of single
    /// robots.
    pub(super) movement: usize,
    /// Delay of the robot's start, since the start of the cue.
    pub(super) delay: Span,
}

/// The robots of a cue.
#[derive(Clone, Debug, Default)]
pub(super) struct Members {
    pub(super) all: Vec<Member>,
    /// The largest delay of all robots.
    pub(super) delay: Span,
    /// Duration of the longest movement as written, before the cue is stretched to its planned duration.
    pub(super) length: Span,
}

impl Cue {
    pub(super) fn movement_of(&self, member: &Member) -> &Movement {
        match member.movement.checked_sub(1) {
            None => &self.movement,
            Some(index) => match index.checked_sub(self.overrides.len()) {
                None => &self.overrides[index].1,
                Some(own) => &self.own[own],
            },
        }
    }
}

impl<'a> Cast<'a> {
    pub(super) fn new(fleet: &'a Fleet, roles: &'a HashMap<String, Vec<Name>>) -> Self {
        let index_of =
            fleet.robots.iter().enumerate().map(|(i, robot)| (composed(robot.id.as_str()), i)).collect();
        Self { fleet, roles, index_of, kinds: kinds(fleet), known: OnceLock::new() }
    }

    pub(super) fn kind(&self, robot: usize) -> usize {
        self.kinds[robot]
    }

    pub(super) fn id(&self, robot: usize) -> &'a RobotId {
        &self.fleet.robots[robot].id
    }

    pub(super) fn index(&self, robot: &RobotId) -> Option<usize> {
        self.index_of.get(composed(robot.as_str()).as_ref()).copied()
    }

    pub(super) fn devices(&self, robot: usize) -> &'a [Device] {
        devices_of(&self.fleet.robots[robot])
    }

    pub(super) fn limits(&self, robot: usize, device: &Device, control_type: ControlType) -> RateLimits {
        self.given_limits(robot, device).or_declared(device, control_type)
    }

    /// Returns the device's speed and acceleration limits as given in the fleet file.
    pub(super) fn given_limits(&self, robot: usize, device: &Device) -> RateLimits {
        self.fleet.robots[robot].limits.get(device.id.as_str()).copied().unwrap_or_default()
    }

    /// Formats robots with a verb: `robot `a` has`, or `robots `a`, `b` have`.
    pub(super) fn have(&self, robots: &[usize]) -> String {
        match robots {
            [one] => format!("robot `{}` has", self.id(*one)),
            _ => format!("{} have", self.names(robots)),
        }
    }

    pub(super) fn names(&self, robots: &[usize]) -> String {
        robots_named(robots.iter().map(|index| self.id(*index).as_str()))
    }

    pub(super) fn ids(&self, robots: &[usize]) -> Arc<[RobotId]> {
        robots.iter().map(|robot| self.id(*robot).clone()).collect()
    }

    /// Returns the robot's device with this name.
    pub(super) fn device(&self, robot: usize, name: &str) -> Option<&'a Device> {
        self.devices(robot).iter().find(|device| is_same(device.id.as_str(), name))
    }

    /// Returns the robots that a name of a robot, a group or a role refers to.
    pub(super) fn robots(&self, findings: &mut Reader, name: &Name) -> Vec<usize> {
        match self.roles.get(&name.text) {
            // `check_roles` reports the faults of a role.
            Some(role) => {
                let mut seen = HashSet::new();
                let all = role.iter().filter_map(|name| self.robots_of_fleet(name)).flatten();
                all.filter(|robot| seen.insert(*robot)).collect()
            }
            None => self.robots_of_fleet(name).unwrap_or_else(|| {
                let hint = self.hint(findings, &name.text);
                unknown_robot(findings, name, one_of(self.known().iter().map(String::as_str)), hint);
                Vec::new()
            }),
        }
    }

    /// Returns the robots that a name of a robot or a group refers to; `None` if it is neither.
    fn robots_of_fleet(&self, name: &Name) -> Option<Vec<usize>> {
        if let Some(&index) = self.index_of.get(composed(&name.text).as_ref()) {
            return Some(vec![index]);
        }
        let members = self.fleet.groups.get(&name.text)?;
        Some(members.iter().filter_map(|id| self.index(id)).collect())
    }

    /// Reports unknown and duplicate robots of roles, whether or not a cue uses them.
    pub(super) fn check_roles(&self, findings: &mut Reader) {
        let mut roles: Vec<_> = self.roles.iter().collect();
        roles.sort_unstable_by_key(|(role, _)| role.as_str());
        for (role, members) in roles {
            let mut seen = HashSet::new();
            for name in members {
                match self.robots_of_fleet(name) {
                    None => self.unknown_member(findings, name),
                    Some(robots) => {
                        let twice: Vec<usize> =
                            robots.into_iter().filter(|robot| !seen.insert(*robot)).collect();
                        if !twice.is_empty() {
                            let message =
                                format!("already in the role `{}`: {}", shortened(role), self.names(&twice));
                            let hint = Some(LISTED_TWICE.to_owned());
                            let expected = "each robot at most once per role";
                            findings.add(Code::ListedTwice, name.place.clone(), message, expected, hint);
                        }
                    }
                }
            }
        }
    }

    fn unknown_member(&self, findings: &mut Reader, name: &Name) {
        let ids = || self.fleet.robots.iter().map(|robot| robot.id.as_str());
        let mut known: Vec<&str> = ids().chain(self.fleet.groups.keys().map(String::as_str)).collect();
        known.sort_unstable();
        let of_role = self.roles.get(&name.text).map(|role| {
            let members: Vec<&str> = role.iter().map(|name| name.text.as_str()).collect();
            format!(
                "a role can only contain robots and groups: list the members of `{}` instead, `[{}]`",
                shortened(&name.text),
                members.join(", ")
            )
        });
        let hint = of_role
            .or_else(|| slips::several_names(&name.text, known.iter().copied()))
            .or_else(|| findings.did_you_mean(&name.text, known.iter().copied()));
        unknown_robot(findings, name, one_of(known), hint);
    }

    fn hint(&self, findings: &Reader, name: &str) -> Option<String> {
        let known = || self.known().iter().map(String::as_str);
        let all = ["all", "everyone", "everybody", "any", "*"].contains(&name).then(|| {
            let mut groups = self.fleet.groups.iter();
            let whole = groups.find(|(_, members)| members.len() == self.fleet.robots.len());
            match whole {
                Some((group, _)) => format!("the group `{}` contains all robots", shortened(group)),
                None => "list the robots, or define a group of all robots in the fleet file".to_owned(),
            }
        });
        let ids = self.fleet.robots.iter().map(|robot| robot.id.as_str());
        let listed = || slips::range_of_robots(name, ids);
        all.or_else(|| slips::several_names(name, known()))
            .or_else(listed)
            .or_else(|| findings.did_you_mean(name, known()))
            .or_else(|| slips::as_a_range(name))
    }

    fn known(&self) -> &[String] {
        self.known.get_or_init(|| {
            let (groups, roles) = (self.fleet.groups.keys(), self.roles.keys());
            let mut known: Vec<String> = groups.chain(roles).cloned().collect();
            known.extend(self.fleet.robots.iter().map(|robot| robot.id.to_string()));
            known.sort_unstable();
            known
        })
    }

    /// Returns the robots of a cue without duplicates, each with its movement.
    pub(super) fn members(&self, findings: &mut Reader, cue: &Cue, horizon: Span) -> Members {
        let mut robots: Vec<usize> = Vec::new();
        let mut seen = HashSet::new();
        let before = findings.found.len();
        for name in &cue.robots {
            for robot in self.robots(findings, name) {
                if seen.insert(robot) {
                    robots.push(robot);
                } else {
                    findings.add_shared(SharedFault {
                        code: Code::ListedTwice,
                        cause: format!("{:?}", name.place),
                        size: 0.0,
                        device: String::new(),
                        robots: self.ids(&[robot]),
                        place: name.place.clone(),
                        message: ["already in this cue: ".to_owned(), String::new()],
                        expected: "each robot at most once per cue".to_owned(),
                        hint: Some(LISTED_TWICE.to_owned()),
                    });
                }
            }
        }
        if robots.is_empty() && !cue.robots.is_empty() && findings.found.len() == before {
            let message = format!("the cue `{}` has no robots: its groups are empty", shortened(&cue.name));
            findings.add(Code::NoRobot, cue.robots_place.clone(), message, "at least one robot", None);
        }
        let overridden = self.overridden(findings, cue, &seen);
        let canon = canon(findings, cue, robots.len(), horizon);
        let mut members = Members::default();
        let mut unset = HashSet::new();
        for (index, &robot) in robots.iter().enumerate() {
            let own = cue.own_of.get(index).copied().flatten().map(|own| 1 + cue.overrides.len() + own);
            let movement = own.or_else(|| overridden.get(&robot).copied()).unwrap_or(0);
            let mut member = Member { robot, movement, delay: canon.delay(index) };
            let movement = cue.movement_of(&member);
            if unset.insert(member.movement) {
                movement.unset.iter().for_each(|unset| unset_parameter(findings, unset));
            }
            member.delay += movement.delay;
            members.delay = members.delay.max(member.delay);
            members.length = members.length.max(movement.length);
            members.all.push(member);
        }
        members
    }

    fn overridden(&self, findings: &mut Reader, cue: &Cue, seen: &HashSet<usize>) -> HashMap<usize, usize> {
        let mut overridden = HashMap::new();
        for (index, (name, _)) in cue.overrides.iter().enumerate() {
            for robot in self.robots(findings, name) {
                if !seen.contains(&robot) {
                    findings.add_shared(SharedFault {
                        code: Code::UnknownRobot,
                        cause: format!("{:?}", name.place),
                        size: 0.0,
                        device: String::new(),
                        robots: self.ids(&[robot]),
                        place: name.place.clone(),
                        message: ["not in this cue: ".to_owned(), String::new()],
                        expected: "overrides for the cue's own robots".to_owned(),
                        hint: Some("add them to the `robots` of the cue, or remove the override".to_owned()),
                    });
                }
                if overridden.insert(robot, index + 1).is_some() {
                    let message = format!("duplicate override for robot `{}`", self.id(robot));
                    findings.add(
                        Code::ListedTwice,
                        name.place.clone(),
                        message,
                        "one override per robot",
                        None,
                    );
                }
            }
        }
        overridden
    }
}

fn unknown_robot(findings: &mut Reader, name: &Name, expected: String, hint: Option<String>) {
    let message = format!("no robot or group `{}` in the fleet", shortened(&name.text));
    findings.add(Code::UnknownRobot, name.place.clone(), message, expected, hint);
}

fn unset_parameter(findings: &mut Reader, unset: &Unset) {
    let Unset { place, of_move, parameter } = unset;
    let message = format!("the move `{}` needs a value for `{parameter}`", shortened(of_move));
    let hint = Some(format!("add `parameters: {{{parameter}: ...}}`"));
    findings.add(
        Code::Variable,
        place.clone(),
        message,
        "a value for every parameter without a default",
        hint,
    );
}

/// Returns the delays of the robots. If the last robot would begin after the horizon, reports this and returns no delays.
fn canon<'c>(findings: &mut Reader, cue: &'c Cue, robots: usize, horizon: Span) -> Cow<'c, Canon> {
    let last = match &cue.canon {
        Canon::Even(_) => cue.canon.delay(robots.saturating_sub(1).max(1)),
        Canon::Each { .. } => (0..robots).map(|robot| cue.canon.delay(robot)).max().unwrap_or_default(),
    };
    if last <= horizon {
        return Cow::Borrowed(&cue.canon);
    }
    let message =
        format!("the last of {} starts {last} after the start of the cue", counted(robots, "robot"));
    let (place, hint) = match &cue.canon {
        Canon::Even(_) => {
            let after = i64::try_from(robots).unwrap_or(i64::MAX).saturating_sub(1).max(1);
            (cue.place.of_key("canon"), Some(format!("use a canon of at most {}", horizon / after)))
        }
        Canon::Each { place, .. } => (place.clone(), None),
    };
    findings.add(Code::TooMuch, place, message, format!("at most {horizon}"), hint);
    Cow::Owned(Canon::default())
}

/// Positions in which devices are left, by (robot, device), as far as known; includes devices moved in earlier acts.
pub(super) type Rest = HashMap<(usize, usize), Left>;

/// The position in which a device is left, as far as known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Left {
    /// Position after every regular transition between acts; `None` if it is not always the same.
    usually: Option<f64>,
    /// Position that also holds after a failure, a timeout or a return from a later act; `None` if it is not always the same.
    certainly: Option<f64>,
}

impl Left {
    /// Returns the position if it holds after every transition, including a failure, a timeout or a return from a later act.
    pub(super) const fn certainly(self) -> Option<f64> {
        self.certainly
    }

    /// Creates the position in which the last movement of an act leaves a device.
    pub(super) const fn at(value: Option<f64>) -> Self {
        Self { usually: value, certainly: value }
    }
}

/// Positions of devices at the start of an act, as far as known.
pub(super) struct Positions<'a> {
    fleet: &'a Fleet,
    /// The positions in which each preceding act leaves the devices.
    before: Vec<&'a Rest>,
    first: bool,
    others: OtherWays,
}

/// Which transitions lead into an act, apart from the end of a preceding act.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OtherWays {
    /// Whether the act can follow a failure after which all devices go to their default state.
    home: bool,
    /// Whether the act can follow another failure, a timeout, or a return from a later act, after which positions are unknown.
    elsewhere: bool,
}

impl OtherWays {
    pub(super) fn into(ways: &[Ways], index: usize) -> Self {
        let to = Way::Act(index);
        let back = ways.iter().skip(index).any(|way| way.next == to);
        let late = ways.iter().any(|way| way.on_timeout == to);
        let after_failure =
            ways.iter().map(|way| &way.on_failure).filter(|policy| policy.then == Some(index));
        let (home, stopped): (Vec<_>, Vec<_>) = after_failure.partition(|policy| policy.sends_home());
        Self { home: !home.is_empty(), elsewhere: back || late || !stopped.is_empty() }
    }
}

impl<'a> Positions<'a> {
    pub(super) fn after(
        fleet: &'a Fleet,
        before: &[usize],
        rests: &'a HashMap<usize, Rest>,
        first: bool,
        others: OtherWays,
    ) -> Self {
        Self { fleet, before: before.iter().filter_map(|act| rests.get(act)).collect(), first, others }
    }

    /// Returns the positions after the act. `moved` contains the positions of the devices that the act moved; all others stay where they
    /// are.
    pub(super) fn left_by(&self, mut moved: Rest) -> Rest {
        for &(robot, device) in self.before.iter().flat_map(|rest| rest.keys()) {
            moved.entry((robot, device)).or_insert_with(|| {
                let known = devices_of(&self.fleet.robots[robot]).get(device);
                let is_speed = known.and_then(Device::primary_control_type) == Some(ControlType::Speed);
                let usually = if is_speed { self.of_speed(robot, device) } else { self.of(robot, device) };
                Left { usually, certainly: self.certain(robot, device) }
            });
        }
        moved
    }

    /// Returns the position of a device at the start of the act, if the position is certain. Every transition into the act, including a
    /// failure, a timeout or a return from a later act, must leave the device there.
    pub(super) fn certain(&self, robot: usize, device: usize) -> Option<f64> {
        let default = devices_of(&self.fleet.robots[robot]).get(device)?.default_value;
        let left =
            self.before.iter().map(|rest| rest.get(&(robot, device)).map_or(default, |left| left.certainly));
        let begun = (self.first || self.others.home).then_some(default);
        let mut known = left.chain(begun);
        let place = known.next()?.filter(|_| !self.others.elsewhere)?;
        known.all(|other| other == Some(place)).then_some(place)
    }

    /// Whether this is the first act.
    pub(super) const fn is_first(&self) -> bool {
        self.first
    }

    /// Returns the position of a device at the start of the act, if every regular transition into the act leaves the device there.
    pub(super) fn of(&self, robot: usize, device: usize) -> Option<f64> {
        self.or(robot, device, devices_of(&self.fleet.robots[robot]).get(device)?.default_value)
    }

    /// Like [`Self::of`] for the speed of a device. Unlike a position, a speed without a default value is 0 in the default state.
    pub(super) fn of_speed(&self, robot: usize, device: usize) -> Option<f64> {
        let device_of = devices_of(&self.fleet.robots[robot]).get(device)?;
        let is_first = device_of.primary_control_type() == Some(ControlType::Speed);
        self.or(robot, device, Some(device_of.default_value.filter(|_| is_first).unwrap_or(0.0)))
    }

    fn or(&self, robot: usize, device: usize, default: Option<f64>) -> Option<f64> {
        let left = |rest: &&Rest| rest.get(&(robot, device)).map_or(default, |left| left.usually);
        let mut known = self.before.iter().map(left);
        let begin = if self.first { Some(default) } else { known.next() }?;
        known.all(|other| other == begin).then_some(begin).flatten()
    }
}

/// Returns the acts whose `next` is the act at `index`.
pub(super) fn leading_to(acts: &[Option<Act>], index: usize) -> Vec<usize> {
    let leads = |act: &Option<Act>| act.as_ref().is_some_and(|act| act.next == Way::Act(index));
    acts.iter().enumerate().filter(|(_, act)| leads(act)).map(|(index, _)| index).collect()
}

/// Returns the kind of each robot: robots of the same kind have the same devices and limits.
fn kinds(fleet: &Fleet) -> Vec<usize> {
    let mut count = 0;
    // Compares only robots with the same default values, because each robot in a large fleet may have its own.
    let mut firsts: HashMap<Vec<Option<u64>>, Vec<(&FleetRobot, usize)>> = HashMap::new();
    let kind = |robot| {
        let devices = devices_of(robot);
        let defaults = devices.iter().map(|device| device.default_value.map(f64::to_bits)).collect();
        let known = firsts.entry(defaults).or_default();
        let alike =
            |(other, _): &&(&FleetRobot, usize)| other.limits == robot.limits && devices_of(other) == devices;
        if let Some((_, kind)) = known.iter().rfind(alike) {
            return *kind;
        }
        known.push((robot, count));
        count += 1;
        count - 1
    };
    fleet.robots.iter().map(kind).collect()
}
