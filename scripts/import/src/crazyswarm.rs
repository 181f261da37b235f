//! Reads Crazyswarm CSVs: one polynomial piece per line, `duration,x^0..x^7,y^0..y^7,z^0..z^7,yaw^0..yaw^7`.

use urrcp::Span;

use downbeat_yaml::finding::Code;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::dialect::Dialect;
use super::input::Input;
use super::keyframes;
use super::polynomial::{AXES, COEFFICIENTS, Piece, Trajectory};
use super::sink::Sink;
use super::table::{Row, rows};
use super::{Course, DeviceMotion, ImportOptions, Keyframe, Motion, RobotMotion};

/// Default maximum number of pieces per trajectory: a Crazyflie has 4 KB of trajectory memory, and a piece takes 132 bytes.
const PIECES_MAX: usize = 31;
/// Number of decimal digits of sampled values, so their rounding error is at most 5e-8.
const DIGITS: i32 = 7;
/// Smallest jump between two pieces that is reported in a note, in the unit of the axis.
const JUMP_MIN: f64 = 1e-3;

/// Reads one file, which contains the motion of one robot in one scene.
pub(super) fn read(input: &Input, source: &Source, options: &ImportOptions, sink: &mut Sink) -> Vec<Motion> {
    let before = sink.findings.len();
    let pieces = read_pieces(source, options.pieces_max.unwrap_or(PIECES_MAX), sink);
    if sink.findings.len() > before {
        return Vec::new();
    }
    let trajectory = Trajectory::new(pieces);
    note_jump(&trajectory, source, sink);
    let samples = (trajectory.duration_s() * options.rate_hz.unwrap_or(0.0) + 2.0) * AXES.len() as f64;
    if !sink.has_room_for(samples) {
        sink.too_many(&source.name, samples);
        return Vec::new();
    }
    let times = match options.rate_hz {
        Some(rate) => {
            sink.note(format!(
                "{}: sampled at {rate} Hz, with straight lines between the samples; leave out --rate to keep the curves",
                source.name
            ));
            keyframes::sampled_times(trajectory.duration_s(), rate)
        }
        None => trajectory.bounds_s().iter().filter_map(|s| keyframes::span(*s)).collect(),
    };
    let course = |axis| match options.rate_hz {
        Some(_) => Course::Straight,
        None => Course::Pieces(trajectory.pieces_of(axis)),
    };
    let device = |(axis, (name, unit)): (usize, &(&str, &str))| DeviceMotion {
        device: (*name).to_owned(),
        unit: (*unit).to_owned(),
        keyframes: times.iter().map(|at| sample(&trajectory, axis, *at)).collect(),
        course: course(axis),
    };
    let devices = AXES.iter().enumerate().map(device).collect();
    vec![Motion { scene: input.scene.clone(), robot: RobotMotion { robot: input.robot.clone(), devices } }]
}

/// Returns the keyframe at the rounded time `at`. Its value is the trajectory's value at that rounded time, so that the rounding does not
/// change the motion.
fn sample(trajectory: &Trajectory, axis: usize, at: Span) -> Keyframe {
    let value = trajectory.value(axis, keyframes::seconds(at));
    Keyframe { at, value: keyframes::rounded(value, DIGITS) }
}

fn read_pieces(source: &Source, pieces_max: usize, sink: &mut Sink) -> Vec<Piece> {
    let mut rows = rows(source, Dialect::of(source, 0, None));
    let names = column_names();
    let Some(mut header) = rows.next() else {
        sink.about(
            &source.name,
            Code::ImportTable,
            "the file is empty".into(),
            "a header and polynomial pieces",
            None,
        );
        return Vec::new();
    };
    header.drop_trailing(names.len());
    if !header_is_right(&header, &names, source, sink) {
        return Vec::new();
    }
    let before = sink.findings.len();
    let mut pieces = Vec::new();
    let mut end_s = 0.0;
    for mut row in rows {
        row.drop_trailing(names.len());
        let Some(piece) = read_piece(&row, &names, source, sink) else {
            if sink.is_full(source) {
                break;
            }
            continue;
        };
        end_s = check_end(end_s, &piece, &row, source, sink);
        pieces.push(piece);
        if pieces.len() == pieces_max + 1 {
            too_many_pieces(pieces_max, &row, source, sink);
        }
        if pieces.len() > pieces_max || sink.is_full(source) {
            break;
        }
        if !sink.has_room_for((pieces.len() * AXES.len()) as f64) {
            sink.too_many(&source.name, (pieces.len() * AXES.len()) as f64);
            break;
        }
    }
    if pieces.is_empty() && sink.findings.len() == before {
        sink.about(
            &source.name,
            Code::NothingToDo,
            "the file has no pieces".into(),
            "one polynomial piece per line",
            None,
        );
    }
    pieces
}

fn column_names() -> Vec<String> {
    let powers =
        AXES.iter().flat_map(|(axis, _)| (0..COEFFICIENTS).map(move |power| format!("{axis}^{power}")));
    std::iter::once("duration".to_owned()).chain(powers).collect()
}

fn header_is_right(header: &Row<'_>, names: &[String], source: &Source, sink: &mut Sink) -> bool {
    let found = header.cells.iter().map(|cell| cell.text.to_lowercase());
    let wrong = found.zip(names).position(|(found, name)| found != *name);
    let Some(index) = wrong else { return header.has(names.len(), source, sink) };
    let message = format!("column {} of the header is `{}`", index + 1, shortened(&header.cells[index].text));
    let hint = "the header must be duration,x^0,..,x^7,y^0,..,z^0,..,yaw^0,..,yaw^7 (upper or lower case)";
    let expected = format!("`{}`", names[index]);
    sink.found(source, header.spot(index), Code::ImportTable, message, expected, Some(hint));
    false
}

fn read_piece(row: &Row<'_>, names: &[String], source: &Source, sink: &mut Sink) -> Option<Piece> {
    if !row.has(names.len(), source, sink) {
        return None;
    }
    let numbers: Vec<_> =
        names.iter().enumerate().map(|(index, name)| row.number(index, name, source, sink)).collect();
    let numbers: Vec<f64> = numbers.into_iter().collect::<Option<_>>()?;
    let mut coefficients = [[0.0; COEFFICIENTS]; AXES.len()];
    for (axis, chunk) in coefficients.iter_mut().zip(numbers[1..].chunks_exact(COEFFICIENTS)) {
        axis.copy_from_slice(chunk);
    }
    let duration_s = numbers[0];
    if duration_s > 0.0 {
        return Some(Piece { duration_s, coefficients });
    }
    let message = format!("a piece lasts {duration_s} s");
    sink.found(source, row.spot(0), Code::ImportTime, message, "a duration above 0 s", None);
    None
}

/// Returns the end of a piece, in seconds. Adds a finding if the piece starts and ends at the same nanosecond, or if the trajectory
/// becomes too long.
fn check_end(start_s: f64, piece: &Piece, row: &Row<'_>, source: &Source, sink: &mut Sink) -> f64 {
    let end_s = start_s + piece.duration_s;
    match (keyframes::span(start_s), keyframes::span(end_s)) {
        (Some(start), Some(end)) if start < end && keyframes::span(piece.duration_s) > Some(Span::ZERO) => {}
        (Some(_), Some(_)) => {
            let message = format!("a piece lasts {} s", piece.duration_s);
            let hint = Some("merge the piece with an adjacent one");
            sink.found(source, row.spot(0), Code::TimesCollide, message, "pieces of at least 1 ns", hint);
        }
        _ => {
            let message = format!("the trajectory lasts {end_s} s");
            let expected = format!("at most {} s", keyframes::SECONDS_MAX);
            sink.found(source, row.spot(0), Code::ImportTime, message, expected, None);
        }
    }
    end_s
}

fn too_many_pieces(pieces_max: usize, row: &Row<'_>, source: &Source, sink: &mut Sink) {
    let all = rows(source, Dialect::of(source, 0, None)).count() - 1;
    let message = format!("the trajectory has {all} pieces, but a robot can store at most {pieces_max}");
    let hint = "a Crazyflie has 4 KB of memory for pieces of 132 bytes each: split the file into scenes, or set --max-pieces";
    let expected = format!("at most {pieces_max} pieces");
    sink.found(source, row.spot(0), Code::TooManyPieces, message, expected, Some(hint));
}

fn note_jump(trajectory: &Trajectory, source: &Source, sink: &mut Sink) {
    if let Some((axis, at_s, jump)) = trajectory.largest_jump().filter(|(_, _, jump)| *jump >= JUMP_MIN) {
        let (name, unit) = AXES[axis];
        sink.note(format!(
            "{}: `{name}` jumps by {jump:.4} {unit} where two pieces meet at {at_s:.3} s",
            source.name
        ));
    }
}
