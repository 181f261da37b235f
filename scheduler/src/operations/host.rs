//! Metrics and health of the robots that run in this process.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use downbeat_robot::figures::{Figures, RobotFigures};
use downbeat_robot::{Host, HostHandle, Reason};
use downbeat_scripts::shown::shown;
use urrcp::RobotId;

use super::exposition::{Page, Source};
use super::health::{Checked, Health};
use super::names;

/// Time after which the thread that moves robots is considered blocked if it does not answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Maximum number of robots that are named in a message about hardware that does not answer.
const NAMED_MAX: usize = 10;

/// The metrics of a host's robots.
pub(crate) struct HostMetrics {
    handle: HostHandle,
    figures: Arc<Figures>,
    /// The ids of the robots, in the host's order. They come from the fleet file, because several robots may share one description.
    names: Vec<RobotId>,
    is_realtime: bool,
}

impl HostMetrics {
    pub(crate) fn of(host: &Host, names: Vec<RobotId>) -> Self {
        let is_realtime = host.scheduling().is_realtime();
        Self { handle: host.handle(), figures: host.figures(), names, is_realtime }
    }

    fn each(&self, page: &mut Page, metric: &names::Metric, value: impl Fn(&RobotFigures) -> u64) {
        let robots = self.names.iter().zip(self.figures.robots());
        page.each(metric, robots.map(|(id, figures)| (id.as_str(), number(value(figures)))));
    }
}

#[expect(clippy::cast_precision_loss, reason = "exact below 2^53")]
pub(super) const fn number(count: u64) -> f64 {
    count as f64
}

impl Source for HostMetrics {
    fn write(&self, page: &mut Page) {
        page.one(&names::H_REALTIME, f64::from(u8::from(self.is_realtime)));
        page.distribution(&names::H_WAKE_UP, &self.figures.wake_up);
        let reasons: Vec<_> = Reason::ALL.iter().map(|reason| (label(*reason), *reason)).collect();
        let refusals = self.handle.refusals();
        page.each(
            &names::H_REFUSALS,
            reasons.iter().map(|(label, reason)| (label.as_str(), number(refusals.count(*reason)))),
        );
        self.each(page, &names::H_HELD, |robot| robot.counts().held);
        self.each(page, &names::H_STARTED, |robot| robot.counts().started);
        self.each(page, &names::H_ENDED, |robot| robot.counts().ended);
        self.each(page, &names::H_FAILED, |robot| robot.counts().failed);
        self.each(page, &names::H_STEPS, RobotFigures::steps);
        self.each(page, &names::H_LATE, |robot| robot.counts().late_steps);
        self.each(page, &names::H_CONNECTIONS, RobotFigures::connections);
        self.each(page, &names::H_HARDWARE, |robot| u64::from(robot.hardware_answers()));
    }
}

impl Health for HostMetrics {
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>> {
        Box::pin(async {
            let alive = if self.handle.answers_within(PATIENCE).await {
                Ok("robots: the thread that moves them is responding".to_owned())
            } else {
                Err(format!(
                    "robots: the thread that moves them has not responded within {} s",
                    PATIENCE.as_secs()
                ))
            };
            let robots = self.names.iter().zip(self.figures.robots());
            let away: Vec<_> = robots.filter(|(_, figures)| !figures.hardware_answers()).collect();
            let named: Vec<_> =
                away.iter().take(NAMED_MAX).map(|(id, _)| format!("`{}`", shown(id.as_str()))).collect();
            let ready = match away.len() {
                0 => alive.clone(),
                count => {
                    Err(format!("robots: {count} with hardware that does not respond: {}", named.join(", ")))
                }
            };
            Checked { alive, ready }
        })
    }
}

/// Converts a reason to a label in snake case: `made_room` for `MadeRoom`.
fn label(reason: Reason) -> String {
    let mut label = String::new();
    for (index, letter) in format!("{reason:?}").chars().enumerate() {
        if letter.is_ascii_uppercase() && index > 0 {
            label.push('_');
        }
        label.push(letter.to_ascii_lowercase());
    }
    label
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_labels_are_lowercase() {
        assert_eq!(label(Reason::MadeRoom), "made_room");
        assert_eq!(label(Reason::ManyFromOneHost), "many_from_one_host");
    }
}
