//! A group that moves into a formation, or home to the default positions of its robots.

use std::cmp::Ordering;

use super::{Axis, Dancer, DancerMovement, Fault, Form, Ground, GroupTask, LEVEL, Spare, Target, Thin};
use crate::formation::{Point, ROUNDING, SAME, nearest_pair};
use crate::motion::Swept;
use crate::shown::shortened;
use crate::transit::{self, Refused, Route};

/// Returns the movement of each robot into a formation.
pub(super) fn formed(
    asked: GroupTask<'_>,
    form: &Form,
    dancers: &[Dancer<'_>],
    ground: Ground<'_>,
) -> Result<Vec<DancerMovement>, Fault> {
    let (goals, own) = match &form.to {
        Target::Home => (homes(dancers)?, true),
        Target::Formation(name) => {
            let places = places(form, dancers.len(), ground)?;
            reached(name, dancers, &places)?;
            let places = level(places, dancers);
            uncrowded(dancers, &places, ground)?;
            (settable(places, dancers), false)
        }
    };
    let spare = match form.spare {
        Some(Spare::Home) if !own && goals.len() < dancers.len() => homes(dancers)?,
        _ => dancers.iter().map(|dancer| dancer.from).collect(),
    };
    let bodies = bodies(asked, dancers, &goals, ground);
    let goals = if own { transit::Goals::Own(&goals) } else { transit::Goals::Any(&goals, &spare) };
    let crossing = transit::Crossing { bodies: &bodies, goals, least: form.least, over: asked.seconds() };
    let crossed = transit::cross(&crossing).map_err(|refused| match refused {
        Refused::TooShort { body, seconds } => Fault::TooShort { dancer: body, seconds },
        Refused::Blocked(blocked) => Fault::Blocked(blocked),
    })?;
    let shares = bodies
        .iter()
        .zip(&crossed.errors)
        .map(|(body, error)| if *error < body.error { error / body.error } else { 1.0 });
    let ways = crossed.ways.iter().zip(shares).zip(dancers);
    Ok(ways.map(|((way, share), dancer)| DancerMovement::of_way(way, dancer, share)).collect())
}

/// Returns the places of a formation; empty if the target is home. If there are fewer places than robots, the cue must set the key
/// `spare`. If there are more places than robots, it must set `thin`.
pub(super) fn places(form: &Form, robots: usize, ground: Ground<'_>) -> Result<Vec<Point>, Fault> {
    let Target::Formation(name) = &form.to else { return Ok(Vec::new()) };
    let written = ground.formations.get(name).ok_or(Fault::UnknownFormation)?;
    // Faults of a formation, and too many places, are reported at the formation itself.
    let formation = written.formation.as_ref().ok_or(Fault::ToldElsewhere)?;
    let places = formation.places(robots).map_err(|_| Fault::ToldElsewhere)?;
    match (places.len().cmp(&robots), form.spare, form.thin) {
        (Ordering::Less, None, _) | (Ordering::Greater, _, None) => {
            Err(Fault::Count { places: places.len() })
        }
        (Ordering::Greater, _, Some(Thin::Evenly)) => {
            Ok((0..robots).map(|index| places[index * places.len() / robots]).collect())
        }
        _ => Ok(places),
    }
}

/// Checks that all robots can reach the heights of the places.
fn reached(name: &str, dancers: &[Dancer<'_>], places: &[Point]) -> Result<(), Fault> {
    let differ = |height: f64| places.iter().any(|place| (place[2] - height).abs() > LEVEL);
    let all_flat = dancers.iter().all(Dancer::is_flat);
    // If all robots have a fixed height, a level formation is moved to that height.
    let cannot = |dancer: &Dancer<'_>| {
        let height = if all_flat { places[0][2] } else { dancer.from[2] };
        dancer.is_flat() && differ(height)
    };
    let Some(dancer) = dancers.iter().position(cannot) else { return Ok(()) };
    let why = if differ(places[0][2]) {
        format!("the places of `{}` differ in height", shortened(name))
    } else {
        format!("the places of `{}` are at a different height", shortened(name))
    };
    Err(Fault::Flat { dancer, why })
}

/// Checks that the two nearest places of a formation are far enough apart for the bodies of any two robots.
fn uncrowded(dancers: &[Dancer<'_>], places: &[Point], ground: Ground<'_>) -> Result<(), Fault> {
    // If there are more places than robots, only some are used.
    let Some(pair) = nearest_pair(places).filter(|_| places.len() <= dancers.len()) else { return Ok(()) };
    let required = ground.fleet.space.between_middles(dancers.iter().map(|dancer| dancer.body));
    if pair.distance >= required.max(SAME) - ROUNDING {
        Ok(())
    } else {
        Err(Fault::Crowded { places: pair.places, distance: pair.distance, required })
    }
}

/// Returns the default position of each robot. If robots have none, returns these robots as the fault.
fn homes(dancers: &[Dancer<'_>]) -> Result<Vec<Point>, Fault> {
    let home = |dancer: &Dancer<'_>| match dancer.axes.each_ref().map(Axis::home) {
        [Some(x), Some(y), Some(z)] => Some([x, y, z]),
        _ => None,
    };
    let homes: Vec<Option<Point>> = dancers.iter().map(home).collect();
    let homeless: Vec<usize> = (0..homes.len()).filter(|dancer| homes[*dancer].is_none()).collect();
    if homeless.is_empty() {
        Ok(homes.into_iter().flatten().collect())
    } else {
        Err(Fault::Homeless(homeless))
    }
}

fn bodies(
    asked: GroupTask<'_>,
    dancers: &[Dancer<'_>],
    goals: &[Point],
    ground: Ground<'_>,
) -> Vec<transit::Body> {
    let space = &ground.fleet.space;
    let apart = space.distance.unwrap_or(0.0) / 2.0;
    let heights = dancers.iter().map(|dancer| dancer.from[2]).chain(goals.iter().map(|goal| goal[2]));
    let lowest = heights.fold(f64::INFINITY, f64::min);
    let body = |dancer: &Dancer<'_>| {
        let radius = dancer.body.shape.outer_radius();
        let [x, y, z] = dancer.axes.each_ref().map(|axis| axis.error(asked.tolerance));
        let keep_in = space.keep_in.as_ref().map_or(f64::INFINITY, |volume| volume.most[2] - radius);
        transit::Body {
            from: dancer.from,
            keep: apart + radius,
            error: x.hypot(y).hypot(z),
            // Half a unit of each device's grid.
            rounding: dancer.coarseness() / 2.0,
            begin: dancer.delay_seconds(),
            limits: dancer.limits(ground.fleet),
            heights: dancer.axes[2].ends().map(|[low, high]| [low.max(lowest), high.min(keep_in)]),
        }
    };
    dancers.iter().map(body).collect()
}

/// Moves the places to the height of the robots if none of the robots can change its height.
fn level(mut places: Vec<Point>, dancers: &[Dancer<'_>]) -> Vec<Point> {
    if let Some(first) = dancers.first()
        && dancers.iter().all(|dancer| dancer.is_flat())
    {
        places.iter_mut().for_each(|place| place[2] = first.from[2]);
    }
    places
}

/// Rounds the places to positions that the devices can reach, if these positions are the same for all robots. Movements are then checked
/// up to the places where they really end.
fn settable(mut places: Vec<Point>, dancers: &[Dancer<'_>]) -> Vec<Point> {
    let grids = |dancer: &Dancer<'_>| dancer.axes.each_ref().map(Axis::grid);
    let Some(first) = dancers.first() else { return places };
    if dancers.iter().all(|dancer| grids(dancer) == grids(first)) {
        for place in &mut places {
            *place = std::array::from_fn(|axis| first.axes[axis].nearest(place[axis]));
        }
    }
    places
}

impl DancerMovement {
    fn of_way(way: &Route, dancer: &Dancer<'_>, error_share: f64) -> Self {
        let lifts = [0.0, 0.0, 4.0 * way.lift];
        let axes = std::array::from_fn(|axis| {
            let (from, lift) = (way.from[axis], lifts[axis]);
            let to = dancer.axes[axis].nearest(way.to[axis]);
            Swept { line: [from, to - from + lift, -lift], ..Swept::default() }
        });
        Self { begin: way.begin, length: way.length, axes, error_share }
    }
}
