//! Draws random shows of acts.

use proptest::prelude::*;

use super::{Act, Cue, DEVICES, Lease, Show, Target, Waits, Word};

fn words() -> impl Strategy<Value = Word> {
    prop::sample::select(vec![Word::Stop, Word::Home, Word::Without])
}

/// Draws the target of a transition, usually an act. The show may have fewer acts than the drawn index requires.
fn targets() -> impl Strategy<Value = Target> {
    prop_oneof![
        40 => (0usize..6).prop_map(Target::Act),
        10 => Just(Target::End),
        1 => Just(Target::Nowhere),
    ]
}

/// Draws a value of a device: usually on its grid, rarely off the grid, and very rarely outside the limits.
fn values(device: usize) -> impl Strategy<Value = f64> {
    let kind = &DEVICES[device];
    let ([min, max], step) = (kind.limits, kind.granularity);
    let hundredths = |value: f64| (value * 100.0).round() / 100.0;
    prop_oneof![
        120 => prop::sample::select(kind.values.to_vec()),
        30 => (-3i32..4).prop_map(move |k| hundredths(8.0 + f64::from(k) * step).clamp(min, max)),
        4 => (1i32..100).prop_map(move |part| hundredths(4.0 + step * f64::from(part) / 100.0)),
        2 => prop::sample::select(vec![min, max]),
        1 => (1i32..60).prop_map(move |part| hundredths(max + step * f64::from(part) / 50.0)),
    ]
}

fn cue() -> impl Strategy<Value = Cue> {
    let device = 0..DEVICES.len();
    let moving = (device, prop::bool::weighted(0.15)).prop_flat_map(|(device, by_speed)| {
        let by_speed = by_speed && DEVICES[device].speed.is_some();
        let value = match by_speed {
            // The limits of scripts bound speeds as well.
            true if device == 0 => prop::sample::select(vec![0.0, 0.0, 5.0, -10.0, 20.0]).boxed(),
            true => prop::sample::select(vec![0.0, 5.0, 20.0]).boxed(),
            false => values(device).boxed(),
        };
        let begin = prop_oneof![3 => Just(0i64), 1 => prop::sample::select(vec![500, 1_000, 2_000])];
        let after = prop::sample::select(vec![1_000i64, 2_000, 4_000]);
        (Just((device, by_speed)), begin, prop::collection::vec((after, value), 1..4))
    });
    let gap = prop::sample::select(vec![0i64, 0, 100, 700]);
    (1usize..8, moving, gap).prop_map(|(some, ((device, by_speed), begin, all), gap)| {
        let robots = (0..3).filter(|robot| some >> robot & 1 == 1).collect();
        let mut now = begin;
        let keyframes = all.into_iter().enumerate().map(|(index, (after, value))| {
            now += if index == 0 { 0 } else { after };
            (now, value)
        });
        Cue { robots, device, at: gap, keyframes: keyframes.collect(), by_speed }
    })
}

fn act() -> impl Strategy<Value = Act> {
    let waits = prop_oneof![
        8 => Just(Waits::Done),
        3 => Just(Waits::Operator),
        1 => Just(Waits::Time),
        2 => prop_oneof![8 => 0u32..9, 1 => 9u32..12].prop_map(Waits::Above),
    ];
    let waits = prop_oneof![60 => waits, 1 => Just(Waits::Nothing)];
    let otherwise = prop_oneof![2 => Just(None), 1 => targets().prop_map(Some)];
    let next = prop_oneof![3 => Just(None), 2 => targets().prop_map(Some)];
    let default = prop_oneof![2 => Just(None), 1 => words().prop_map(Some)];
    let one = prop::collection::vec((0usize..3, words()), 0..3);
    let then = prop_oneof![2 => Just(None), 1 => (0usize..6).prop_map(Some)];
    (waits, otherwise, next, (default, one, then), prop::collection::vec(cue(), 1..5)).prop_map(
        |(waits, otherwise, next, (default, mut words, then), mut cues)| {
            words.sort_by_key(|(robot, _)| *robot);
            words.dedup_by_key(|(robot, _)| *robot);
            let mut now = 0;
            for cue in &mut cues {
                // A single value occupies some time, so that no two values are set at the same time.
                cue.at += now;
                now = cue.end() + if cue.keyframes.len() == 1 { 100 } else { 0 };
            }
            Act { waits, otherwise, next, default, words, then, cues }
        },
    )
}

pub(in crate::tests) fn shows() -> impl Strategy<Value = Show> {
    let lease =
        prop_oneof![2 => Just(Lease::Usual), 2 => Just(Lease::None), 1 => (1i64..20_000).prop_map(Lease::Of)];
    let default = prop_oneof![3 => Just(None), 1 => words().prop_map(Some)];
    (any::<bool>(), lease, default, prop::collection::vec(act(), 1..6)).prop_map(
        |(snap, lease, default, mut acts)| {
            let count = acts.len();
            let within = |target: &mut Target| {
                if let Target::Act(act) = target {
                    *act %= count;
                }
            };
            for act in &mut acts {
                act.next.as_mut().into_iter().chain(&mut act.otherwise).for_each(within);
                act.then = act.then.map(|then| then % count);
            }
            Show { snap, lease, default, acts }
        },
    )
}
