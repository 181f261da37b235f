//! The places of robots that are driven by speeds: integrals of their forward speed and turn rate.
//!
//! A body moves forward at `v` along its yaw, and turns at `w`: `x' = v cos yaw`, `y' = v sin yaw`, `yaw' = w` (the unicycle; Siciliano
//! and others, Robotics, 2009, section 11.2). While `v` and `w` are constant, the body moves on an arc, which has a closed form. While
//! they change linearly, Simpson's rule integrates from moment to moment. The path becomes a polyline in x, y and yaw, with a bound on
//! the deviation of the body's points.

use super::path::{Axis, Peak, moments};
use super::{Drive, Steering};

/// Largest deviation of the body from the polyline, in metres, if [`POINTS_MAX`] permits it; determines the spacing of the polyline's
/// points.
const CHORD: f64 = 5e-5;
/// Largest error of Simpson's rule over a whole act, in metres.
const DRIFT: f64 = 1e-5;
/// Approximate maximum number of points of a path in an act. If more points would be needed, the body deviates further from the polyline,
/// and the deviation is reported.
const POINTS_MAX: f64 = 200_000.0;

/// The pose of a driven body on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position along x, in metres.
    pub x: f64,
    /// Position along y, in metres.
    pub y: f64,
    /// Heading, in radians.
    pub yaw: f64,
    /// Largest error of x and y, in metres.
    pub drift: f64,
}

/// The movement of a driven body in an act.
#[derive(Clone, Debug)]
pub struct Driven {
    /// Movements of x, y and yaw.
    pub axes: [Axis; 3],
    /// Largest deviation of a point of the body from `axes`, in metres.
    pub margin: f64,
    /// Final pose; `None` if the body still moves at the end.
    pub end: Option<Pose>,
    /// The largest speed and the largest acceleration of the body's middle.
    pub peaks: [Option<Peak>; 2],
}

/// Forward speed in m/s, and turn rate to the left in rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Twist {
    ahead: f64,
    turn: f64,
}

impl Twist {
    const REST: Self = Self { ahead: 0.0, turn: 0.0 };
}

/// An interval in which forward speed and turn rate change linearly.
#[derive(Clone, Copy, Debug)]
struct Leg {
    from: f64,
    to: f64,
    begin: Twist,
    end: Twist,
}

impl Pose {
    /// Creates a pose from x and y in metres and yaw in radians.
    pub const fn at([x, y, yaw]: [f64; 3]) -> Self {
        Self { x, y, yaw, drift: 0.0 }
    }
}

impl Drive {
    /// Converts the values of both devices to a forward speed and a turn rate. The values are the speeds of the wheels in m/s, or already
    /// the forward speed in m/s and the turn rate in rad/s.
    fn twist(&self, [first, second]: [f64; 2]) -> Twist {
        match &self.steering {
            Steering::Wheels { track, .. } => {
                Twist { ahead: f64::midpoint(first, second), turn: (second - first) / track }
            }
            Steering::Twist { .. } => Twist { ahead: first, turn: second },
        }
    }

    /// Returns the path from the pose `start` until `ends`, in seconds. `signals` are the values of both devices, starting at 0, in m/s
    /// and rad/s. `lever` is the largest distance of the body's points from its middle. `None` if the path exceeds the range of numbers.
    pub fn path(&self, start: Pose, signals: &[Axis; 2], ends: f64, lever: f64) -> Option<Driven> {
        let (legs, rests) = self.legs(signals, ends);
        let wanted: f64 = legs.iter().map(|leg| leg.parts(ends, lever)).sum();
        let share = (POINTS_MAX / wanted).min(1.0);
        let mut course = Course { points: vec![(0.0, start)], sag: 0.0 };
        for leg in &legs {
            course.follow(leg, (leg.parts(ends, lever) * share).ceil().max(1.0), lever);
        }
        let last = course.points[course.points.len() - 1].1;
        let margin = course.sag + last.drift;
        let is_finite = [last.x, last.y, last.yaw, margin].iter().all(|value| value.is_finite());
        is_finite.then(|| Driven {
            axes: course.axes(),
            margin,
            end: rests.then_some(last),
            peaks: [peak(&legs, Leg::speed), acceleration(&legs)],
        })
    }

    /// Returns the intervals in which the speeds change linearly, and whether both speeds are 0 at the end.
    fn legs(&self, signals: &[Axis; 2], ends: f64) -> (Vec<Leg>, bool) {
        let mut twists: Vec<(f64, Twist)> = Vec::new();
        moments(signals, 0.0, |at, values| twists.push((at, self.twist([values[0], values[1]]))));
        let leg =
            |pair: &[(f64, Twist)]| Leg { from: pair[0].0, to: pair[1].0, begin: pair[0].1, end: pair[1].1 };
        let mut legs: Vec<Leg> = twists.windows(2).map(leg).filter(|leg| leg.to > leg.from).collect();
        if let Some((at, twist)) = twists.last().filter(|(at, _)| *at < ends) {
            legs.push(Leg { from: *at, to: ends, begin: *twist, end: *twist });
        }
        let rests = twists.last().is_none_or(|(_, twist)| *twist == Twist::REST);
        (legs, rests)
    }
}

impl Leg {
    fn seconds(&self) -> f64 {
        self.to - self.from
    }

    fn is_constant(&self) -> bool {
        self.begin == self.end
    }

    fn speed(&self) -> f64 {
        self.begin.ahead.abs().max(self.end.ahead.abs())
    }

    fn turn(&self) -> f64 {
        self.begin.turn.abs().max(self.end.turn.abs())
    }

    /// Returns the rates of change of both speeds, in m/s² and rad/s².
    fn rates(&self) -> Twist {
        let seconds = self.seconds();
        Twist {
            ahead: (self.end.ahead - self.begin.ahead) / seconds,
            turn: (self.end.turn - self.begin.turn) / seconds,
        }
    }

    /// Returns an upper bound on the total acceleration (along the path and across it) in m/s².
    fn acceleration(&self) -> f64 {
        self.rates().ahead.hypot(self.speed() * self.turn())
    }

    /// Returns the largest deviation of a point of the body from a straight line over `seconds`. The error of linear interpolation is an
    /// eighth of the second derivative times the time squared.
    fn sag(&self, seconds: f64, lever: f64) -> f64 {
        (self.acceleration() + lever * self.rates().turn.abs()) * seconds * seconds / 8.0
    }

    /// Returns a bound on the fourth derivative of the velocity. The velocity's direction, as a complex number `g`, has the angle of the
    /// yaw. With the turn rate `w` and its rate of change `c`: `g'' = (ic - w²) g`, `g''' = -(3wc + iw³) g`, `g'''' = (w⁴ - 3c² - 6icw²)
    /// g`.
    fn fourth(&self) -> f64 {
        let (v, w, rates) = (self.speed(), self.turn(), self.rates());
        let (a, c) = (rates.ahead.abs(), rates.turn.abs());
        v * (w.powi(4) + 6.0 * w * w * c + 3.0 * c * c) + 4.0 * a * (3.0 * w * c + w.powi(3))
    }

    /// Returns the error of Simpson's rule over `seconds`, in metres.
    fn drift(&self, seconds: f64) -> f64 {
        if self.is_constant() { 0.0 } else { seconds.powi(5) / 2_880.0 * self.fourth() }
    }

    /// Returns the number of parts into which the interval is divided.
    fn parts(&self, ends: f64, lever: f64) -> f64 {
        let seconds = self.seconds();
        let for_chords = (self.sag(seconds, lever) / CHORD).sqrt();
        // Each second of the act has an equal share of the permitted drift.
        let for_drift = (self.drift(seconds) / (DRIFT * seconds / ends)).powf(0.25);
        for_chords.max(for_drift).max(1.0)
    }

    /// Returns the speeds and the yaw `seconds` after the start of the interval; `yaw` is the yaw at that start.
    fn after(&self, seconds: f64, yaw: f64) -> (Twist, f64) {
        let rates = self.rates();
        let twist = Twist {
            ahead: self.begin.ahead + rates.ahead * seconds,
            turn: self.begin.turn + rates.turn * seconds,
        };
        (twist, yaw + f64::midpoint(self.begin.turn, twist.turn) * seconds)
    }

    /// Returns the movement in x and y between two moments of the interval; `yaw` is the yaw at its start.
    fn way(&self, [from, to]: [f64; 2], yaw: f64) -> [f64; 2] {
        let middle = f64::midpoint(from, to);
        let (twist, course) = self.after(middle, yaw);
        if self.is_constant() {
            let half = twist.turn * (to - from) / 2.0;
            // sin x / x is 1 to the last digit if x² / 6 is below the resolution of a double.
            let chord = if half.abs() < 1e-8 { 1.0 } else { half.sin() / half };
            let long = twist.ahead * (to - from) * chord;
            return [long * course.cos(), long * course.sin()];
        }
        let velocity = |at: f64| {
            let (twist, yaw) = self.after(at, yaw);
            [twist.ahead * yaw.cos(), twist.ahead * yaw.sin()]
        };
        let [begin, between, end] = [from, middle, to].map(velocity);
        std::array::from_fn(|i| (to - from) / 6.0 * (begin[i] + 4.0 * between[i] + end[i]))
    }
}

/// The poses along the path of a driven body, in order of time.
struct Course {
    points: Vec<(f64, Pose)>,
    /// Largest deviation of a point of the body between two poses, in metres.
    sag: f64,
}

impl Course {
    fn follow(&mut self, leg: &Leg, parts: f64, lever: f64) {
        let (start, seconds) = (self.points[self.points.len() - 1].1, leg.seconds());
        let mut pose = start;
        for part in 0..parts as u32 {
            let [from, to] = [part, part + 1].map(|part| seconds * f64::from(part) / parts);
            let [x, y] = leg.way([from, to], start.yaw);
            let drift = pose.drift + leg.drift(to - from);
            pose = Pose { x: pose.x + x, y: pose.y + y, yaw: leg.after(to, start.yaw).1, drift };
            self.points.push((leg.from + to, pose));
        }
        self.sag = self.sag.max(leg.sag(seconds / parts, lever));
    }

    fn axes(&self) -> [Axis; 3] {
        let axis = |value: fn(&Pose) -> f64| {
            Axis::through(self.points.iter().map(|(at, pose)| (*at, value(pose))).collect())
        };
        [axis(|pose| pose.x), axis(|pose| pose.y), axis(|pose| pose.yaw)]
    }
}

fn peak(legs: &[Leg], rate: fn(&Leg) -> f64) -> Option<Peak> {
    let peaks = legs.iter().map(|leg| Peak { from: leg.from, to: leg.to, rate: rate(leg) });
    peaks.max_by(|a, b| a.rate.total_cmp(&b.rate))
}

/// Returns the largest acceleration, in an interval or at a jump of the speed. A jump is divided by the mean length of the adjacent
/// intervals.
fn acceleration(legs: &[Leg]) -> Option<Peak> {
    let jump = |pair: &[Leg]| {
        let middles = [&pair[0], &pair[1]].map(|leg| f64::midpoint(leg.from, leg.to));
        let change = (pair[1].begin.ahead - pair[0].end.ahead).abs();
        Peak { from: middles[0], to: middles[1], rate: change / (middles[1] - middles[0]) }
    };
    let jumps = legs.windows(2).map(jump);
    jumps.chain(peak(legs, Leg::acceleration)).max_by(|a, b| a.rate.total_cmp(&b.rate))
}
