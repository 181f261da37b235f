//! Judges the requirements of a scenario (`require`) by the figures of its trials. A requirement without a figure is neither met nor
//! unmet.

use downbeat_plan::{Ceiling, Choreography, Floor, Requirements, Share};
use serde::Serialize;
use urrcp::Span;

/// The figures by which the requirements of a scenario are judged; each is `None` if unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Number of trials that were played. `None` for a single dry run, whose only spread may be in `spread_max`.
    pub trials: Option<u64>,
    /// The median true spread of starts: half of the trials do not exceed it.
    pub spread_p50: Option<Span>,
    /// The true spread of starts that 99 of 100 trials do not exceed.
    pub spread_p99: Option<Span>,
    /// The largest true spread of starts in any trial.
    pub spread_max: Option<Span>,
    /// Number of trials in which the mission started.
    pub starts: Option<u64>,
    /// Number of trials whose mission had the outcome `done`.
    pub finishes: Option<u64>,
    /// The closest approach of any two bodies, in metres from surface to surface.
    pub closest: Option<f64>,
}

/// A requirement with its result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// The key of the requirement under `require`.
    pub requirement: &'static str,
    /// The kind of the bound: `below`, `at most`, `above` or `at least`.
    pub bound: &'static str,
    /// The value of the bound, in `unit`.
    pub value: f64,
    /// The unit of `value` and `found`: `ms`, `m`, or `%` of the trials.
    pub unit: &'static str,
    /// The figure that is compared with the bound, in `unit`; `None` if unknown.
    pub found: Option<f64>,
    /// Whether the requirement is satisfied.
    pub result: Judgement,
    /// A limitation of the result, as text for users; `None` if there is no limitation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// Whether a requirement is satisfied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Judgement {
    /// The figure is within the bound.
    Met,
    /// The figure is outside the bound.
    NotMet,
    /// The figure is unknown.
    NotKnown,
}

impl Judgement {
    const fn of(holds: bool) -> Self {
        if holds { Self::Met } else { Self::NotMet }
    }

    /// The judgement as text for users.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::NotMet => "NOT MET",
            Self::NotKnown => "not known",
        }
    }
}

/// The closest approach of any two bodies, if it suffices to judge the requirement. `None` if it meets the requirement, but a body at an
/// unknown position might come closer.
#[must_use]
pub fn closest_of(choreography: &Choreography) -> Option<f64> {
    let (_, closest) = choreography.closest()?;
    let holds = choreography.requirements.closest.is_none_or(|floor| floor.holds(closest.distance));
    let all_known = choreography.acts.iter().all(|act| act.in_space.unknown.is_empty());
    (all_known || !holds).then_some(closest.distance)
}

/// Each requirement with its result, in the order of the documentation.
#[must_use]
pub fn judge(requirements: &Requirements, figures: &Figures) -> Vec<Judged> {
    let spreads = [
        ("spread_p50", requirements.spread_p50, figures.spread_p50),
        ("spread_p99", requirements.spread_p99, figures.spread_p99),
        ("spread_max", requirements.spread_max, figures.spread_max),
    ];
    let spreads = spreads
        .into_iter()
        .filter_map(|(name, bound, found)| bound.map(|bound| of_spread(name, bound, found, figures.trials)));
    let shares = [
        ("starts", requirements.starts, figures.starts),
        ("finishes", requirements.finishes, figures.finishes),
    ];
    let shares = shares.into_iter().filter_map(|(name, bound, count)| {
        bound.map(|bound| of_share(name, bound, count.zip(figures.trials)))
    });
    let closest = requirements.closest.map(|bound| of_closest(bound, figures.closest));
    spreads.chain(shares).chain(closest).collect()
}

/// Whether a requirement is known to be unmet.
#[must_use]
pub fn any_unmet(judged: &[Judged]) -> bool {
    judged.iter().any(|judged| judged.result == Judgement::NotMet)
}

fn of_spread(requirement: &'static str, bound: Ceiling, found: Option<Span>, trials: Option<u64>) -> Judged {
    let note = match (found, trials) {
        (None, None) if requirement != "spread_max" => Some(NEEDS_TRIALS.to_owned()),
        (None, _) => Some("not every robot started, so there is no spread".to_owned()),
        (Some(_), None) => Some("from one run; play several with --trials".to_owned()),
        (Some(_), Some(trials)) if requirement == "spread_p99" && trials < 100 => {
            Some(format!("largest of {trials} trials; the 99th percentile requires at least 100"))
        }
        (Some(_), Some(_)) => None,
    };
    Judged {
        requirement,
        bound: bound.word(),
        value: bound.bound().as_millis_f64(),
        unit: "ms",
        found: found.map(Span::as_millis_f64),
        result: found.map_or(Judgement::NotKnown, |found| Judgement::of(bound.holds(found))),
        note,
    }
}

const NEEDS_TRIALS: &str = "cannot be determined from one run; play several with --trials";

fn of_share(requirement: &'static str, bound: Floor<Share>, found: Option<(u64, u64)>) -> Judged {
    let found = found.filter(|(_, trials)| *trials > 0);
    let result =
        found.map_or(Judgement::NotKnown, |(count, trials)| Judgement::of(bound.holds(count, trials)));
    let note = match found {
        None => Some(NEEDS_TRIALS.to_owned()),
        Some((count, trials)) => (count == trials).then(|| too_few(bound.bound(), trials)).flatten(),
    };
    Judged {
        requirement,
        bound: bound.word(),
        value: bound.bound().percent(),
        unit: "%",
        found: found.map(|(count, trials)| percent(count, trials)),
        result,
        note,
    }
}

/// A note if there are too few trials, by the rule of three: if none of n trials fails, the share of failures is below 3/n with 95 %
/// confidence (Hanley and Lippman-Hand, JAMA 1983).
fn too_few(bound: Share, trials: u64) -> Option<String> {
    let failing = u64::from(1_000_000_000 - bound.billionths());
    let needed = 3_000_000_000_u64.div_ceil(failing.max(1));
    (failing > 0 && trials < needed).then(|| {
        format!("none of {trials} trials failed, but {needed} trials are required for 95 % confidence")
    })
}

#[expect(clippy::cast_precision_loss, reason = "shown to people; the comparison is exact")]
fn percent(count: u64, all: u64) -> f64 {
    count as f64 * 100.0 / all as f64
}

fn of_closest(bound: Floor<f64>, found: Option<f64>) -> Judged {
    let unknown =
        "the fleet file does not define the position and the size of every body, or robots were left out";
    Judged {
        requirement: "closest",
        bound: bound.word(),
        value: bound.bound(),
        unit: "m",
        found,
        result: found.map_or(Judgement::NotKnown, |found| Judgement::of(bound.holds(found))),
        note: found.is_none().then(|| unknown.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn millis(millis: i64) -> Span {
        Span::from_millis(millis)
    }

    fn all() -> Requirements {
        Requirements {
            spread_p50: Some(Ceiling::Below(millis(1))),
            spread_p99: Some(Ceiling::Below(millis(5))),
            spread_max: Some(Ceiling::AtMost(millis(9))),
            starts: Some(Floor::Above(Share::from_billionths(999_000_000))),
            finishes: Some(Floor::AtLeast(Share::from_billionths(990_000_000))),
            closest: Some(Floor::Above(0.3)),
            all_or_none: None,
        }
    }

    fn results(figures: &Figures) -> Vec<(&'static str, Judgement)> {
        judge(&all(), figures).into_iter().map(|judged| (judged.requirement, judged.result)).collect()
    }

    #[test]
    fn unset_requirements_are_not_judged() {
        assert_eq!(judge(&Requirements::default(), &Figures::default()), []);
    }

    #[test]
    fn requirements_without_figures_are_unknown_with_a_reason() {
        let judged = judge(&all(), &Figures::default());
        assert_eq!(judged.len(), 6);
        assert!(judged.iter().all(|judged| judged.result == Judgement::NotKnown && judged.note.is_some()));
        assert!(!any_unmet(&judged));
    }

    #[test]
    fn trials_judge_every_requirement() {
        let figures = Figures {
            trials: Some(1_000),
            spread_p50: Some(millis(1)),
            spread_p99: Some(millis(4)),
            spread_max: Some(millis(9)),
            starts: Some(999),
            finishes: Some(990),
            closest: Some(0.31),
        };
        use Judgement::{Met, NotMet};
        let expected = [
            ("spread_p50", NotMet),
            ("spread_p99", Met),
            ("spread_max", Met),
            ("starts", NotMet),
            ("finishes", Met),
            ("closest", Met),
        ];
        assert_eq!(results(&figures), expected);
        assert!(any_unmet(&judge(&all(), &figures)));
    }

    #[test]
    fn single_run_has_one_spread_and_the_note_states_it() {
        let figures = Figures { spread_max: Some(millis(2)), ..Figures::default() };
        let judged = judge(&all(), &figures);
        assert_eq!(judged[1].result, Judgement::NotKnown);
        assert_eq!((judged[2].result, judged[2].found), (Judgement::Met, Some(2.0)));
        assert!(judged[2].note.as_ref().is_some_and(|note| note.contains("one run")));
    }

    #[test]
    fn too_few_trials_without_failure_report_the_number_needed() {
        let note = |trials| {
            let figures = Figures { trials: Some(trials), starts: Some(trials), ..Figures::default() };
            judge(&all(), &figures)[3].note.clone()
        };
        assert!(note(100).is_some_and(|note| note.contains("3000")), "{:?}", note(100));
        assert_eq!(note(3_000), None);
    }
}
