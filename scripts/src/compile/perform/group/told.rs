//! What is wrong with a group, in words.

use super::{COORDINATES, Dancer, Performer};
use crate::compile::check_formations::{SAME, apart};
use crate::compile::conflict::told;
use crate::duration;
use crate::finding::{Code, Severity};
use crate::formation::{Point, nearest_pair};
use crate::node::shortened;
use crate::render::counted;
use crate::scenario::{Cue, Form, Target, Together};
use crate::space::Shape;
use crate::transit::{Blocked, Refused};
use urrcp::Span;

/// Metres by which two places may seem nearer than they are.
const ROUNDING: f64 = 1e-9;

impl Performer<'_, '_> {
    /// Robots that have no place in space, or none that is known.
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
                "bodies that are moved by position, as in `body: {x: x, y: y, z: z}` of the fleet file";
            self.findings.add(Code::NotInGroup, cue.robots_place.clone(), message, expected, None);
        }
        // Where something is wrong already, a movement may be missing.
        let is_other = |code: Code| code != Code::NotInGroup && code.severity() == Severity::Error;
        let errors = self.findings.found.iter().any(|found| is_other(found.code));
        if !unknown.is_empty() && !errors {
            let are = if unknown.len() == 1 { "is" } else { "are" };
            let message = format!(
                "nothing says where {} {are} when `{}` begins",
                self.cast.names(unknown),
                shortened(&cue.name)
            );
            let axes = COORDINATES.join(", ");
            let expected = format!("a movement of {axes} before that, or a `default_value` of these devices");
            let hint = "begin with a cue that sets them, as in `tracks: {x: [{at: 0s, to: 1}]}`".to_owned();
            self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, Some(hint));
        }
    }

    pub(super) fn tell_homeless(&mut self, group: &Together, robots: &[usize]) {
        let message = format!("{} no `default_value` for each of its coordinates", self.cast.have(robots));
        let expected = "devices with a `default_value`: that is where home is";
        let hint = Some("add `default_value` in the initialization block, or name a formation".to_owned());
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, hint);
    }

    pub(super) fn tell_flat(&mut self, group: &Together, what: &str, robot: usize) {
        let message = format!("{what}, and `{}` cannot change its own", self.cast.id(robot));
        let expected = "one height for all, or bodies whose z is a device";
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, None);
    }

    pub(super) fn tell_unmoved(&mut self, group: &Together) {
        let message = "all robots of this cue stand in the middle of the group, so nothing moves".to_owned();
        let expected = "robots at several places, or another middle, as in `turn: {by: 90, about: [0, 0]}`";
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, None);
    }

    pub(super) fn tell_count(&mut self, group: &Together, name: &str, robots: usize, places: usize) {
        let (robots_are, places_are) = (counted(robots, "robot"), counted(places, "place"));
        let name = shortened(name);
        let message = format!("{robots_are} for the {places_are} of `{name}`");
        let hint = match robots > places {
            true => format!(
                "`form: {{to: {name}, spare: stay}}` lets those without a place stay where they are, `spare: home` sends them home"
            ),
            false => format!(
                "`form: {{to: {name}, thin: evenly}}` leaves places free at even steps, `thin: nearest` those that are far"
            ),
        };
        let expected = format!("{}, or a choice", counted(places, "robot"));
        self.findings.add(Code::PlacesCount, group.place.clone(), message, expected, Some(hint));
    }

    /// Whether two of the places are too near for any two of these bodies, which is told.
    pub(super) fn tell_crowded(
        &mut self,
        group: &Together,
        name: &str,
        dancers: &[Dancer<'_>],
        places: &[Point],
    ) -> bool {
        // Of more places than robots only some are taken.
        let Some(pair) = nearest_pair(places).filter(|_| places.len() <= dancers.len()) else { return false };
        let space = &self.cast.fleet.space;
        let mut radii: Vec<f64> = dancers.iter().map(inner_radius).collect();
        radii.sort_unstable_by(f64::total_cmp);
        let required = space.distance.unwrap_or(0.0) + radii.iter().take(2).sum::<f64>();
        if pair.distance >= required.max(SAME) - ROUNDING {
            return false;
        }
        let [a, b] = pair.places.map(|place| place + 1);
        let message = format!("places {a} and {b} of `{}` {}", shortened(name), apart(pair.distance));
        let expected = format!(
            "at least {required:.3} m from middle to middle: `distance` of the fleet's `space`, and the radii of two bodies"
        );
        let hint = Some("make the formation larger, or let fewer robots take part".to_owned());
        self.findings.add(Code::NoWayPast, group.place.clone(), message, expected, hint);
        true
    }

    pub(super) fn tell_refused(
        &mut self,
        cue: &Cue,
        group: &Together,
        form: &Form,
        dancers: &[Dancer<'_>],
        refused: &Refused,
    ) {
        match refused {
            Refused::TooShort { body, seconds } => {
                self.tell_too_short(group, dancers[*body].member.robot, *seconds, Code::BodyTooFast);
            }
            Refused::Blocked(blocked) => self.tell_blocked(cue, group, form, dancers, blocked),
        }
    }

    pub(super) fn tell_too_short(&mut self, group: &Together, robot: usize, seconds: f64, code: Code) {
        let needed = Span::from_millis_f64((seconds * 100.0 - 1e-6).ceil() * 10.0);
        let needed = duration::written(needed);
        let message =
            format!("`{}` needs {needed} for its way, and has {}", self.cast.id(robot), told(group.over));
        let expected = format!("`over: {needed}` or more");
        self.findings.add(code, group.over_place.clone(), message, expected, None);
    }

    fn tell_blocked(
        &mut self,
        cue: &Cue,
        group: &Together,
        form: &Form,
        dancers: &[Dancer<'_>],
        blocked: &Blocked,
    ) {
        let [a, b] = blocked.pair.map(|index| self.cast.id(dancers[index].member.robot));
        let at = Span::from_millis_f64((blocked.at * 1_000.0).round());
        let more = match blocked.pairs {
            1 => String::new(),
            pairs => format!("; {} more come too close", counted(pairs - 1, "pair")),
        };
        let message = format!(
            "`{a}` and `{b}` come within {:.3} m of each other {} after `{}` begins, from middle to middle{more}",
            blocked.distance,
            told(at),
            shortened(&cue.name)
        );
        let expected = format!(
            "at least {:.3} m, with what steps may be off; delays and arcs were tried",
            blocked.required
        );
        let hint = match form.to {
            Target::Home => {
                "give it more time, let them begin one after another with `canon`, or form a row first"
            }
            Target::Formation(_) => {
                "give it more time, make the formation larger, or form another one on the way"
            }
        };
        self.findings.add(Code::NoWayPast, group.place.clone(), message, expected, Some(hint.to_owned()));
    }
}

/// Half of what a body is wide at least, in metres: whatever way it is turned, no other one comes nearer to its middle.
fn inner_radius(dancer: &Dancer<'_>) -> f64 {
    match dancer.body.shape {
        Shape::Ball { radius } => radius,
        Shape::Box { size } => size.into_iter().fold(f64::INFINITY, f64::min) / 2.0,
    }
}
