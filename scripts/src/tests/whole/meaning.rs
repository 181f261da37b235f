//! The meaning of a cue: its length and the starts of its robots. Also its steps, if the device plays the written keyframes without
//! further steps.

use num_rational::Ratio;

use super::super::verified::{Change, Movement};
use super::spread::Each;
use super::{Canon, Cue, DEVICES, MS, NAMES, Nanos, PLACES, Show, Tempo, When, settable};

pub(super) fn rounded(time: Ratio<i128>) -> Nanos {
    (time + Ratio::new(1, 2)).floor().to_integer()
}

fn double(value: Ratio<i128>) -> f64 {
    *value.numer() as f64 / *value.denom() as f64
}

fn millis(millis: i64) -> Ratio<i128> {
    Ratio::from_integer(i128::from(millis) * MS)
}

/// Returns a length, rounded so that its end is a whole number of nanoseconds. The length begins at `start`.
fn laid(start: Option<Ratio<i128>>, length: Ratio<i128>) -> Nanos {
    match start {
        Some(start) if !length.is_integer() => rounded(start + length) - rounded(start),
        _ => length.floor().to_integer(),
    }
}

impl Show {
    /// Returns the time from the beginning of the music to a position in the music, in nanoseconds. The position is in quarters of a
    /// beat.
    fn of_beats(&self, quarters: Ratio<i128>) -> Ratio<i128> {
        let mut time = Ratio::from_integer(0);
        let mut left = quarters;
        for (tempo, length) in self.tempos.iter().zip(self.lengths()) {
            let here = length.map_or(left, |length| left.min(length));
            time += here * quarter(tempo.bpm);
            left -= here;
        }
        time
    }

    /// Returns the position in the music at a time in nanoseconds, in quarters of a beat since the beginning of the music.
    fn beats_at(&self, time: Ratio<i128>) -> Ratio<i128> {
        let mut quarters = Ratio::from_integer(0);
        let mut left = time;
        for (tempo, length) in self.tempos.iter().zip(self.lengths()) {
            let whole = length.map(|length| length * quarter(tempo.bpm));
            let here = whole.map_or(left, |whole| left.min(whole));
            quarters += here / quarter(tempo.bpm);
            left -= here;
        }
        quarters
    }

    /// Returns the length of each tempo in quarters of a beat; `None` for the last tempo, which never ends.
    fn lengths(&self) -> Vec<Option<Ratio<i128>>> {
        let mut upper = 4;
        let length = |(index, tempo): (usize, &Tempo)| {
            upper = tempo.signature.map_or(upper, |(upper, _)| upper);
            let next = self.tempos.get(index + 1)?;
            Some(Ratio::from_integer(i128::from(4 * upper * (next.bar - tempo.bar))))
        };
        self.tempos.iter().enumerate().map(length).collect()
    }

    /// Returns the start of a bar, counted from 1, in nanoseconds.
    pub(super) fn bar(&self, bar: i64) -> Ratio<i128> {
        let (mut quarters, mut upper) = (0, 4);
        for (index, tempo) in self.tempos.iter().enumerate() {
            upper = tempo.signature.map_or(upper, |(upper, _)| upper);
            let until = self.tempos.get(index + 1).map_or(bar, |next| next.bar.min(bar));
            quarters += 4 * upper * (until - tempo.bar).max(0);
        }
        self.of_beats(Ratio::from_integer(i128::from(quarters)))
    }

    /// Returns the duration of `quarters` quarters of a beat after the time `start`, in nanoseconds. `start` may be `None` if the tempo
    /// never changes.
    pub(super) fn beats(&self, start: Option<Ratio<i128>>, quarters: Ratio<i128>) -> Ratio<i128> {
        let start = start.unwrap_or_default();
        self.of_beats(self.beats_at(start) + quarters) - start
    }
}

/// Returns the duration of a quarter of a beat in nanoseconds. `bpm` is in hundredths of beats per minute.
fn quarter(bpm: i64) -> Ratio<i128> {
    Ratio::new(60_000_000_000 * 100, 4 * i128::from(bpm))
}

impl Cue {
    pub(super) fn start(&self, show: &Show) -> Option<Ratio<i128>> {
        match self.when {
            When::At(millis) | When::Each(millis, _) => Some(self::millis(millis)),
            When::Bar(bar) => Some(show.bar(bar)),
            _ => None,
        }
    }

    pub(super) fn robots(&self) -> &'static [usize] {
        NAMES[self.who].1
    }

    /// Returns all numbers of the cue that differ between robots.
    pub(super) fn differing(&self) -> Vec<Each> {
        let keyframes = self.beats.iter().flatten().flat_map(|(at, to)| [*at, *to]);
        let all = keyframes.chain(self.scale.map(|(by, _)| by)).chain(self.change.pause.map(|_| self.pause));
        all.filter(|each| each.differs()).collect()
    }

    /// Returns the keyframes of the robot at `index`: times in quarters of a beat, and values. `None` if the cue has no keyframes in
    /// beats.
    fn own_keyframes(&self, index: usize) -> Option<Vec<(Ratio<i128>, f64)>> {
        let own = |(at, to): &(Each, Each)| {
            (at.of(self.robots(), index), double(to.of(self.robots(), index)) / 4.0)
        };
        Some(self.beats.as_ref()?.iter().map(own).collect())
    }

    /// Returns the movement of the robot at `index`, before the cue's changes apply to it.
    pub(super) fn movement(&self, show: &Show, index: usize) -> Movement {
        let Some(keyframes) = self.own_keyframes(index) else { return self.movement.clone() };
        let millis = |quarters: Ratio<i128>| double(show.beats(self.start(show), quarters)) / 1e6;
        let keyframes: Vec<_> = keyframes.into_iter().map(|(at, to)| (millis(at), to)).collect();
        Movement::of_keyframes("", DEVICES[self.device].1, &keyframes)
    }

    /// Returns the changes that apply to the movement of the robot at `index`.
    pub(super) fn change(&self, show: &Show, index: usize) -> Change {
        let mut change = match self.scale {
            Some((by, about)) => self.change.scaled(double(by.of(self.robots(), index)) / 4.0, about as f64),
            None => self.change.clone(),
        };
        let pause = self.cycle(show, index) - self.lap(show, index);
        change.pause = change.pause.map(|_| double(pause) / 1e6);
        change
    }

    /// Returns the length of one repetition for the robot at `index`, in nanoseconds.
    fn lap(&self, show: &Show, index: usize) -> Ratio<i128> {
        match self.own_keyframes(index) {
            Some(keyframes) => show.beats(self.start(show), keyframes[keyframes.len() - 1].0),
            None => millis(self.movement.ways[self.movement.ways.len() - 1].end.round() as i64),
        }
    }

    /// Returns the interval between repetitions for the robot at `index`, in nanoseconds.
    fn cycle(&self, show: &Show, index: usize) -> Ratio<i128> {
        if self.change.pause.is_none() {
            return self.lap(show, index);
        }
        let longest = match &self.beats {
            Some(keyframes) => {
                let quarters = keyframes[keyframes.len() - 1].0.most();
                show.beats(self.start(show), Ratio::from_integer(i128::from(quarters)))
            }
            None => self.lap(show, index),
        };
        longest + self.pause.of(self.robots(), index) * MS
    }

    /// Returns the length of the movement of the robot at `index` as written, with repetitions.
    pub(super) fn own_length(&self, show: &Show, index: usize) -> Nanos {
        let waits = Ratio::from_integer(i128::from(self.change.turns) - 1);
        laid(self.start(show), self.cycle(show, index) * waits + self.lap(show, index))
    }

    /// Returns the length of the cue, which is the length for the slowest robot.
    pub(super) fn length(&self, show: &Show) -> Nanos {
        (0..self.robots().len()).map(|index| self.own_length(show, index)).max().unwrap_or(0)
    }

    /// Returns each robot of the cue with its delay.
    pub(super) fn delays(&self, show: &Show) -> Vec<(usize, Nanos)> {
        let robots = self.robots();
        let delay = |(index, robot): (usize, &usize)| {
            let own = self.late.filter(|(late, _)| late == robot).map_or(0, |(_, millis)| i128::from(millis));
            let each = match self.when {
                When::Each(_, gap) => Ratio::from_integer(index as i128 * i128::from(gap) * MS),
                _ => Ratio::from_integer(0),
            };
            let canon = self.canon.map_or(Ratio::from_integer(0), |canon| canon.delay(robots, index));
            (*robot, laid(self.start(show), canon + each) + own * MS)
        };
        robots.iter().enumerate().map(delay).collect()
    }

    pub(super) fn delay(&self, show: &Show) -> Nanos {
        self.delays(show).iter().map(|(_, delay)| *delay).max().unwrap_or(0)
    }

    /// Whether all values are exact as `f64`. Otherwise, the rounding of a value in the middle between two grid values cannot be
    /// predicted.
    fn is_held_by_doubles(&self, index: usize) -> bool {
        let values = self.beats.iter().flatten().map(|(_, to)| *to);
        let mut all = values.chain(self.scale.map(|(by, _)| by));
        all.all(|each| each.of(self.robots(), index).denom().count_ones() == 1)
    }

    /// Returns the steps of the robot at `index`: time since the robot's start, value, and written value. `None` if the steps are not
    /// just the written keyframes.
    pub(super) fn as_written(&self, show: &Show, index: usize) -> Option<Vec<(Nanos, f64, f64)>> {
        let keyframes = self.own_keyframes(index)?;
        let (_, moves, granularity, _) = DEVICES[self.device];
        if self.tolerance.is_some() || self.change.backwards {
            return None;
        }
        let start = self.start(show);
        let (lap, cycle) = (self.lap(show, index), self.cycle(show, index));
        let change = self.change(show, index);
        let on_grid = |written: f64| settable(self.device).nearest(written);
        let is_held = self.is_held_by_doubles(index);
        let mut steps: Vec<(Nanos, f64, f64)> = Vec::new();
        for turn in 0..self.change.turns {
            let begin = laid(start, cycle * i128::from(turn));
            let end = laid(start, cycle * i128::from(turn) + lap);
            // An additional step keeps a device that moves from creeping to its next repetition.
            if let Some(last) = steps.last().copied()
                && moves
                && begin > last.0
                && on_grid(change.of(keyframes[0].1)) != last.1
            {
                steps.push((begin, last.1, last.2));
            }
            for (index, (quarters, value)) in keyframes.iter().enumerate() {
                let at = if index + 1 == keyframes.len() {
                    end
                } else {
                    // The lengths of repetitions differ by a nanosecond.
                    (begin + laid(start, show.beats(start, *quarters))).min(end)
                };
                let written = change.of(*value);
                if !is_held && ((written / granularity).rem_euclid(1.0) - 0.5).abs() < 1e-9 {
                    return None;
                }
                let set = on_grid(written);
                let before = steps.last().copied();
                let seam = before.is_some_and(|before| before.0 == at);
                match before {
                    // If two keyframes have the same time, a device that holds takes the later one. A device that moves drops a
                    // duplicate.
                    Some(_) if seam && !moves => *steps.last_mut()? = (at, set, written),
                    Some(before) if seam && before.1 == set => {
                        let worse = (set - written).abs() > (before.1 - before.2).abs();
                        *steps.last_mut()? = (at, set, if worse { written } else { before.2 });
                    }
                    _ => steps.push((at, set, written)),
                }
            }
        }
        if let Some((least, largest)) = self.stretch {
            if least != largest {
                return None;
            }
            let to = i128::from(least) * MS;
            for step in &mut steps {
                step.0 = rounded(Ratio::new(step.0 * to, self.length(show)));
            }
        }
        Some(steps)
    }
}

impl Canon {
    /// Returns the delay of the robot at `index`, in nanoseconds.
    fn delay(self, robots: &[usize], index: usize) -> Ratio<i128> {
        let (count, place) = (robots.len() as i128, index as i128);
        // Twice the distance of a place from the middle of the row.
        let off = |place: i128| (2 * place - (count - 1)).abs();
        let least = (0..count).map(off).min().unwrap_or(0);
        let x = |robot: &usize| PLACES[*robot];
        let first = robots.iter().map(x).min().unwrap_or(0);
        let steps = |millis: i64, steps: i128| Ratio::from_integer(steps * i128::from(millis) * MS);
        match self {
            Self::Even(step) => steps(step, place),
            Self::Growing(gap) => steps(gap, (1..=place).sum()),
            Self::Backward(step) => steps(step, count - 1 - place),
            Self::Outward(step) => steps(step, (off(place) - least) / 2),
            Self::Inward(step) => steps(step, (count - 1 - off(place)) / 2),
            Self::Ranked(step) => {
                let mut ahead: Vec<i128> =
                    robots.iter().map(x).filter(|other| *other < x(&robots[index])).collect();
                ahead.sort_unstable();
                ahead.dedup();
                steps(step, ahead.len() as i128)
            }
            // Millimetres divided by metres per second are milliseconds.
            Self::Speed(quarters) => Ratio::new((x(&robots[index]) - first) * 4 * MS, i128::from(quarters)),
            Self::Over(_) if count == 1 => Ratio::from_integer(0),
            Self::Over(millis) => Ratio::new(place * i128::from(millis) * MS, count - 1),
        }
    }
}
