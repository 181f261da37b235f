//! A track: the movement of one device, in any of the forms in which it can be written.

use urrcp::{ControlType, Span};

use super::data::SamplesKeys;
use super::given::{Givens, given};
use super::kinds;
use super::library::Library;
use super::{Items, Motion, Track, Vector, Vectors, data, formulas, nothing};
use crate::duration::parse_duration;
use crate::exact::{Exact, fraction, to_f64};
use crate::fields::{At, Reader};
use crate::finding::{Code, PathStep};
use crate::motion::{Between, Curve, Easing, Function, Knot, Shape, spline};
use crate::node::{self, Node, Rows, Width};
use crate::shown::shortened;
use crate::slips::{self, OtherForm, as_keyframes};
use downbeat_reader::keys::{Keys, Kind};
use downbeat_reader::{keys, schema, words};

keys! {
    /// The movement of a device, in one of seven forms.
    pub(super) struct TrackKeys {
        /// Control type: position, speed, acceleration or custom_N. Default: the first one of the device.
        control: schema!({"type": "string", "pattern": "^(position|speed|acceleration|custom_\\d+)$"}),
        /// Largest permitted error, in the device's unit; permits omitting keyframes.
        tolerance: kinds::NUMBER,
        /// The maximum number of steps, placed with the smallest error.
        max_steps: Kind::AnyOf(&[&schema!({"type": "integer", "minimum": 2}), &kinds::EXPRESSION]),
        /// Values at times.
        keyframes: Kind::List(&KeyframeKeys::KIND, 0..=usize::MAX),
        /// A smooth curve through points, at rest at both ends.
        spline: Kind::List(&PointKeys::KIND, 2..=usize::MAX),
        /// Pieces, one after another.
        polynomial: Kind::AnyOf(&[&PieceKeys::KIND, &Kind::List(&PieceKeys::KIND, 0..=usize::MAX)]),
        /// center + amplitude sin(2 pi (t / period + phase / 360))
        wave: WaveKeys::KIND,
        /// from + speed t + acceleration t^2 / 2
        travel: TravelKeys::KIND,
        /// One column of a CSV file.
        samples: SamplesKeys::KIND,
        /// An expression of the time `t` since the track began: `$r * cos(2 * pi * t / 8s)`.
        formula: kinds::NAME,
        /// Duration of the formula.
        r#for: kinds::TIME,
    }
}

keys! {
    /// A value at a time, and the transition to it.
    pub(super) struct KeyframeKeys as "keyframe" {
        /// When, from the cue's start.
        #[required]
        at: kinds::TIME,
        /// The value, in the device's unit; a list of values for custom_N.
        #[required]
        to: Kind::AnyOf(&[&kinds::NUMBER, &Kind::List(&kinds::NUMBER, 0..=usize::MAX)]),
        /// The transition from the previous keyframe: linear; smooth, minimum jerk 10s^3-15s^4+6s^5; cubic 3s^2-2s^3; step, the old value
        /// until the keyframe's time.
        ease: words!(Easing::WORDS),
    }
}

keys! {
    /// Several values at a time.
    pub(super) struct VectorKeys {
        /// When, from the cue's start.
        #[required]
        at: kinds::TIME,
        /// The values, in the device's unit.
        #[required]
        to: Kind::List(&kinds::NUMBER, 1..=usize::MAX),
    }
}

keys! {
    /// A point on a curve.
    pub(super) struct PointKeys as "point" {
        /// When, from the cue's start.
        #[required]
        at: kinds::TIME,
        /// The value.
        #[required]
        to: kinds::NUMBER,
    }
}

keys! {
    /// A polynomial for some time.
    pub(super) struct PieceKeys as "piece" {
        /// Duration.
        #[required]
        r#for: kinds::TIME,
        /// c0, c1, c2 ... of c0 + c1 t + c2 t^2, t in seconds from the piece's start.
        #[required]
        coefficients: Kind::List(&kinds::NUMBER, 1..=64),
    }
}

keys! {
    /// center + amplitude sin(2 pi (t / period + phase / 360))
    pub(super) struct WaveKeys {
        /// Half of the peak-to-peak distance, in the device's unit.
        #[required]
        amplitude: kinds::NUMBER,
        /// Hertz.
        frequency: kinds::NUMBER,
        /// Of one cycle.
        period: kinds::TIME,
        /// Degrees.
        phase: kinds::NUMBER,
        /// The value about which it swings.
        center: kinds::NUMBER,
        /// Duration.
        #[required]
        r#for: kinds::TIME,
    }
}

keys! {
    /// from + speed t + acceleration t^2 / 2
    pub(super) struct TravelKeys {
        /// Start value.
        #[required]
        from: kinds::NUMBER,
        /// Units per second.
        speed: kinds::NUMBER,
        /// Units per second squared.
        acceleration: kinds::NUMBER,
        /// Duration.
        #[required]
        r#for: kinds::TIME,
    }
}

/// Number of cycles between two knots of a wave.
const WAVE_CYCLES: f64 = 8.0;
/// The item index of a knot that does not correspond to an item in the file.
const NO_ITEM: u32 = u32::MAX;

pub(super) fn read_tracks(reader: &mut Reader, library: &Library<'_>, at: &At<'_>) -> Vec<Track> {
    let entries = reader.entries(at, "a map from each device to its keyframes");
    if matches!(at.node, Node::Map(written) if written.is_empty()) {
        nothing(reader, at, "`tracks` is empty", "at least one track");
    }
    entries.iter().filter_map(|(device, at)| track(reader, library, device, at)).collect()
}

/// A movement as written, with its exact length before it is rounded to nanoseconds.
pub(super) struct Written {
    motion: Motion,
    length: Exact,
    given: Givens,
}

impl Written {
    pub(super) fn new(curve: Curve, length: Exact) -> Self {
        Self { motion: Motion::Curve(curve), length, given: Vec::new() }
    }

    fn of(curve: Curve) -> Self {
        let length = curve.length().into();
        Self::new(curve, length)
    }

    fn with(self, given: Givens) -> Self {
        Self { given, ..self }
    }
}

fn track(reader: &mut Reader, library: &Library<'_>, device: &str, at: &At<'_>) -> Option<Track> {
    let new = |Written { motion, length, given }, list: &At<'_>| Track {
        device: device.to_owned(),
        control: None,
        motion,
        length,
        tolerance: None,
        steps_max: None,
        begin: Exact::ZERO,
        starts: Span::ZERO,
        pieces: Vec::new(),
        turns: 1,
        items: Items::Keyframes,
        place: at.key_place(),
        list: list.place(),
        given,
        changed: None,
    };
    if is_of_devices(reader, at) {
        let message = format!("`{}` contains devices instead of a movement", shortened(device));
        let hint = Some("list the robots under `robots`, and only their devices under `tracks`".to_owned());
        reader.add(Code::WrongType, at.key_place(), message, "a device with its movement", hint);
        return None;
    }
    if matches!(at.node, Node::Map(_)) && told_as_keyframes(reader, at) {
        return None;
    }
    let Node::Map(_) = at.node else { return Some(new(keyframes(reader, at), at)) };
    let keys: TrackKeys<'_> = reader.keys(at, "a track")?;
    let TrackKeys { keyframes: frames, spline: points, polynomial: pieces, .. } = keys;
    let TrackKeys { wave, travel, samples, formula, r#for: length, .. } = keys;
    let forms = [frames, points, pieces, wave, travel, samples, formula];
    let forms: Vec<_> = forms.into_iter().flatten().collect();
    let [form] = forms.as_slice() else {
        let expected =
            "exactly one of `keyframes`, `spline`, `polynomial`, `wave`, `travel`, `samples`, `formula`";
        let code = if forms.is_empty() { Code::MissingKey } else { Code::UnknownKey };
        if !forms.is_empty() || !TrackKeys::NAMES.iter().any(|key| reader.is_miswritten(at, key)) {
            let message = match forms.len() {
                0 => "a track without a movement".to_owned(),
                count => format!("a track with {count} movements"),
            };
            reader.add(code, at.place(), message, expected, None);
        }
        return None;
    };
    if let (None, Some(length)) = (formula, length) {
        let message = "`for` has no effect without a `formula`";
        reader.add(Code::UnknownKey, length.key_place(), message, "a `formula` in this track", None);
    }
    let motion = match (frames, points, pieces, wave, travel, samples, formula) {
        (.., Some(formula)) => formulas::moved(reader, at, &formula, length),
        (Some(at), ..) => Some(keyframes(reader, &at)),
        (_, Some(at), ..) => Some(splined(reader, &at)),
        (_, _, Some(at), ..) => Some(polynomial(reader, &at)),
        (_, _, _, Some(at), ..) => waved(reader, &at),
        (_, _, _, _, Some(at), ..) => travelled(reader, &at),
        (_, _, _, _, _, Some(at), _) => data::samples(reader, library.files, &at).map(Written::of),
        _ => None,
    };
    Some(Track {
        control: keys.control.and_then(|at| control_type(reader, &at)),
        tolerance: keys
            .tolerance
            .and_then(|at| reader.positive(&at, "an error above 0, in the device's unit")),
        items: match (frames, points, pieces, samples) {
            (Some(_), ..) => Items::Keyframes,
            (_, Some(_), ..) => Items::Points,
            (_, _, Some(_), _) => Items::Pieces,
            (.., Some(_)) => Items::Rows,
            _ => Items::Whole,
        },
        steps_max: keys.max_steps.and_then(|at| reader.count(&at, 2, 1_000_000_000)),
        ..new(motion?, form)
    })
}

/// Whether the map at `at` contains tracks for several devices of a robot, instead of the keys of a single track.
fn is_of_devices(reader: &Reader, at: &At<'_>) -> bool {
    let Node::Map(entries) = at.node else { return false };
    entries.iter().any(|(key, node)| {
        reader.units.has_device(key)
            && matches!(node, Node::List(_) | Node::Map(_))
            && !TrackKeys::NAMES.contains(&key.as_str())
    })
}

/// Whether the list at `at` contains keyframes in an unsupported notation. Reports the list as a single fault.
fn told_as_keyframes(reader: &mut Reader, at: &At<'_>) -> bool {
    let Some(OtherForm { found, hints }) = as_keyframes(at) else { return false };
    reader.add_styled(at.place(), format!("found {found}"), KEYFRAMES, hints.map(Some));
    true
}

const KEYFRAMES: &str = "a list of keyframes such as {at: 1s, to: 45}";

fn control_type(reader: &mut Reader, at: &At<'_>) -> Option<ControlType> {
    let expected = "position, speed, acceleration or custom_N";
    let text = reader.text(at, expected)?;
    let parsed = text.parse().ok().filter(|t| !matches!(t, ControlType::Script | ControlType::Sensor));
    if parsed.is_none() {
        let message = format!("`{}` is not a control type for keyframes", shortened(&text));
        let hint = slips::word(&text, ["position", "speed", "acceleration"].into_iter());
        reader.add(Code::UnknownWord, at.place(), message, expected, hint);
    }
    parsed
}

#[expect(clippy::cast_possible_truncation, reason = "a file of 64 MiB has fewer items than u32 counts")]
const fn item(index: usize) -> u32 {
    index as u32
}

fn keyframes(reader: &mut Reader, at: &At<'_>) -> Written {
    let Node::List(items) = at.node else {
        if !told_as_keyframes(reader, at) {
            reader.wrong_type(at, KEYFRAMES);
        }
        return Written::of(Curve::default());
    };
    if let node::Items::Rows(rows) = items {
        return of_rows(reader, at, rows);
    }
    if items.is_empty() {
        nothing(reader, at, "the track has no keyframes", "at least one keyframe");
    } else if told_as_keyframes(reader, at) {
        return Written::of(Curve::default());
    }
    let several = |node: &Node| matches!(node, Node::Map(entries) if entries.iter().any(|(key, node)| key == "to" && matches!(node, Node::List(_))));
    if items.first().is_some_and(several) {
        return vectors(reader, at, items);
    }
    let mut length = Exact::ZERO;
    let mut depends = Vec::new();
    let mut knots: Vec<Knot> = Vec::with_capacity(items.len());
    for (index, node) in items.iter().enumerate() {
        let at_item = at.item(index, node);
        if let Some((knot, time)) = keyframe(reader, &at_item, item(index)) {
            length = time;
            depends.extend(value_of(&at_item).and_then(|to| Some((item(index), given(reader, &to)?))));
            let before = knots.last().map(|last| last.at);
            // Wrong order is a single fault.
            if in_order(reader, at, Items::Keyframes, index, before, knot.at) {
                knots.push(knot);
            }
        }
    }
    Written::new(Curve::new(knots, Vec::new()), length).with(depends)
}

/// Reads keyframes that are stored as rows. Their times are relative to the cue's start.
fn of_rows(reader: &mut Reader, list: &At<'_>, rows: &Rows) -> Written {
    let length = rows.iter().last().map_or(Exact::ZERO, |row| row.at.into());
    let mut before = None;
    let mut checked = |index: usize, at: Span| {
        in_order(reader, list, Items::Keyframes, index, before, at);
        before = Some(at);
    };
    let motion = match rows.width() {
        Width::One => {
            let knots = rows.iter().enumerate().map(|(index, row)| {
                checked(index, row.at);
                let shape = row.ease.and_then(Easing::named).map_or(Shape::Own, Shape::Eased);
                Knot { at: row.at, to: row.values[0], shape, item: item(index) }
            });
            Motion::Curve(Curve::new(knots.collect(), Vec::new()))
        }
        Width::List(_) => {
            let mut vectors = Vectors::with_capacity(rows.count(), rows.count() * rows.width().count());
            for (index, row) in rows.iter().enumerate() {
                checked(index, row.at);
                vectors.push(Vector { at: row.at, values: row.values, item: item(index) });
            }
            Motion::Vectors(vectors)
        }
    };
    Written { motion, length, given: Vec::new() }
}

fn in_order(
    reader: &mut Reader,
    list: &At<'_>,
    items: Items,
    index: usize,
    before: Option<Span>,
    at: Span,
) -> bool {
    if let Some(before) = before.filter(|before| at <= *before) {
        let place = list.place().below(PathStep::Index(index)).of_key("at");
        let message = format!("the {} at {at} is not later than the previous one at {before}", items.one());
        let hint =
            Some(format!("sort the {}s of a track by time, each later than the previous one", items.one()));
        reader.add(Code::TimeOrder, place, message, format!("a time after {before}"), hint);
        return false;
    }
    true
}

/// Returns the place of the value `to` in a keyframe or a point.
fn value_of<'a>(at: &'a At<'a>) -> Option<At<'a>> {
    let Node::Map(entries) = at.node else { return None };
    entries.iter().find(|(key, _)| key == "to").map(|(key, node)| at.entry(key, 0, node))
}

fn keyframe(reader: &mut Reader, at: &At<'_>, item: u32) -> Option<(Knot, Exact)> {
    let KeyframeKeys { at: time, to, ease } = reader.keys(at, "a keyframe")?;
    if let (Some(time), Some(to)) = (time, to)
        && let (Node::Number(value), Node::Text(text)) = (time.node, to.node)
        && parse_duration(text).is_some()
    {
        let hint = Some(format!("write `{{at: {text}, to: {value}}}`"));
        let message = format!("`at` is the number {value}, and `to` is the time {text}");
        reader.add(Code::WrongType, at.place(), message, "a time under `at`, and a value under `to`", hint);
        return None;
    }
    let time = time.and_then(|at| reader.exact(&at));
    let to = to.and_then(|at| reader.number(&at, "a finite number"));
    let easing = ease.and_then(|at| reader.word(&at, &Easing::WORDS));
    let (time, to) = (time?, to?);
    let at = reader.music.start.lay(time);
    Some((Knot { at, to, shape: easing.map_or(Shape::Own, Shape::Eased), item }, time))
}

fn vectors(reader: &mut Reader, list: &At<'_>, items: &[Node]) -> Written {
    let mut length = Exact::ZERO;
    let mut vectors = Vectors::default();
    for (index, node) in items.iter().enumerate() {
        let at = list.item(index, node);
        let keys = reader.keys(&at, "a keyframe of several values");
        let Some(VectorKeys { at: time, to }) = keys else { continue };
        let time = time.and_then(|at| reader.exact(&at));
        let values: Option<Vec<f64>> = to.and_then(|at| {
            let values = reader.list(&at, "a list of finite numbers");
            let most = urrcp::CONTROL_VALUES_MAX;
            if matches!(at.node, Node::List(_)) && !(1..=most).contains(&values.len()) {
                let message = format!("found {} values", values.len());
                reader.add(Code::WrongType, at.place(), message, format!("1 to {most} values"), None);
            }
            values.iter().map(|at| reader.number(at, "a finite number")).collect()
        });
        let (Some(time), Some(values)) = (time, values.filter(|values| !values.is_empty())) else { continue };
        let at = reader.music.start.lay(time);
        length = time;
        if in_order(reader, list, Items::Keyframes, index, vectors.last().map(|last| last.at), at) {
            vectors.push(Vector { at, values: &values, item: item(index) });
        }
    }
    Written { motion: Motion::Vectors(vectors), length, given: Vec::new() }
}

/// Reads the points of a curve, in order of time. Also returns the time of the last point, and the points that depend on parameters.
fn points(reader: &mut Reader, at: &At<'_>, least: usize) -> (Vec<Knot>, Exact, Givens) {
    let mut length = Exact::ZERO;
    let mut depends = Vec::new();
    let mut knots: Vec<Knot> = Vec::new();
    for (index, point) in reader.list(at, "a list of points such as {at: 1s, to: 45}").iter().enumerate() {
        let Some(PointKeys { at: time, to }) = reader.keys(point, "a point") else { continue };
        let exact = time.and_then(|at| reader.exact(&at));
        depends.extend(to.and_then(|to| Some((item(index), given(reader, &to)?))));
        let to = to.and_then(|at| reader.number(&at, "a finite number"));
        let (Some(exact), Some(to)) = (exact, to) else { continue };
        let time = reader.music.start.lay(exact);
        let before = knots.last().map(|last| last.at);
        // Points out of order are reported and left out of the curve.
        if in_order(reader, at, Items::Points, index, before, time) {
            knots.push(Knot { at: time, to, shape: Shape::Sampled(Between::Linear), item: item(index) });
            length = exact;
        }
    }
    if knots.len() < least && matches!(at.node, Node::List(_)) {
        let message = format!("found {} points in order", knots.len());
        reader.add(Code::BadMotion, at.place(), message, format!("at least {least} points"), None);
    }
    (knots, length, depends)
}

fn splined(reader: &mut Reader, at: &At<'_>) -> Written {
    let (mut knots, length, depends) = points(reader, at, 2);
    let times: Vec<_> = knots.iter().map(|knot| knot.at.as_millis_f64()).collect();
    let values: Vec<_> = knots.iter().map(|knot| knot.to).collect();
    let functions: Vec<_> =
        spline(&times, &values).into_iter().map(|c| Function::Polynomial(Box::new(c))).collect();
    for (index, knot) in knots.iter_mut().enumerate().skip(1) {
        knot.shape = Shape::Function { index: item(index - 1), gain: 1.0, offset: 0.0, reversed: false };
    }
    Written::new(Curve::new(knots, functions), length).with(depends)
}

/// Reads consecutive polynomials. Their coefficients refer to seconds since the start of each piece.
fn polynomial(reader: &mut Reader, at: &At<'_>) -> Written {
    let expected = "a list of pieces such as {for: 2s, coefficients: [0, 10, -2]}";
    let pieces = match at.node {
        Node::Map(_) => vec![*at],
        _ => reader.list(at, expected),
    };
    let (mut knots, mut functions): (Vec<Knot>, Vec<Function>) = (Vec::new(), Vec::new());
    let mut done = Exact::ZERO;
    for (index, piece) in pieces.iter().enumerate() {
        let keys = reader.keys(piece, "a polynomial");
        let Some(PieceKeys { r#for: length, coefficients }) = keys else { continue };
        let length = length.and_then(|at| positive_time(reader, &at));
        let coefficients: Option<Vec<f64>> = coefficients.and_then(|at| {
            let list = reader.list(&at, "a list of numbers, the constant term first");
            if matches!(at.node, Node::List(_)) && !(1..=64).contains(&list.len()) {
                let message = format!("found {} coefficients", list.len());
                reader.add(Code::BadMotion, at.place(), message, "1 to 64 coefficients", None);
                return None;
            }
            list.iter().map(|at| reader.number(at, "a finite number")).collect()
        });
        if let (Some(length), Some(coefficients)) = (length, coefficients) {
            let begin = reader.music.start.lay(done);
            done = done.plus(length);
            let end = reader.music.start.lay(done);
            let seconds = (end - begin).as_millis_f64() / 1_000.0;
            add_function(&mut knots, &mut functions, item(index), end, in_s(&coefficients, seconds));
        }
    }
    Written::new(Curve::new(knots, functions), done)
}

/// Scales coefficients so that time runs from 0 to 1 instead of from 0 to `seconds`.
fn in_s(coefficients: &[f64], seconds: f64) -> Function {
    let mut power = 1.0;
    let scaled = coefficients.iter().map(|c| {
        let scaled = c * power;
        power *= seconds;
        scaled
    });
    Function::Polynomial(scaled.collect())
}

fn add_function(
    knots: &mut Vec<Knot>,
    functions: &mut Vec<Function>,
    item: u32,
    end: Span,
    function: Function,
) {
    let begin = knots.last().map_or(Span::ZERO, |last| last.at);
    let first = function.at(0.0);
    if knots.last().is_none_or(|last| (last.to - first).abs() > 1e-9 * (1.0 + first.abs())) {
        let shape = if knots.is_empty() { Shape::Sampled(Between::Linear) } else { Shape::Meets };
        knots.push(Knot { at: begin, to: first, shape, item });
    }
    let index = u32::try_from(functions.len()).unwrap_or(u32::MAX);
    let shape = Shape::Function { index, gain: 1.0, offset: 0.0, reversed: false };
    knots.push(Knot { at: end, to: function.at(1.0), shape, item });
    functions.push(function);
}

pub(super) fn positive_time(reader: &mut Reader, at: &At<'_>) -> Option<Exact> {
    let length = reader.exact(at)?;
    if length.rounded_down() > Span::ZERO {
        return Some(length);
    }
    let place = at.place();
    let hint = Some(match place.path.last() {
        Some(PathStep::Key(key, _)) if key == "period" => {
            "write the duration of a cycle, as in `period: 2s`; use a keyframe for a constant value"
                .to_owned()
        }
        Some(PathStep::Key(key, _)) => format!("add the duration, as in `{}: 8s`", shortened(key)),
        _ => "write a duration such as `8s`".to_owned(),
    });
    reader.add(Code::BadMotion, place, "a movement of length 0", "a time above 0", hint);
    None
}

/// Reads a wave: center + amplitude * sin(2 pi (frequency t + phase / 360))
fn waved(reader: &mut Reader, at: &At<'_>) -> Option<Written> {
    let WaveKeys { amplitude, frequency, period, phase, center, r#for: length } =
        reader.keys(at, "a wave")?;
    let depends = [amplitude, center].into_iter().flatten().find_map(|at| given(reader, &at));
    let amplitude = amplitude.and_then(|at| reader.number(&at, "a number in the device's unit"));
    let length = length.and_then(|at| positive_time(reader, &at));
    let hertz = match (frequency, period) {
        (Some(at), None) => reader.positive(&at, "a frequency above 0, in hertz").map(Hertz::Frequency),
        (None, Some(at)) => positive_time(reader, &at).map(Hertz::Period),
        _ => {
            let message = "the wave has both or neither of `frequency` and `period`";
            reader.add(Code::MissingKey, at.place(), message, "one of `frequency` and `period`", None);
            None
        }
    };
    let phase = phase.and_then(|at| reader.degrees(&at, "a phase in degrees")).unwrap_or(0.0);
    let center = center.and_then(|at| reader.number(&at, "a value in the device's unit")).unwrap_or(0.0);
    let (amplitude, length, hertz) = (amplitude?, length?, hertz?);
    let exact = length;
    let length = reader.music.start.lay(exact);
    let cycles = hertz.cycles(exact);
    if cycles > 10_000.0 {
        let message = format!("{cycles:.0} cycles in one wave");
        let hint = Some("write fewer cycles and `repeat` them".to_owned());
        reader.add(Code::TooMuch, at.place(), message, "at most 10000 cycles", hint);
        return None;
    }
    let depends = depends.into_iter().map(|given| (NO_ITEM, given)).collect();
    Some(Written::new(wave(amplitude, center, phase / 360.0, cycles, length), exact).with(depends))
}

/// The frequency of a wave in the form in which it is written.
enum Hertz {
    Frequency(f64),
    Period(Exact),
}

impl Hertz {
    fn cycles(&self, length: Exact) -> f64 {
        match self {
            Self::Frequency(hertz) => length.times(fraction(*hertz)).seconds(),
            Self::Period(period) => length.divided_by(*period).map_or(0.0, to_f64),
        }
    }
}

/// Creates a wave with a knot after every [`WAVE_CYCLES`] cycles. All sections between these knots are equal, so only one of them has to
/// be fitted.
fn wave(amplitude: f64, center: f64, phase: f64, cycles: f64, length: Span) -> Curve {
    let shape = |index| Shape::Function { index, gain: amplitude, offset: center, reversed: false };
    let value = |function: &Function, s: f64| center + amplitude * function.at(s);
    let together = WAVE_CYCLES.min(cycles);
    let whole = Function::Sine { cycles: together, phase };
    let begin = Shape::Sampled(Between::Linear);
    let mut knots = vec![Knot { at: Span::ZERO, to: value(&whole, 0.0), shape: begin, item: NO_ITEM }];
    let mut done = together;
    while done <= cycles {
        let rest = cycles - done;
        let part = || Span::from_millis_f64(length.as_millis_f64() * done / cycles);
        let at = if rest > 1e-9 { part() } else { length };
        knots.push(Knot { at, to: value(&whole, 1.0), shape: shape(0), item: NO_ITEM });
        done += together;
    }
    let rest = cycles - (done - together);
    let mut functions = vec![whole];
    if rest > 1e-9 {
        let last = Function::Sine { cycles: rest, phase };
        knots.push(Knot { at: length, to: value(&last, 1.0), shape: shape(1), item: NO_ITEM });
        functions.push(last);
    }
    Curve::new(knots, functions)
}

/// Reads a movement with constant acceleration: from + speed t + acceleration t^2 / 2
fn travelled(reader: &mut Reader, at: &At<'_>) -> Option<Written> {
    let TravelKeys { from, speed, acceleration, r#for: length } = reader.keys(at, "`travel`")?;
    if speed.is_none() && acceleration.is_none() {
        let expected = "at least one of `speed` and `acceleration`";
        reader.add(
            Code::MissingKey,
            at.place(),
            "`travel` has neither speed nor acceleration",
            expected,
            None,
        );
    }
    let mut number =
        |at: Option<At<'_>>, expected: &str| at.map_or(Some(0.0), |at| reader.number(&at, expected));
    let from = number(from, "a value in the device's unit");
    let speed = number(speed, "a speed in units per second");
    let acceleration = number(acceleration, "an acceleration in units per second squared");
    let exact = length.and_then(|at| positive_time(reader, &at))?;
    let length = reader.music.start.lay(exact);
    let function = in_s(&[from?, speed?, acceleration? / 2.0], length.as_millis_f64() / 1_000.0);
    let (mut knots, mut functions) = (Vec::new(), Vec::new());
    add_function(&mut knots, &mut functions, NO_ITEM, length, function);
    Some(Written::new(Curve::new(knots, functions), exact))
}
