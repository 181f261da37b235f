//! Determines when steps of a script were late, from the counts that a robot reports while it plays.

use urrcp::{Server, Span, Timestamp};

/// The late steps of one script, as the robot reported them over time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct LateSteps {
    /// When the last report arrived.
    heard: Option<Timestamp<Server>>,
    /// Number of late steps according to the last report.
    steps: u32,
    /// The times in which the number grew, in order.
    pub(crate) grew: Vec<Lateness>,
}

/// Steps that were late between two reports of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lateness {
    /// When the last report without these steps arrived; `None` if they are in the first report.
    pub(crate) from: Option<Timestamp<Server>>,
    /// When the report with these steps arrived.
    pub(crate) to: Timestamp<Server>,
    /// Number of steps.
    pub(crate) steps: u32,
    /// The largest lateness of the script up to this report; `None` if the robot does not report it.
    pub(crate) most: Option<Span>,
}

impl LateSteps {
    /// Adds a report: `steps` were late so far, by at most `most`. Answers to several questions may repeat a report.
    pub(crate) fn report(&mut self, at: Timestamp<Server>, steps: u32, most: Option<Span>) {
        if let Some(new) = steps.checked_sub(self.steps).filter(|new| *new > 0) {
            self.grew.push(Lateness { from: self.heard, to: at, steps: new, most });
            self.steps = steps;
        }
        self.heard = self.heard.max(Some(at));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_steps_lie_between_the_last_report_without_them_and_the_first_with_them() {
        let at = |second: i64| Timestamp::from_nanos(second * 1_000_000_000);
        let most = Some(Span::from_millis(225));
        let mut late = LateSteps::default();
        late.report(at(1), 0, None);
        late.report(at(2), 0, None);
        late.report(at(3), 2, most);
        late.report(at(4), 2, most);
        late.report(at(5), 3, most);
        let grew = |from, to, steps| Lateness { from: Some(at(from)), to: at(to), steps, most };
        assert_eq!(late.grew, [grew(2, 3, 2), grew(4, 5, 1)]);
    }

    #[test]
    fn late_steps_of_the_first_report_have_no_earliest_time() {
        let mut late = LateSteps::default();
        late.report(Timestamp::from_nanos(7), 1, None);
        assert_eq!((late.grew.len(), late.grew[0].from), (1, None));
    }
}
