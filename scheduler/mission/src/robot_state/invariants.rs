//! Invariants of a robot between two events.

use urrcp::{Server, Timestamp};

use super::{Link, OPEN_MAX, Questions, RobotState, Standing, Stop};
use crate::failures::KEPT_MAX;
use crate::invariants::holds;

impl RobotState {
    /// Panics if an invariant of the robot does not hold at `now`.
    pub(crate) fn check(&self, now: Timestamp<Server>) {
        let id = &self.id;
        self.contact.questions.check();
        assert_eq!(
            self.greeted.readings.len(),
            self.settings.require.len(),
            "{id}: each requirement has one reading"
        );
        if self.standing == Standing::Out {
            assert!(self.has_failed(), "{id}: only a robot that has failed is left out");
        }
        if let Link::Lost(lost) = &self.link {
            assert!(lost.since <= lost.failed, "{id}: a link breaks before it fails again");
        }
        match &self.halt.stop {
            Stop::Sent(sent) => {
                assert!(sent.at <= now, "{id}: a stop was sent in the past");
                let asked = self.requests.stops().all(|(_, device)| self.halt.touched.contains(device));
                assert!(asked, "{id}: only devices that were sent anything are stopped");
                assert!(!self.halt.at_rest, "{id}: a robot rests once it has confirmed its stop");
            }
            Stop::None | Stop::Confirmed(_) => {
                let open = self.requests.stops().count();
                assert_eq!(open, 0, "{id}: only a robot that is being stopped owes confirmations");
            }
        }
        let others = self.failures.iter().skip(KEPT_MAX).map(|failure| std::mem::discriminant(&failure.kind));
        let kinds: std::collections::HashSet<_> = others.clone().collect();
        holds!(
            others.count() == kinds.len(),
            id,
            "The report lists the first 64 failures of each robot and the first of each kind"
        );
        holds!(
            self.halt.elsewhere.is_none() || !self.in_process,
            id,
            "another process may have answered in its place while the first one still runs the script"
        );
        if self.greeted.introduced {
            assert!(
                self.block.is_some(),
                "{id}: a robot that has introduced itself must have an initialization block"
            );
        }
        if self.pose.asked.is_some() {
            assert!(self.block.is_some(), "{id}: positions are those of devices that are known");
        }
        let totals = &self.totals;
        assert!(totals.sent <= totals.scripts, "{id}: at most the planned scripts are sent");
        assert!(totals.started <= totals.scripts, "{id}: at most the planned scripts start");
        assert!(totals.accepted <= totals.scripts, "{id}: at most the planned scripts are accepted");
        assert!(totals.failed <= totals.scripts, "{id}: at most the planned scripts fail");
        assert!(
            totals.unaccounted <= totals.scripts,
            "{id}: at most the planned scripts are unaccounted for"
        );
    }
}

impl Questions {
    fn check(&self) {
        assert!(self.open.len() <= OPEN_MAX, "few questions are remembered");
        assert!(self.open.iter().is_sorted(), "questions are asked in order of time");
        let oldest = self.open.front().copied();
        assert!(
            oldest.is_none_or(|open| self.answered <= Some(open)),
            "no open question is older than the newest answered one"
        );
        assert!(self.last_asked() >= self.answered, "only a question that was asked is answered");
    }
}
