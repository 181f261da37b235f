//! Prints the spread and the lateness of starts.

use std::fmt::Write;

use super::witness::Witness;

/// Start of one robot.
#[derive(Clone, Copy)]
pub struct Start {
    pub true_ns: i64,
    /// Time from the planned to the actual start, by the robot's own clock, in nanoseconds.
    pub late_ns: i64,
}

/// The starts of one mission, earliest first.
pub type Round = Vec<Start>;

/// The lateness of each start and the spread of each mission, in milliseconds and in ascending order.
pub struct Measured {
    late: Vec<f64>,
    spreads: Vec<f64>,
}

impl Measured {
    pub fn of<'a>(rounds: impl Iterator<Item = &'a Round> + Clone) -> Self {
        let spread = |starts: &Round| {
            let instants = || starts.iter().map(|start| start.true_ns);
            millis(instants().max().unwrap() - instants().min().unwrap())
        };
        let mut spreads: Vec<_> = rounds.clone().map(spread).collect();
        let mut late: Vec<_> = rounds.flatten().map(|start| millis(start.late_ns)).collect();
        spreads.sort_by(f64::total_cmp);
        late.sort_by(f64::total_cmp);
        Self { late, spreads }
    }

    /// Prints a row of the table. Do not use it for starts on receipt, whose lateness has no meaning.
    pub fn row(&self, name: &str) {
        println!("  {name:<44}{}   {}", percentiles(&self.spreads), percentiles(&self.late));
    }

    /// Prints a row without lateness, for starts that have no planned time.
    pub fn row_of_spreads(&self, name: &str) {
        println!("  {name:<44}{}", percentiles(&self.spreads));
    }
}

/// Prints a row for all missions and, with a witness, a row for those in which no core was taken away.
pub fn rows(name: &str, rounds: &[Round], witness: Option<&Witness>) {
    Measured::of(rounds.iter()).row(name);
    if let Some(witness) = witness {
        let is_undisturbed = |round: &&Round| !witness.taken_at(round[0].true_ns).disturbs();
        let undisturbed = rounds.iter().filter(is_undisturbed);
        let taken = rounds.len() - undisturbed.clone().count();
        Measured::of(undisturbed).row(&format!("  without {taken} with a core taken away"));
    }
}

/// Returns one line per mission, for other programs.
pub fn raw(name: &str, rounds: &[Round], witness: Option<&Witness>) -> String {
    let mut lines = String::new();
    for round in rounds {
        let taken = witness.map(|witness| witness.taken_at(round[0].true_ns)).unwrap_or_default();
        write!(lines, "{name}\t{}\t{}", taken.by_host.as_micros(), taken.by_others.as_micros()).unwrap();
        round.iter().for_each(|start| write!(lines, "\t{}:{}", start.true_ns, start.late_ns).unwrap());
        lines.push('\n');
    }
    lines
}

fn millis(nanos: i64) -> f64 {
    nanos as f64 / 1e6
}

fn percentiles(sorted: &[f64]) -> String {
    if sorted.is_empty() {
        return format!("{:>36}", "-");
    }
    // Nearest rank: the p99 of 100 values is the second largest.
    let rank = |percent: usize| sorted[(sorted.len() * percent).div_ceil(100) - 1];
    [50, 90, 99, 100].map(|percent| format!("{:>9.3}", rank(percent))).concat()
}
