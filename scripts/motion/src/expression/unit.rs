//! Units of values in expressions, and the units of products and quotients.

/// A product of powers of time and angle, or a percentage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unit {
    /// The exponent of time; the base unit is the nanosecond.
    pub time: i8,
    /// The exponent of angle; the base unit is a half turn, `pi`. Angles in degrees are plain numbers.
    pub angle: i8,
    /// Whether the value is a percentage.
    pub percent: bool,
}

/// Highest power of a time or an angle in intermediate results.
const POWER_MAX: i8 = 8;

impl Unit {
    /// The unit of plain numbers.
    pub const PLAIN: Self = Self { time: 0, angle: 0, percent: false };
    /// The unit of times: nanoseconds.
    pub const TIME: Self = Self { time: 1, ..Self::PLAIN };
    /// The unit of angles in radians: half turns, `pi`.
    pub const ANGLE: Self = Self { angle: 1, ..Self::PLAIN };
    /// The unit of percentages: 50% is the number 0.5.
    pub const PERCENT: Self = Self { percent: true, ..Self::PLAIN };

    /// A description of the unit for messages.
    pub const fn name(self) -> &'static str {
        match (self.time, self.angle, self.percent) {
            (0, 0, false) => "a plain number",
            (_, _, true) => "a percentage",
            (1, 0, _) => "a time",
            (0, 1, _) => "an angle",
            (-1, 0, _) => "a value per unit of time",
            (-1, 1, _) => "an angle per unit of time",
            (1, 1, _) => "the product of an angle and a time",
            (2.., 0, _) => "a product of times",
            _ => "a product of times and angles",
        }
    }

    /// The unit of a product. `None` if the powers become too high.
    pub fn times(self, other: Self) -> Option<Self> {
        match (self.percent, other.percent) {
            (true, _) => Some(other),
            (_, true) => Some(self),
            _ => Self::of(self.time + other.time, self.angle + other.angle),
        }
    }

    /// The unit of a quotient. `None` if the powers become too high.
    pub fn over(self, other: Self) -> Option<Self> {
        match (self.percent, other.percent) {
            (true, true) => Some(Self::PLAIN),
            (true, false) if other == Self::PLAIN => Some(self),
            (_, true) => Some(self),
            _ => Self::of(self.time - other.time, self.angle - other.angle),
        }
    }

    fn of(time: i8, angle: i8) -> Option<Self> {
        (time.abs() <= POWER_MAX && angle.abs() <= POWER_MAX).then_some(Self { time, angle, percent: false })
    }

    /// Returns a hint for two units that cannot be added or compared; `None` if there is no hint for these units.
    pub fn hint_of_two(self, other: Self) -> Option<&'static str> {
        let is = |unit: Self| self == unit || other == unit;
        match () {
            () if is(Self::PERCENT) => Some("multiply the percentage by a value: `50% * 90`"),
            () if is(Self::TIME) && is(Self::PLAIN) => Some("give the number a unit, such as `5s`"),
            () if is(Self::ANGLE) && is(Self::PLAIN) => Some(
                "a multiple of `pi` is an angle, but a plain number is in degrees: convert one of them, as in `90 * pi / 180`",
            ),
            () => None,
        }
    }
}
