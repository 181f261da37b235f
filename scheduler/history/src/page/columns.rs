//! Encodes columns of numbers for the page, as bytes after the JSON. The encoding is compact if the numbers have few decimals and change
//! little.

use std::collections::HashMap;

use serde::Serialize;

/// Limit up to which a 64-bit float represents integers exactly.
const EXACT_MAX: f64 = 9_007_199_254_740_992.0;
/// Maximum number of decimals, which is more than any device needs.
const DECIMALS_MAX: u8 = 9;

/// The location and format of a column's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Column {
    /// Offset of the column's first byte.
    at: usize,
    /// Number of entries.
    n: usize,
    /// Number of decimals. Each number is multiplied by 10 to the power of `decimals`, and stored as the difference of this integer from
    /// its prediction. `None` if the numbers are stored as little-endian 64-bit floats.
    decimals: Option<u8>,
    order: Order,
}

/// How an integer of a column is predicted from earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "u8")]
pub(super) enum Order {
    /// The prediction is the previous integer.
    Level,
    /// The prediction is the previous integer plus its difference from the one before.
    Trend,
}

impl From<Order> for u8 {
    fn from(order: Order) -> Self {
        match order {
            Order::Level => 1,
            Order::Trend => 2,
        }
    }
}

/// The location of values over time: a column of times and a column of values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Series {
    t: Column,
    v: Column,
}

/// Values at times in milliseconds, which never decrease.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Points {
    times: Vec<f64>,
    values: Vec<f64>,
}

impl Points {
    pub(super) fn push(&mut self, at: f64, value: f64) {
        self.times.push(at);
        self.values.push(value);
    }

    /// Shifts all times by `by` milliseconds.
    pub(super) fn shift(&mut self, by: f64) {
        self.times.iter_mut().for_each(|at| *at += by);
    }
}

impl FromIterator<(f64, f64)> for Points {
    fn from_iter<I: IntoIterator<Item = (f64, f64)>>(points: I) -> Self {
        let (times, values) = points.into_iter().unzip();
        Self { times, values }
    }
}

/// The bytes of all columns. Equal columns are stored once, because robots that move in unison play the same steps.
#[derive(Debug, Default)]
pub(super) struct Columns {
    bytes: Vec<u8>,
    known: HashMap<Vec<u8>, usize>,
}

impl Columns {
    pub(super) fn series(&mut self, points: &Points) -> Series {
        Series { t: self.column(&points.times, Order::Trend), v: self.column(&points.values, Order::Level) }
    }

    fn column(&mut self, numbers: &[f64], order: Order) -> Column {
        let decimals = decimals(numbers);
        let bytes = match decimals {
            Some(decimals) => differences(numbers, decimals, order),
            None => numbers.iter().flat_map(|number| number.to_le_bytes()).collect(),
        };
        let next = self.bytes.len();
        let all = &mut self.bytes;
        let at = *self.known.entry(bytes).or_insert_with_key(|bytes| {
            all.extend_from_slice(bytes);
            next
        });
        Column { at, n: numbers.len(), decimals, order }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

fn power(decimals: u8) -> f64 {
    10.0_f64.powi(i32::from(decimals))
}

/// Returns the number times 10 to the power of `decimals` as an integer. `None` if dividing that integer by the power does not reproduce
/// the number exactly.
fn scaled(number: f64, decimals: u8) -> Option<i64> {
    let integer = (number * power(decimals)).round();
    let integer = Some(integer).filter(|integer| integer.abs() < EXACT_MAX)? as i64;
    // The bits are compared because no integer represents minus zero.
    ((integer as f64 / power(decimals)).to_bits() == number.to_bits()).then_some(integer)
}

/// Returns the minimum number of decimals that represents all numbers exactly; `None` if no number of decimals suffices.
fn decimals(numbers: &[f64]) -> Option<u8> {
    let mut decimals = 0;
    for number in numbers {
        decimals = (decimals..=DECIMALS_MAX).find(|more| scaled(*number, *more).is_some())?;
    }
    // Large numbers may not be exact with the decimals of small ones.
    numbers.iter().all(|number| scaled(*number, decimals).is_some()).then_some(decimals)
}

fn differences(numbers: &[f64], decimals: u8, order: Order) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(numbers.len() * 2);
    let (mut last, mut trend) = (0_i64, 0_i64);
    for integer in numbers.iter().filter_map(|number| scaled(*number, decimals)) {
        put(&mut bytes, integer - last - trend);
        if order == Order::Trend {
            trend = integer - last;
        }
        last = integer;
    }
    bytes
}

/// Appends a number as a zigzag LEB128 varint.
fn put(bytes: &mut Vec<u8>, difference: i64) {
    let mut rest = ((difference << 1) ^ (difference >> 63)).cast_unsigned();
    while rest >= 0x80 {
        bytes.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    bytes.push(rest as u8);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Decodes a column in the same way as the page.
    fn read(columns: &Columns, column: Column) -> Vec<f64> {
        let bytes = &columns.bytes()[column.at..];
        let Some(decimals) = column.decimals else {
            let eight = bytes.chunks_exact(8).take(column.n);
            return eight.map(|eight| f64::from_le_bytes(eight.try_into().unwrap())).collect();
        };
        let (mut at, mut last, mut trend) = (0, 0_i64, 0_i64);
        let mut next = || {
            let (mut shift, mut value) = (0, 0_u64);
            loop {
                let byte = bytes[at];
                at += 1;
                value |= u64::from(byte & 0x7f) << shift;
                shift += 7;
                if byte < 0x80 {
                    break;
                }
            }
            let difference = (value >> 1).cast_signed() ^ -(value & 1).cast_signed();
            let integer = last + trend + difference;
            if column.order == Order::Trend {
                trend = integer - last;
            }
            last = integer;
            integer as f64 / power(decimals)
        };
        (0..column.n).map(|_| next()).collect()
    }

    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![
            (-1_000_000_i64..1_000_000, 0_u8..6)
                .prop_map(|(integer, decimals)| integer as f64 / power(decimals)),
            (-1e18..1e18_f64),
            Just(0.1 + 0.2),
            Just(-0.0),
        ]
    }

    proptest! {
        #[test]
        fn every_number_round_trips(numbers in prop::collection::vec(number(), 0..40), trend: bool) {
            let mut columns = Columns::default();
            let order = if trend { Order::Trend } else { Order::Level };
            let column = columns.column(&numbers, order);
            let read = read(&columns, column);
            prop_assert_eq!(
                read.iter().map(|number| number.to_bits()).collect::<Vec<_>>(),
                numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>()
            );
        }
    }

    #[test]
    fn evenly_spaced_steps_take_two_bytes_and_equal_columns_take_none() {
        let mut columns = Columns::default();
        let points: Points =
            (0..1_000).map(|step| (f64::from(step) * 20.0, f64::from(step % 7) / 10.0)).collect();
        let one = columns.series(&points);
        assert_eq!(columns.bytes().len(), 2_000);
        assert_eq!(columns.series(&points), one);
        assert_eq!(columns.bytes().len(), 2_000);
    }
}
