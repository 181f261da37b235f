//! Compares the import of tables with an independent model: random whole numbers, with times in every supported notation.

use proptest::prelude::*;
use urrcp::Span;

use super::keyframes_of;

use crate::{Course, DeviceMotion, ImportFormat, ImportOptions, TimeUnit, import_bytes};

/// The notation in which the times of a table are written.
#[derive(Clone, Copy, Debug)]
enum Clock {
    Millis,
    Seconds,
    Exponents,
    Micros,
    Frames,
    HoursMinutesSeconds,
    MinutesSecondsMillis,
    Timecode,
    Date,
    Unix,
}

/// The duration of a frame at 25 frames per second, in microseconds.
const FRAME_US: u64 = 40_000;
/// 2026-11-23T00:00:00Z, in seconds since 1970.
const DAY_S: u64 = 1_795_392_000;

impl Clock {
    fn header(self) -> &'static str {
        match self {
            Self::Millis => "Time [msec]",
            Self::Seconds | Self::Exponents => "t (s)",
            Self::Micros => "time_us",
            Self::Frames => "frame",
            _ => "when",
        }
    }

    fn unit(self) -> Option<TimeUnit> {
        match self {
            Self::HoursMinutesSeconds => Some(TimeUnit::HoursMinutesSeconds),
            Self::MinutesSecondsMillis => Some(TimeUnit::MinutesSecondsMillis),
            _ => None,
        }
    }

    fn is_counted(self) -> bool {
        matches!(self, Self::Frames | Self::Timecode)
    }

    /// Returns the smallest difference between times that the notation can express, in microseconds.
    fn step_us(self) -> u64 {
        match self {
            Self::Frames | Self::Timecode => FRAME_US,
            Self::MinutesSecondsMillis => 1_000,
            _ => 1,
        }
    }

    fn text(self, us: u64) -> String {
        let (minutes, seconds, rest) = (us / 60_000_000, us / 1_000_000 % 60, us % 1_000_000);
        match self {
            Self::Millis => format!("{}.{:03}", us / 1_000, us % 1_000),
            Self::Seconds => format!("{}.{rest:06}", us / 1_000_000),
            Self::Exponents => format!("{us}e-6"),
            Self::Micros => us.to_string(),
            Self::Frames => (us / FRAME_US).to_string(),
            Self::HoursMinutesSeconds => {
                format!("{}:{:02}:{seconds:02}.{rest:06}", minutes / 60, minutes % 60)
            }
            Self::MinutesSecondsMillis => format!("{minutes}:{seconds:02}:{:03}", rest / 1_000),
            Self::Timecode => {
                format!("{:02}:{:02}:{seconds:02}:{:02}", minutes / 60, minutes % 60, rest / FRAME_US)
            }
            Self::Date => {
                format!("2026-11-23T{:02}:{:02}:{seconds:02}.{rest:06}Z", minutes / 60, minutes % 60)
            }
            Self::Unix => format!("{}.{rest:06}", DAY_S + us / 1_000_000),
        }
    }
}

/// The values of a device, in quarters of its unit; `None` for an empty cell.
#[derive(Clone, Debug)]
enum Column {
    Straight(Vec<Option<i64>>),
    Held(Vec<Option<i64>>),
    Several(Vec<[i64; 3]>),
    /// Whole numbers that wrap around with a period of 359 ([`PERIOD`]).
    Wrapped(Vec<i64>),
}

#[derive(Clone, Debug)]
struct Table {
    clock: Clock,
    separator: char,
    /// Whether numbers are written with decimal commas. Commas do not separate cells then.
    commas: bool,
    /// The time of each line, in microseconds.
    times: Vec<u64>,
    columns: Vec<(Column, Option<i64>)>,
}

const PERIOD: i64 = 359;

fn quarters(value: i64) -> f64 {
    value as f64 / 4.0
}

impl Table {
    /// Returns the table as text, and the import options that assign its columns to devices.
    fn written(&self) -> (String, ImportOptions) {
        let mut options = ImportOptions { time_unit: self.clock.unit(), ..ImportOptions::default() };
        options.time_column = Some(self.clock.header().to_owned());
        options.rate_hz = self.clock.is_counted().then_some(25.0);
        let number = |value: i64| {
            let text = quarters(value).to_string();
            if self.commas { text.replace('.', ",") } else { text }
        };
        let mut lines: Vec<Vec<String>> = vec![vec![self.clock.header().to_owned()]];
        lines.extend(
            self.times
                .iter()
                .map(|us| vec![self.clock.text(*us).replace('.', if self.commas { "," } else { "." })]),
        );
        for (index, (column, scale)) in self.columns.iter().enumerate() {
            let device = format!("d{index}");
            let name = |part: usize| format!("col {index}.{part}");
            let cells = |row: usize| match column {
                Column::Straight(values) | Column::Held(values) => {
                    vec![values[row].map_or(String::new(), number)]
                }
                Column::Several(values) => values[row].iter().map(|value| number(*value)).collect(),
                Column::Wrapped(values) => vec![values[row].to_string()],
            };
            let names: Vec<String> = (0..cells(0).len()).map(name).collect();
            options.columns.push((format!("r/{device}"), names.join(",")));
            lines[0].extend(names);
            for (row, line) in lines[1..].iter_mut().enumerate() {
                line.extend(cells(row));
            }
            match column {
                Column::Held(_) => options.holds.push(device.clone()),
                Column::Wrapped(_) => options.unwraps.push((device.clone(), PERIOD as f64)),
                _ => {}
            }
            options.scales.extend(scale.map(|scale| (device, quarters(scale))));
        }
        let joined: Vec<String> = lines.iter().map(|line| line.join(&self.separator.to_string())).collect();
        (joined.join("\n"), options)
    }

    /// Returns the expected motion of a device: the times in microseconds, and the values multiplied by the scale.
    fn meant(&self, column: &Column, scale: Option<i64>) -> Vec<(u64, Vec<f64>)> {
        let scaled = |value: f64| value * scale.map_or(1.0, quarters);
        let timed = |values: &[Option<i64>]| {
            let there = self
                .times
                .iter()
                .zip(values)
                .filter_map(|(at, value)| Some((*at, vec![scaled(quarters((*value)?))])));
            there.collect::<Vec<_>>()
        };
        match column {
            Column::Straight(values) => timed(values),
            Column::Held(values) => changes(timed(values)),
            Column::Several(values) => {
                let values =
                    values.iter().map(|value| value.iter().map(|part| scaled(quarters(*part))).collect());
                changes(self.times.iter().copied().zip(values).collect())
            }
            Column::Wrapped(values) => {
                let mut before = values[0];
                let unwrapped = values.iter().map(|value| {
                    let turns =
                        (-100..=100).find(|turns| 2 * (value + turns * PERIOD - before).abs() < PERIOD);
                    before = value + turns.unwrap() * PERIOD;
                    vec![scaled(before as f64)]
                });
                self.times.iter().copied().zip(unwrapped).collect()
            }
        }
    }
}

/// Keeps the first and the last row, and each row whose values differ from those of the previous row.
fn changes(all: Vec<(u64, Vec<f64>)>) -> Vec<(u64, Vec<f64>)> {
    let last = all.len() - 1;
    let kept = |index: usize| index == 0 || index == last || all[index].1 != all[index - 1].1;
    (0..all.len()).filter(|index| kept(*index)).map(|index| all[index].clone()).collect()
}

fn found(device: &DeviceMotion) -> Vec<(u64, Vec<f64>)> {
    let values = |index: usize| match &device.course {
        Course::Several(all) => all[index].clone(),
        _ => vec![device.keyframes[index].value],
    };
    (0..device.keyframes.len())
        .map(|index| (device.keyframes[index].at.as_nanos() as u64 / 1_000, values(index)))
        .collect()
}

fn column(rows: usize) -> impl Strategy<Value = Column> {
    let cell =
        prop_oneof![4 => (-4_000i64..4_000).prop_map(Some), 1 => (0i64..3).prop_map(Some), 1 => Just(None)];
    // An empty column would be an error.
    let cells = prop::collection::vec(cell, rows).prop_map(|mut cells| {
        cells[0] = cells[0].or(Some(1));
        cells
    });
    let parts = [0i64..4, 0i64..4, 0i64..4];
    prop_oneof![
        cells.clone().prop_map(Column::Straight),
        cells.prop_map(Column::Held),
        prop::collection::vec(parts, rows).prop_map(Column::Several),
        prop::collection::vec(0..PERIOD, rows).prop_map(Column::Wrapped),
    ]
}

fn table() -> impl Strategy<Value = Table> {
    use Clock::{
        Date, Exponents, Frames, HoursMinutesSeconds, Micros, Millis, MinutesSecondsMillis, Seconds,
        Timecode, Unix,
    };
    let clock = prop::sample::select(vec![
        Millis,
        Seconds,
        Exponents,
        Micros,
        Frames,
        HoursMinutesSeconds,
        MinutesSecondsMillis,
        Timecode,
        Date,
        Unix,
    ]);
    let times = prop::collection::vec(1u64..200, 2..20);
    let dialect =
        prop::sample::select(vec![(',', false), (';', false), (';', true), ('\t', false), ('\t', true)]);
    (clock, dialect, times, prop::sample::select(vec![1u64, 40, 40_000, 4_000_000])).prop_flat_map(
        |(clock, (separator, commas), gaps, gap)| {
            let gap = gap.next_multiple_of(clock.step_us());
            let times: Vec<u64> =
                gaps.iter().scan(0, |now, after| Some(std::mem::replace(now, *now + after * gap))).collect();
            let scale =
                prop_oneof![2 => Just(None), 1 => prop::sample::select(vec![-8i64, 2, 6]).prop_map(Some)];
            let columns = prop::collection::vec((column(times.len()), scale), 1..6);
            columns.prop_map(move |columns| Table { clock, separator, commas, times: times.clone(), columns })
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn imported_tables_match_an_independent_reading(table in table()) {
        let (text, options) = table.written();
        let outcome = import_bytes(ImportFormat::Csv, "t.csv", text.as_bytes(), &options);
        prop_assert!(outcome.findings.is_empty(), "{text}\n{:#?}", outcome.findings);
        let imported = outcome.imported.unwrap();
        let devices: Vec<_> = imported.devices().map(|(_, device)| device).collect();
        prop_assert_eq!(devices.len(), table.columns.len());
        for (device, (column, scale)) in devices.iter().zip(&table.columns) {
            prop_assert_eq!(found(device), table.meant(column, *scale), "{} in {}", device.device, text);
        }
    }
}

#[test]
fn scene_from_mid_timeline_is_noted_and_can_start_at_once() {
    let text = "t[ms],a,b\n10000,0,\n10250,1,5\n";
    let columns = ["a", "b"].map(|name| (format!("r/{name}"), name.to_owned()));
    let options = ImportOptions { columns: columns.into(), ..ImportOptions::default() };
    let late = import_bytes(ImportFormat::Csv, "test", text.as_bytes(), &options);
    assert!(
        late.notes
            .iter()
            .any(|note| note.contains("is at 10 s, and devices move") && note.contains("--start 0s")),
        "{:?}",
        late.notes
    );
    for start in [0, 500] {
        let options = ImportOptions { start: Some(Span::from_millis(start)), ..options.clone() };
        let moved = import_bytes(ImportFormat::Csv, "test", text.as_bytes(), &options);
        assert!(!moved.notes.iter().any(|note| note.contains("--start")), "{:?}", moved.notes);
        let imported = moved.imported.unwrap();
        let start = start as f64;
        assert_eq!(keyframes_of(&imported, "a"), [(start, 0.0), (start + 250.0, 1.0)]);
        assert_eq!(keyframes_of(&imported, "b"), [(start + 250.0, 5.0)]);
    }
}
