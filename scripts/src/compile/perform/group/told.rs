//! Reports the faults of a group movement.

use super::Performer;
use crate::compile::check_formations::{apart, between, crowded, differing};
use crate::compile::conflict::told;
use crate::duration;
use crate::ensemble::{Action, Course, Fault, Form, GROUP_MAX, POINTS_MAX, Sweep, Target, Together};
use crate::finding::{Code, Place, Severity, one_of};
use crate::render::counted;
use crate::scenario::Cue;
use crate::shown::shortened;
use crate::transit::{Blocked, Required};
use urrcp::Span;

use super::Ground;

const COORDINATES: [&str; 3] = ["x", "y", "z"];

/// Kind of a definition in a scenario that group movements refer to by name.
#[derive(Clone, Copy)]
enum Definition {
    Formation,
    Path,
}

impl Definition {
    const fn code_and_name(self) -> (Code, &'static str) {
        match self {
            Self::Formation => (Code::UnknownFormation, "formation"),
            Self::Path => (Code::UnknownPath, "path"),
        }
    }
}

impl Performer<'_, '_> {
    /// Reports robots without a body that the group could move, and robots whose position in space is unknown.
    pub(super) fn tell_excluded(
        &mut self,
        cue: &Cue,
        group: &Together,
        without: &[usize],
        unknown: &[usize],
    ) {
        if !without.is_empty() {
            let message = format!("{} no `body` whose x and y are devices", self.cast.have(without));
            let expected =
                "bodies that are moved by position, as in `body: {x: x, y: y, z: z}` in the fleet file";
            let hint =
                Some("remove them from this cue, or describe their `body` in the fleet file".to_owned());
            self.findings.add(Code::NotInGroup, cue.robots_place.clone(), message, expected, hint);
        }
        // After another error, a movement may be missing, which explains the unknown position.
        let is_other = |code: Code| code != Code::NotInGroup && code.severity() == Severity::Error;
        let errors = self.findings.found.iter().any(|found| is_other(found.code));
        if !unknown.is_empty() && !errors {
            let are = if unknown.len() == 1 { "is" } else { "are" };
            let message = format!(
                "{} {are} at an unknown position when `{}` starts",
                self.cast.names(unknown),
                shortened(&cue.name)
            );
            let axes = COORDINATES.join(", ");
            let expected = format!("an earlier movement of {axes}, or a `default_value` for these devices");
            let hint = "start with a cue that sets them, as in `tracks: {x: [{at: 0s, to: 1}]}`".to_owned();
            self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, Some(hint));
        }
    }

    /// Reports two groups that depend on each other: each of them begins where the other one leaves a robot.
    pub(super) fn tell_entangled(&mut self, cue: &Cue, group: &Together) {
        let name = shortened(&cue.name);
        let message = format!(
            "`{name}` starts before the movement of another group for one robot, but after it for another robot"
        );
        let expected = "group movements in the same order for all robots that they share";
        let hint = Some("start one of them later, or use a shorter `canon`".to_owned());
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, hint);
    }

    /// Reports why a group of these robots cannot make its movement. `fix` describes a change that makes the movement possible, if one
    /// was found.
    pub(super) fn tell(
        &mut self,
        cue: &Cue,
        group: &Together,
        robots: &[usize],
        fault: &Fault,
        ground: Ground<'_>,
        fix: Option<String>,
    ) {
        let here = group.place.clone();
        match fault {
            Fault::ToldElsewhere => {}
            Fault::TooMany => {
                let message = format!("a group of {}", counted(robots.len(), "robot"));
                let hint = Some("split the robots into several groups, with a cue for each".to_owned());
                self.findings.add(Code::TooMuch, here, message, format!("at most {GROUP_MAX} robots"), hint);
            }
            Fault::Flat { dancer, why } => {
                let message =
                    format!("{why}, but `{}` cannot change its height", self.cast.id(robots[*dancer]));
                let expected = "the same height for all robots, or bodies whose z is a device";
                self.findings.add(Code::NotInGroup, here, message, expected, None);
            }
            Fault::Homeless(homeless) => {
                let homeless: Vec<usize> = homeless.iter().map(|dancer| robots[*dancer]).collect();
                let message =
                    format!("{} no `default_value` for at least one coordinate", self.cast.have(&homeless));
                let expected = "devices with a `default_value`, which defines `home`";
                let hint =
                    Some("add a `default_value` to each of these devices in the initialization block, or use a formation instead of `home`".to_owned());
                self.findings.add(Code::NotInGroup, here, message, expected, hint);
            }
            Fault::Unmoved => {
                let message = "all robots of this cue are at the centre of the group, so none of them moves";
                let expected =
                    "robots at different places, or another centre, as in `turn: {by: 90, about: [0, 0]}`";
                self.findings.add(Code::NotInGroup, here, message, expected, None);
            }
            Fault::TooShort { dancer, seconds } => self.tell_too_short(group, robots[*dancer], *seconds, fix),
            Fault::Blocked(blocked) => self.tell_blocked(cue, group, robots, blocked, fix),
            Fault::UnknownFormation | Fault::Count { .. } | Fault::Crowded { .. } => {
                if let Some(name) = group.formation() {
                    self.tell_of_formation(group, name, robots.len(), fault, ground, fix);
                }
            }
            _ => {
                if let Action::Sweep(Sweep { along: Some(course), .. }) = &group.action {
                    self.tell_of_path(group, course, robots, fault, ground);
                }
            }
        }
    }

    /// Reports faults in the places of a formation.
    fn tell_of_formation(
        &mut self,
        group: &Together,
        name: &str,
        robots: usize,
        fault: &Fault,
        ground: Ground<'_>,
        fix: Option<String>,
    ) {
        let here = group.place.clone();
        match fault {
            Fault::UnknownFormation => {
                let named = ground.of_scenario.formations.keys().map(String::as_str);
                let elsewhere = ground
                    .of_scenario
                    .paths
                    .contains_key(name)
                    .then(|| format!("`{0}` is a path: write `along: {0}`", shortened(name)));
                self.tell_unknown(Definition::Formation, name, named.collect(), here, elsewhere);
            }
            Fault::Count { places } => {
                let (robots_are, places_are) = (counted(robots, "robot"), counted(*places, "place"));
                let name = shortened(name);
                let message = format!("{robots_are} for the {places_are} of `{name}`");
                let (choice, hint) = if robots > *places {
                    let hint = format!(
                        "use `form: {{to: {name}, spare: stay}}` so that spare robots stay where they are, or `spare: home` to send them home"
                    );
                    ("a `spare` for the others", hint)
                } else {
                    let hint = format!(
                        "use `form: {{to: {name}, thin: evenly}}` to leave places free at regular intervals, or `thin: nearest` to leave distant places free"
                    );
                    ("`thin` to choose the places", hint)
                };
                let expected = format!("{}, or {choice}", counted(*places, "robot"));
                self.findings.add(Code::PlacesCount, here, message, expected, Some(hint));
            }
            Fault::Crowded { places, distance, required } => {
                let [a, b] = places.map(|place| place + 1);
                let message =
                    format!("places {a} and {b} of `{}` {}", shortened(name), apart(*distance, *required));
                let expected = between(*distance, *required);
                let hint = fix.unwrap_or_else(|| "make the formation larger, or use fewer robots".to_owned());
                self.findings.add_once(crowded(name), Code::NoWayPast, here, message, expected, Some(hint));
            }
            _ => {}
        }
    }

    /// Reports faults of a path, or faults of the robots that move along it.
    fn tell_of_path(
        &mut self,
        group: &Together,
        course: &Course,
        robots: &[usize],
        fault: &Fault,
        ground: Ground<'_>,
    ) {
        let (name, there) = (shortened(&course.path), course.place.clone());
        let id = |dancer: &usize| self.cast.id(robots[*dancer]);
        match fault {
            Fault::UnknownPath => {
                let named = ground.of_scenario.paths.keys().map(String::as_str).collect();
                let elsewhere = ground
                    .of_scenario
                    .formations
                    .contains_key(&course.path)
                    .then(|| format!("`{name}` is a formation: write `form: {name}`"));
                self.tell_unknown(Definition::Path, &course.path, named, there, elsewhere);
            }
            Fault::OpenLaps(laps) => {
                let message = format!("{laps} laps of `{name}`, which does not end where it starts");
                let hint = Some("add `closed: true` to the path".to_owned());
                self.findings.add(Code::WrongType, there, message, "a closed path for laps", hint);
            }
            Fault::NoHeading => {
                let message = format!("`{name}` has no heading where it leads straight up or down");
                let expected = "a path without vertical parts, or no `turning`";
                self.findings.add(Code::WrongType, there, message, expected, None);
            }
            Fault::TooManyPoints(count) => {
                let points = counted(*count, "point");
                let message = format!(
                    "`{name}` has {points} in all laps, including the places of the robots that follow"
                );
                let hint = Some("use several consecutive cues with fewer laps each".to_owned());
                self.findings.add(
                    Code::TooMuch,
                    there,
                    message,
                    format!("at most {POINTS_MAX} points"),
                    hint,
                );
            }
            Fault::SamePlace { behind, ahead } => {
                let message =
                    format!("`{}` is at the same place as `{}`, which it follows", id(behind), id(ahead));
                self.tell_no_row(group, message);
            }
            Fault::TurnsBack { dancer } => {
                let message =
                    format!("the path that the robots follow bends too sharply at `{}`", id(dancer));
                self.tell_no_row(group, message);
            }
            _ => {}
        }
    }

    fn tell_no_row(&mut self, group: &Together, message: String) {
        let expected =
            "robots in a row, each behind the previous one in the list, with the path ahead of the first";
        let hint = Some("list the robots in another order, or `form` a line first".to_owned());
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, hint);
    }

    /// Reports an unknown name. `elsewhere` describes an object of another kind that has this name, if there is one.
    fn tell_unknown(
        &mut self,
        definition: Definition,
        name: &str,
        mut known: Vec<&str>,
        place: Place,
        elsewhere: Option<String>,
    ) {
        let (code, what) = definition.code_and_name();
        if self.findings.is_wrong(&format!("{what}s")) {
            return;
        }
        known.sort_unstable();
        let home = (what == "formation").then_some("home");
        let hint = if known.is_empty() && home != Some(name) {
            let written = match what {
                "path" => "{points: [[0, 0, 1], [2, 0, 1]]}",
                _ => "{circle: {radius: 2}}",
            };
            Some(format!("define it, as in `{what}s: {{{}: {written}}}`", shortened(name)))
        } else {
            self.findings.did_you_mean(name, known.iter().copied().chain(home))
        };
        let hint = elsewhere.or(hint);
        let expected = match (known.is_empty(), home) {
            (true, None) => format!("a {what} that is defined under `{what}s`"),
            (true, Some(home)) => format!("`{home}`, or a {what} that is defined under `{what}s`"),
            (false, _) => one_of(known.into_iter().chain(home)),
        };
        self.findings.add(code, place, format!("no {what} `{}`", shortened(name)), expected, hint);
    }

    fn tell_too_short(&mut self, group: &Together, robot: usize, seconds: f64, fix: Option<String>) {
        let needed = Span::from_millis_f64((seconds * 100.0 - 1e-6).ceil() * 10.0);
        let needed = duration::written(needed);
        let message = format!(
            "`{}` needs {needed} for its path, but has only {}",
            self.cast.id(robot),
            told(group.over)
        );
        let expected = format!("`over: {needed}` or more");
        self.findings.add(Code::BodyTooFast, group.over_place.clone(), message, expected, fix);
    }

    fn tell_blocked(
        &mut self,
        cue: &Cue,
        group: &Together,
        robots: &[usize],
        blocked: &Blocked,
        fix: Option<String>,
    ) {
        let [a, b] = blocked.pair.map(|index| self.cast.id(robots[index]));
        let at = Span::from_millis_f64((blocked.at * 1_000.0).round());
        let more = match blocked.pairs {
            1 => String::new(),
            2 => "; 1 more pair comes too close".to_owned(),
            pairs => format!("; {} more pairs come too close", pairs - 1),
        };
        let (Required::Apart(limit) | Required::AsAtEnds(limit) | Required::AtEnd { least: limit, .. }) =
            blocked.required;
        let [found, wanted] = differing(blocked.distance, limit);
        let message = format!(
            "`{a}` and `{b}` come within {found} m of each other {} after `{}` starts, measured between centres{more}",
            told(at),
            shortened(&cue.name)
        );
        let is_home = matches!(&group.action, Action::Form(Form { to: Target::Home, .. }));
        let tried = "delays and arcs did not help";
        let expected = match blocked.required {
            Required::Apart(_) => {
                format!("at least {wanted} m, including the position error of the steps; {tried}")
            }
            Required::AsAtEnds(_) => {
                format!("at least {wanted} m, their distance at the start or end; {tried}")
            }
            Required::AtEnd { end, least } => {
                let [end, least] = differing(end, least);
                format!("at least {least} m; they end {end} m apart")
            }
        };
        let hint = match (blocked.required, is_home) {
            (Required::AtEnd { .. }, true) => "move the homes of these two robots further apart",
            (Required::AtEnd { .. }, false) => {
                "make the formation larger: these two robots need more room at their end positions"
            }
            (_, true) => "allow more time, start them one after another with `canon`, or form a row first",
            (_, false) => "allow more time, make the formation larger, or use another formation on the way",
        };
        let hint = fix.unwrap_or_else(|| hint.to_owned());
        self.findings.add(Code::NoWayPast, group.place.clone(), message, expected, Some(hint));
    }
}
