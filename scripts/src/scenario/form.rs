//! The keys for joint movements of bodies: `form`, `turn`, `grow`, `shift`, `along` and `over`.

use super::cue::CueKeys;
use super::formations::SHAPES;
use super::kinds;
use super::track::positive_time;
use crate::ensemble::{Action, Course, Form, Spare, Sweep, Target, Thin, Together};
use crate::fields::{At, Reader, is_spread};
use crate::finding::Code;
use crate::node::Node;
use crate::shown::shortened;
use crate::transit::Least;
use downbeat_reader::keys::{Item, Kind, Naming};
use downbeat_reader::{keys, words};

/// Maximum turn in degrees: a larger one would take more steps than any device holds.
const DEGREES_MAX: f64 = 360_000.0;
/// Maximum factor of `grow`.
const GROW_MAX: f64 = 1_000.0;
/// Maximum number of laps along a path.
const LAPS_MAX: u32 = 100;
/// Maximum shift along an axis, in metres.
const METRES_MAX: f64 = 1e6;

const LEAST: [(&str, Least); 2] = [("total", Least::Total), ("longest", Least::Longest)];
const SPARE: [(&str, Spare); 2] = [("stay", Spare::Stay), ("home", Spare::Home)];
const THIN: [(&str, Thin); 2] = [("evenly", Thin::Evenly), ("nearest", Thin::Nearest)];
/// Keys of a cue for the movement of its robots as a group, and for the duration of that movement.
const GROUP: [&str; 6] = ["form", "turn", "grow", "shift", "along", "over"];

keys! {
    /// The formation, and how to move into it.
    pub(super) struct FormKeys {
        /// A formation, or `home`: the default values of each robot's devices.
        #[required]
        to: Kind::Name(Naming::Uses(Item::Formation), &kinds::NAME),
        /// The quantity to minimize: the sum of the distances, or the longest of them.
        #[default("`total`")]
        least: words!(LEAST),
        /// What robots without a place do.
        spare: words!(SPARE),
        /// Which places are taken if there are fewer robots: those at even steps, or those with the shortest distances.
        thin: words!(THIN),
    }
}

keys! {
    /// A turn about the vertical.
    pub(super) struct TurnKeys {
        /// Angle, in degrees from x to y.
        #[required]
        by: kinds::NUMBER,
        /// x and y of the centre in metres.
        #[default("the mean of the robots' places")]
        about: Kind::List(&kinds::NUMBER, 2..=2),
    }
}

keys! {
    /// The path, and how to move along it.
    pub(super) struct AlongKeys {
        /// The path.
        #[required]
        path: Kind::Name(Naming::Uses(Item::Path), &kinds::NAME),
        /// Number of laps, for a closed path: a whole number.
        #[default("1")]
        laps: kinds::NUMBER,
        /// Whether the group turns with the heading of the path, about its middle.
        turning: kinds::TRUTH,
        /// Whether each robot follows the previous one in the list, through its place; the first one moves along the path.
        follow: kinds::TRUTH,
    }
}

/// Reads the group movement of a cue, if it has one.
pub(super) fn read(reader: &mut Reader, cue: &At<'_>, keys: &CueKeys<'_>) -> Option<Together> {
    let sweeps = [keys.turn, keys.grow, keys.shift, keys.along];
    let first = keys.form.or_else(|| sweeps.into_iter().flatten().next());
    let Some(first) = first else {
        let over = keys.over.filter(|_| !GROUP.iter().any(|key| reader.is_miswritten(cue, key)))?;
        let expected = "one of `form`, `turn`, `grow`, `shift`, `along` in this cue";
        let hint = Some("use `duration` for a cue with tracks".to_owned());
        reader.add(
            Code::MissingKey,
            over.key_place(),
            "`over` has no effect without a movement of the group",
            expected,
            hint,
        );
        return None;
    };
    if let Some(at) = keys.duration {
        let (message, hint) = match keys.over {
            Some(_) => ("`duration` and `over` cannot be combined", "remove `duration`"),
            None => ("`duration` is not supported for the movement of a group", "write `over` instead"),
        };
        let expected = "only `over`, which sets the duration of the cue";
        reader.add(Code::UnknownKey, at.key_place(), message, expected, Some(hint.to_owned()));
    }
    // Keys that change a movement do not apply to groups.
    let shaping = [keys.scale, keys.mirror, keys.reverse, keys.repeat, keys.devices, keys.overrides];
    for at in shaping.into_iter().flatten() {
        let message = "this key is not supported for the movement of a group";
        let hint = Some("write a cue for each repetition, and a separate cue for tracks".to_owned());
        reader.add(
            Code::UnknownKey,
            at.key_place(),
            message,
            "only `form`, `turn`, `grow`, `shift` or `along`",
            hint,
        );
    }
    if keys.over.is_none() && keys.duration.is_none() && !reader.is_miswritten(cue, "over") {
        let hint = Some("add the duration, as in `over: 6s`".to_owned());
        let named = GROUP.into_iter().zip([keys.form, keys.turn, keys.grow, keys.shift, keys.along]);
        let named = named.filter(|(_, value)| value.is_some()).map(|(name, _)| name).next();
        let message = format!("missing `over` for `{}`", named.unwrap_or("form"));
        reader.add(Code::MissingKey, first.key_place(), message, "a key `over`", hint);
    }
    let length = keys.over.and_then(|at| positive_time(reader, &at));
    let action = match keys.form {
        Some(form) => {
            for other in sweeps.iter().flatten() {
                let hint = Some("put the other movement into a separate cue".to_owned());
                let message = "`form` cannot be combined with another movement of the group";
                reader.add(
                    Code::UnknownKey,
                    other.key_place(),
                    message,
                    "either `form` or the other movement",
                    hint,
                );
            }
            read_form(reader, &form).map(Action::Form)
        }
        None => read_sweep(reader, keys).map(Action::Sweep),
    };
    let (length, over_place) = (length?, keys.over?.place());
    let over = reader.music.start.lay(length);
    Some(Together { action: action?, over, over_place, place: first.place() })
}

fn read_form(reader: &mut Reader, at: &At<'_>) -> Option<Form> {
    const EXPECTED: &str = "the name of a formation, or `home`";
    let target = |reader: &mut Reader, at: &At<'_>| {
        let name = reader.name(at, EXPECTED)?;
        Some(if name == "home" { Target::Home } else { Target::Formation(name) })
    };
    let Node::Map(_) = at.node else {
        return Some(Form { to: target(reader, at)?, least: Least::Total, spare: None, thin: None });
    };
    if let Some(shape) = shape_within(at.node) {
        let message = format!("found the shape `{shape}`");
        let hint = format!(
            "define it under `formations`, as in `formations: {{ring: {{{shape}: ...}}}}`, and write `form: ring`"
        );
        reader.add(Code::WrongType, at.place(), message, EXPECTED, Some(hint));
        return None;
    }
    let FormKeys { to, least, spare, thin } = reader.keys(at, "`form`")?;
    let target = target(reader, &to?)?;
    if matches!(target, Target::Home) {
        for choice in [least, spare, thin].into_iter().flatten() {
            let message = "places cannot be chosen for `home`: each robot has its own";
            reader.add(Code::UnknownKey, choice.key_place(), message, "`form: home`", None);
        }
    }
    let least = least.and_then(|at| reader.word(&at, &LEAST)).unwrap_or_default();
    let spare = spare.and_then(|at| reader.word(&at, &SPARE));
    let thin = thin.and_then(|at| reader.word(&at, &THIN));
    Some(Form { to: target, least, spare, thin })
}

/// Returns the key of a shape (such as `circle`) that is written where the name of a formation is expected.
fn shape_within(node: &Node) -> Option<&'static str> {
    let Node::Map(entries) = node else { return None };
    SHAPES.into_iter().find(|shape| entries.iter().any(|(key, _)| key == shape))
}

fn read_sweep(reader: &mut Reader, keys: &CueKeys<'_>) -> Option<Sweep> {
    let (turn, about) = match keys.turn {
        Some(at) if matches!(at.node, Node::Map(_)) && !is_spread(at.node) => {
            let TurnKeys { by, about } = reader.keys(&at, "`turn`")?;
            let about = match about {
                Some(at) => {
                    Some(numbers::<2>(reader, &at, "x and y in metres, such as [1, 0.5]", METRES_MAX)?)
                }
                None => None,
            };
            (degrees(reader, &by?)?, about)
        }
        Some(at) => (degrees(reader, &at)?, None),
        None => (0.0, None),
    };
    let grow = match keys.grow {
        Some(at) => {
            let expected = "a factor above 0, up to 1000";
            bounded(reader, &at, expected, GROW_MAX).filter(|factor| {
                let sound = *factor > 0.0;
                if !sound {
                    reader.add(Code::WrongType, at.place(), format!("a factor of {factor}"), expected, None);
                }
                sound
            })?
        }
        None => 1.0,
    };
    let shift = match keys.shift {
        Some(at) => numbers::<3>(reader, &at, "metres along x, y and z, such as [0, 0, 1.5]", METRES_MAX)?,
        None => [0.0; 3],
    };
    let along = match keys.along {
        Some(at) => Some(read_along(reader, &at)?),
        None => None,
    };
    let others = [keys.turn, keys.grow, keys.shift].into_iter().flatten();
    if along.as_ref().is_some_and(|along| along.follow) {
        for other in others {
            let message = "`follow` cannot be combined with `turn`, `grow` or `shift`";
            let hint = Some("put the other movement into a separate cue".to_owned());
            reader.add(Code::UnknownKey, other.key_place(), message, "`along` alone", hint);
        }
    }
    Some(Sweep { turns: turn / 360.0, about, grow, shift, along })
}

fn read_along(reader: &mut Reader, at: &At<'_>) -> Option<Course> {
    const EXPECTED: &str = "the name of a path";
    let Node::Map(_) = at.node else {
        let path = reader.name(at, EXPECTED)?;
        return Some(Course { path, laps: None, turning: false, follow: false, place: at.place() });
    };
    let AlongKeys { path, laps, turning, follow } = reader.keys(at, "`along`")?;
    let laps = match laps {
        Some(at) => Some(reader.count(&at, 1, LAPS_MAX)?),
        None => None,
    };
    let is_set = |reader: &mut Reader, at: Option<At<'_>>| at.map_or(Some(false), |at| reader.truth(&at));
    let (is_turning, follows) = (is_set(reader, turning)?, is_set(reader, follow)?);
    if let (true, true, Some(at)) = (is_turning, follows, turning) {
        let message =
            "`follow` and `turning` cannot be combined: robots that follow each other have no common centre";
        reader.add(Code::UnknownKey, at.key_place(), message, "either `follow` or `turning`", None);
    }
    let path = path?;
    let name = reader.name(&path, EXPECTED)?;
    Some(Course { path: name, laps, turning: is_turning, follow: follows, place: path.place() })
}

fn degrees(reader: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "degrees without a unit, as in `turn: 90`, up to 1000 turns";
    if let Node::Text(word) = at.node
        && let Some(degrees) = turn_of(word)
    {
        let hint =
            Some(format!("write `turn: {degrees}`: positive numbers turn to the left, seen from above"));
        reader.add(Code::WrongType, at.place(), format!("found the text `{word}`"), expected, hint);
        return None;
    }
    let value = reader.degrees(at, expected)?;
    in_bounds(reader, at, value, expected, DEGREES_MAX)
}

/// Returns the angle in degrees of a quarter turn that is written as a word.
fn turn_of(word: &str) -> Option<i16> {
    match word {
        "left" | "counterclockwise" => Some(90),
        "right" | "clockwise" => Some(-90),
        _ => None,
    }
}

fn bounded(reader: &mut Reader, at: &At<'_>, expected: &str, most: f64) -> Option<f64> {
    let value = reader.number(at, expected)?;
    in_bounds(reader, at, value, expected, most)
}

fn in_bounds(reader: &mut Reader, at: &At<'_>, value: f64, expected: &str, most: f64) -> Option<f64> {
    if value.abs() <= most {
        return Some(value);
    }
    let found = shortened(&value.to_string());
    reader.add(Code::WrongType, at.place(), format!("found {found}"), expected, None);
    None
}

fn numbers<const N: usize>(reader: &mut Reader, at: &At<'_>, expected: &str, most: f64) -> Option<[f64; N]> {
    let items = reader.list(at, expected);
    if items.len() != N {
        if matches!(at.node, Node::List(_)) {
            reader.add(Code::WrongType, at.place(), format!("found {} numbers", items.len()), expected, None);
        }
        return None;
    }
    // One finding is enough: all three numbers are likely to have the same fault.
    let read: Option<Vec<f64>> = items.iter().map(|at| bounded(reader, at, expected, most)).collect();
    read?.try_into().ok()
}
