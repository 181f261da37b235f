//! Draws random shows of acts, cues and relations.

use proptest::prelude::*;

use super::super::verified::{Change, Movement, changes, movements, tolerances};
use super::spread::{By, Direction, Each, Ease, Share};
use super::{Canon, Cue, DEVICES, LAMP, Lag, NAMES, ROBOTS, Relation, Show, Tempo, When, Word};

/// Draws an order of the robots in a cue: the property by which they are ordered, and the direction.
fn orders() -> impl Strategy<Value = (By, Direction)> {
    let by = prop_oneof![2 => Just(By::Index), 1 => Just(By::X), 1 => (-9i64..15).prop_map(|x| By::Point(100 * x))];
    let directions = [Direction::Forward, Direction::Backward, Direction::Outward, Direction::Inward];
    (by, prop::sample::select(directions.to_vec()))
}

/// Draws a number that differs between robots. Times are drawn so that their fractions stay short enough for all calculations with them.
fn differing(range: std::ops::Range<i64>, is_time: bool) -> impl Strategy<Value = Each> {
    let shares = prop_oneof![
        Just(Share::Index),
        Just(Share::Part),
        Just(Share::Left),
        (0u64..99).prop_map(Share::Random)
    ];
    let eases = [Ease::Linear, Ease::Step, Ease::Smooth, Ease::Cubic];
    let eases = prop::sample::select(eases[..if is_time { 2 } else { 4 }].to_vec());
    let seeds = prop_oneof![4 => Just(None), 1 => (0u64..99).prop_map(Some)];
    let expression = (range.clone(), range.clone(), shares).prop_map(move |(from, by, share)| {
        let share = if is_time && matches!(share, Share::Random(_)) { Share::Index } else { share };
        Each::Expression { from, by, share }
    });
    let spread = (range.clone(), range, orders(), eases, seeds).prop_map(
        move |(from, to, (by, direction), ease, seed)| match seed {
            Some(seed) if !is_time => {
                Each::Spread { from, to, by: By::Random(seed), direction, ease: Ease::Linear }
            }
            _ => Each::Spread { from, to, by, direction, ease },
        },
    );
    prop_oneof![1 => expression, 2 => spread]
}

/// Draws keyframes at quarters of a beat. The device plays them without further steps.
fn musical() -> impl Strategy<Value = Vec<(Each, Each)>> {
    let value = prop_oneof![3 => (-80i64..80).prop_map(Each::Same), 1 => differing(-80..80, false)];
    let last = prop_oneof![4 => (1i64..9).prop_map(Each::Same), 1 => differing(1..9, true)];
    (prop::collection::vec((1i64..9, value.clone()), 1..6), last, value).prop_map(|(all, last, value)| {
        let (mut now, mut keyframes) = (0, Vec::new());
        for (index, (after, value)) in all.into_iter().enumerate() {
            now += if index == 0 { 0 } else { after };
            keyframes.push((Each::Same(now), value));
        }
        keyframes.push((last.plus(now), value));
        keyframes
    })
}

/// Draws a single keyframe at the start of the cue, which sets a value without a movement.
fn instant() -> impl Strategy<Value = Vec<(Each, Each)>> {
    (-9i64..9).prop_map(|value| vec![(Each::Same(0), Each::Same(8 * value))])
}

/// Draws keyframes with several values each.
fn colourful() -> impl Strategy<Value = (Movement, Vec<(i64, [f64; 3])>)> {
    let part = || (0i32..256).prop_map(f64::from);
    prop::collection::vec((1i64..900, [part(), part(), part()]), 2..9).prop_map(|all| {
        let mut now = 0;
        let mut colours = Vec::new();
        for (index, (after, values)) in all.into_iter().enumerate() {
            now += if index == 0 { 0 } else { after };
            colours.push((now, values));
        }
        let text: Vec<String> =
            colours.iter().map(|(at, to)| format!("{{at: {at}ms, to: {to:?}}}")).collect();
        let first: Vec<(f64, f64)> = colours.iter().map(|(at, to)| (*at as f64, to[0])).collect();
        let movement = Movement::of_keyframes(&format!("keyframes: [{}]", text.join(", ")), false, &first);
        (movement, colours)
    })
}

fn tempos() -> impl Strategy<Value = Vec<Tempo>> {
    let signature = prop::option::of((2i64..8, prop_oneof![Just(4i64), Just(8)]));
    let one = (1i64..4, 4_000i64..24_000, signature);
    prop_oneof![3 => prop::collection::vec(one.clone(), 1), 1 => prop::collection::vec(one, 2..4)].prop_map(
        |all| {
            let (mut bar, mut tempos) = (1, Vec::new());
            for (after, bpm, signature) in all {
                bar += if tempos.is_empty() { 0 } else { after };
                tempos.push(Tempo { bar, bpm, signature });
            }
            tempos
        },
    )
}

/// Gives a cue a fixed start if it has times in beats. Such times require a fixed start if the tempo changes.
fn with_fixed_start(cue: &mut Cue, bar: i64) {
    for relation in &mut cue.relations {
        if matches!(relation.lag, Lag::Beats(_)) {
            relation.lag = Lag::None;
        }
    }
    if cue.beats.is_some() && !matches!(cue.when, When::At(_) | When::Each(..) | When::Bar(_)) {
        cue.when = When::Bar(bar);
        cue.relations.clear();
    }
}

fn lags() -> impl Strategy<Value = Lag> {
    prop_oneof![
        2 => Just(Lag::None),
        2 => (-3_000i64..4_000).prop_map(Lag::One),
        1 => (-3_000i64..3_000, 0i64..3_000).prop_map(|(least, more)| Lag::Range(least, least + more)),
        1 => (1i64..9).prop_map(Lag::Beats),
    ]
}

fn relations() -> impl Strategy<Value = Vec<(Word, usize, Option<bool>, Lag)>> {
    let word = prop_oneof![6 => Just(Word::After), 2 => Just(Word::With), 1 => Just(Word::Before)];
    let end = prop_oneof![3 => Just(None), 1 => any::<bool>().prop_map(Some)];
    let one = (word, 0usize..6, end, lags()).boxed();
    prop_oneof![
        3 => Just(Vec::new()),
        5 => prop::collection::vec(one.clone(), 1),
        1 => prop::collection::vec(one, 2..4),
    ]
}

fn canons() -> impl Strategy<Value = Canon> {
    let forms = [
        Canon::Even,
        Canon::Growing,
        Canon::Backward,
        Canon::Outward,
        Canon::Inward,
        Canon::Ranked,
        Canon::Speed,
        Canon::Over,
    ];
    (prop::sample::select(forms.to_vec()), 1i64..900).prop_map(|(form, amount)| form(amount))
}

fn cue() -> impl Strategy<Value = Cue> {
    let device = 0..DEVICES.len();
    let moving = device.prop_flat_map(|device| {
        let moves = DEVICES[device].1;
        let any = movements(moves).prop_map(|movement| (movement, None, None)).boxed();
        let nothing = Movement::of_keyframes("", moves, &[]);
        let in_beats = move |beats| (nothing.clone(), Some(beats), None);
        let (musical, instant) =
            (musical().prop_map(in_beats.clone()).boxed(), instant().prop_map(in_beats).boxed());
        let movement = match device {
            LAMP => colourful().prop_map(|(movement, colours)| (movement, None, Some(colours))).boxed(),
            _ => prop_oneof![3 => any, 3 => musical, 1 => instant].boxed(),
        };
        (Just(device), movement)
    });
    let reads = prop_oneof![4 => Just(Vec::new()), 1 => prop::collection::vec(0i64..3_000, 1..3)];
    let when = prop_oneof![
        12 => Just(When::Free),
        2 => (0i64..9_000).prop_map(When::At),
        1 => (0i64..9_000, 0i64..900).prop_map(|(first, gap)| When::Each(first, gap)),
        1 => (0i64..9_000, 0i64..4_000).prop_map(|(least, more)| When::Between(least, least + more)),
        1 => (1i64..6).prop_map(When::Bar),
        1 => (9_000i64..90_000).prop_map(When::EndBy),
    ];
    let stretch = prop_oneof![4 => Just(None), 1 => (700i64..20_000, 0i64..2).prop_map(|(least, more)| Some((least, least + more * 2_000)))];
    let tolerance = tolerances();
    let canon = prop_oneof![2 => Just(None), 1 => canons().prop_map(Some)];
    let late = prop_oneof![3 => Just(None), 1 => (0usize..ROBOTS.len(), 0i64..900).prop_map(Some)];
    let zone = prop_oneof![2 => Just(None), 1 => (0usize..2).prop_map(Some)];
    let pause = prop_oneof![2 => (0i64..900).prop_map(Each::Same), 1 => differing(0..900, true)];
    let scale = prop_oneof![3 => Just(None), 1 => (differing(-8..9, false), -10i64..11).prop_map(Some)];
    let apart = prop_oneof![6 => Just(None), 1 => (0usize..6).prop_map(Some)];
    (
        (0..NAMES.len(), moving, changes(), tolerance),
        (canon, late, stretch, when, (pause, scale)),
        (relations(), zone, apart, (prop::bool::weighted(0.4), any::<bool>(), any::<Option<bool>>()), reads),
    )
        .prop_map(
            |(
                (who, (device, (movement, beats, colours)), change, tolerance),
                (canon, late, stretch, when, (pause, scale)),
                (relations, zone, apart, (by_move, composed, parameters), reads),
            )| {
                let mut change = change;
                // The duration applies to the cue instead.
                change.yaml = change.yaml.split(", duration").next().unwrap_or_default().to_owned();
                change.duration = None;
                // Several values cannot be scaled or repeated.
                if colours.is_some() {
                    change = Change::none();
                }
                // A single value cannot be repeated or stretched, either.
                let is_instant = beats.as_ref().is_some_and(|beats| beats.len() == 1);
                if is_instant {
                    change = Change::none();
                }
                let stretch = stretch.filter(|_| !is_instant);
                let when = match when {
                    // Multiples of 500 ms make several of these cues coincide.
                    When::At(millis) if is_instant => When::At(millis / 3_000 * 500),
                    _ => when,
                };
                let scale = scale.filter(|_| colours.is_none() && !change.yaml.contains("scale"));
                let relation = |(word, other, end, lag)| Relation { word, other, end, lag };
                let relations = relations.into_iter().map(relation).collect();
                let late = late.filter(|(robot, _)| NAMES[who].1.contains(robot));
                Cue {
                    who,
                    device,
                    movement,
                    beats,
                    colours,
                    reads,
                    change,
                    pause,
                    scale,
                    tolerance,
                    canon,
                    late,
                    stretch,
                    when,
                    relations,
                    zone,
                    apart,
                    by_move,
                    composed,
                    parameters,
                }
            },
        )
}

fn acts() -> impl Strategy<Value = Vec<Vec<Cue>>> {
    let act = prop::collection::vec(cue(), 1..6).prop_map(|mut cues| {
        let count = cues.len();
        for (index, cue) in cues.iter_mut().enumerate() {
            // Relations refer to existing cues. Relations to later cues are rare, because they often create a cycle.
            cue.relations.retain_mut(|relation| {
                relation.other = if relation.other == 5 && index % 2 == 0 {
                    (index + 1) % count
                } else {
                    relation.other % index.max(1)
                };
                relation.other != index
            });
            cue.apart = cue.apart.map(|other| other % count).filter(|other| *other != index);
        }
        cues
    });
    prop::collection::vec(act, 1..4)
}

pub(super) fn shows() -> impl Strategy<Value = Show> {
    (tempos(), any::<bool>(), [0.3, 0.3].map(prop::bool::weighted), acts()).prop_map(
        |(tempos, auto, [by_sequence, by_include], mut acts)| {
            let probe = Show { tempos, auto, acts: Vec::new(), by_sequence, by_include };
            for (index, cue) in acts.iter_mut().flatten().enumerate() {
                if probe.tempos.len() > 1 {
                    with_fixed_start(cue, 1 + index as i64 % 6);
                }
            }
            Show { acts, ..probe }
        },
    )
}
