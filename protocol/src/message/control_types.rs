//! The control types of a device and their parameters: ranges, granularity, maximum number of steps.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{self, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use super::growth::Word;
use super::parameters::Parameters;
use crate::control_type::ControlType;
use crate::error::{ControlError, ErrorCode};
use crate::limits::{CONTROL_VALUES_MAX, LimitError};
use crate::message::script::Setpoint;
use crate::number;
use crate::object::Object;

/// The control types that a device supports, each with its parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlTypes(BTreeMap<ControlType, ControlParameters>);

/// The parameters of one control type.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum ControlParameters {
    /// Parameters of the control types `position`, `speed` and `acceleration`.
    Motion(Limits),
    /// Parameters of the control type `script`.
    Script(ScriptParameters),
    /// Parameters of the control type `sensor`.
    Sensor(SensorParameters),
    /// Parameters of a control type `custom_N`. Each custom type defines its own parameters.
    Custom(Map<String, Value>),
}

/// Range, granularity and error of the values of a control type, in the device's unit (paper, table 3).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawLimits>")]
pub struct Limits {
    /// Smallest value that the device can take.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub min_value: f64,
    /// Largest value that the device can take.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub max_value: f64,
    /// Granularity; above 0. All values are multiples of it.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64", extend("exclusiveMinimum" = 0)))]
    pub granularity: f64,
    /// Largest error of a value due to construction or operating conditions. `None`: unknown.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_error: Option<f64>,
}

#[derive(Deserialize)]
struct RawLimits {
    #[serde(with = "number")]
    min_value: f64,
    #[serde(with = "number")]
    max_value: f64,
    #[serde(with = "number")]
    granularity: f64,
    #[serde(default, with = "number::optional")]
    max_error: Option<f64>,
}

impl TryFrom<Object<RawLimits>> for Limits {
    type Error = LimitError;

    fn try_from(Object(raw): Object<RawLimits>) -> Result<Self, LimitError> {
        check_range(raw.min_value, raw.max_value)?;
        check_not_negative("max_error", raw.max_error)?;
        // The granularity is finite here, so this comparison also excludes NaN.
        if raw.granularity <= 0.0 {
            return Err(LimitError::Granularity { granularity: raw.granularity });
        }
        let RawLimits { min_value, max_value, granularity, max_error } = raw;
        let limits = Self { min_value, max_value, granularity, max_error };
        let [low, high] = limits.multiples();
        if low <= high {
            Ok(limits)
        } else {
            Err(LimitError::NoMultiple { granularity, min: min_value, max: max_value })
        }
    }
}

fn check_range(min: f64, max: f64) -> Result<(), LimitError> {
    if min <= max { Ok(()) } else { Err(LimitError::EmptyRange { min, max }) }
}

fn finite(numbers: &[f64]) -> Result<(), LimitError> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(LimitError::NotFinite) }
}

fn check_not_negative(key: &'static str, value: Option<f64>) -> Result<(), LimitError> {
    match value {
        Some(value) if value < 0.0 => Err(LimitError::Negative { key, value }),
        _ => Ok(()),
    }
}

/// Maximum deviation of a value from a multiple of the granularity due to decimal rounding, as a fraction of the granularity.
const GRID_TOLERANCE: f64 = 1e-6;

/// Multiples of the granularity are corrected for decimal rounding only if their factor is less than this. For larger factors, the
/// rounding error of the granularity exceeds [`GRID_TOLERANCE`].
const FACTOR_MAX: f64 = 1e9;

/// Powers of ten, one of which makes the granularity an integer by multiplication. Granularities have at most 12 decimal digits.
const POWERS_OF_TEN: [f64; 13] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12];

impl Limits {
    /// Creates limits with an unknown error.
    ///
    /// # Errors
    /// [`LimitError`] if a number is not finite, `min_value` is above `max_value`, the granularity is not above 0, or no multiple of
    /// it lies between `min_value` and `max_value`.
    pub fn new(min_value: f64, max_value: f64, granularity: f64) -> Result<Self, LimitError> {
        finite(&[min_value, max_value, granularity])?;
        Self::try_from(Object(RawLimits { min_value, max_value, granularity, max_error: None }))
    }

    /// Whether `value` is from `min_value` to `max_value`, inclusive.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        value >= self.min_value && value <= self.max_value
    }

    /// Whether `value` is a multiple of the granularity, apart from decimal rounding.
    #[must_use]
    pub fn on_grid(&self, value: f64) -> bool {
        let steps = value / self.granularity;
        (steps - steps.round()).abs() <= GRID_TOLERANCE
    }

    /// Returns the multiple of the granularity that is nearest to `value`. It may be outside the limits.
    #[must_use]
    pub fn nearest(&self, value: f64) -> f64 {
        self.multiple((value / self.granularity).round())
    }

    /// Returns the value within the limits that is a multiple of the granularity and nearest to `value`.
    #[must_use]
    pub fn nearest_settable(&self, value: f64) -> f64 {
        let [low, high] = self.multiples();
        let multiple = self.multiple((value / self.granularity).round().min(high).max(low));
        // Decimal rounding may place a bound slightly off the grid.
        multiple.clamp(self.min_value, self.max_value)
    }

    /// Returns `factor` times the granularity, rounded to the decimal digits of the granularity: 41 * 0.1 is 4.1, not 4.1000000000000005.
    fn multiple(&self, factor: f64) -> f64 {
        let is_whole = |scale: &f64| {
            let scaled = self.granularity * scale;
            scaled >= 0.5 && (scaled - scaled.round()).abs() <= scaled * 2.0 * f64::EPSILON
        };
        match POWERS_OF_TEN.iter().find(|scale| is_whole(scale)) {
            Some(scale) if factor.abs() < FACTOR_MAX => factor * (self.granularity * scale).round() / scale,
            _ => factor * self.granularity,
        }
    }

    /// Returns the factors of the smallest and the largest multiple of the granularity within the limits.
    fn multiples(&self) -> [f64; 2] {
        let [low, high] = [self.min_value, self.max_value].map(|bound| bound / self.granularity);
        [(low - GRID_TOLERANCE).ceil(), (high + GRID_TOLERANCE).floor()]
    }

    pub(super) fn check(&self, control_type: ControlType, value: f64) -> Result<(), ControlError> {
        if !self.contains(value) {
            let message =
                format!("{control_type} {value}, expected {} to {}", self.min_value, self.max_value);
            return Err(ControlError::new(ErrorCode::OutOfRange, message));
        }
        if !self.on_grid(value) {
            let message = format!("{control_type} {value}, expected a multiple of {}", self.granularity);
            return Err(ControlError::new(ErrorCode::OffGranularity, message));
        }
        Ok(())
    }
}

/// The parameters of the control type `script`. Omitted ones have been inherited from other control types of the device.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScriptParameters {
    /// Limits of the values in steps. Limits that a robot omits are inherited from the control type that its scripts support.
    #[serde(flatten)]
    #[cfg_attr(feature = "schema", schemars(with = "InheritedLimits"))]
    pub limits: Limits,
    /// Largest number of steps in one script; at least 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub max_number_of_steps: u32,
    /// The control types that steps may use (our extension). `None`: all control types of the device except `script` and `sensor`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_types: Option<Vec<ControlType>>,
}

impl ScriptParameters {
    /// Creates the parameters for scripts of at most `max_number_of_steps` steps, which may use every control type of the device within
    /// `limits`.
    #[must_use]
    pub const fn new(limits: Limits, max_number_of_steps: u32) -> Self {
        Self { limits, max_number_of_steps, control_types: None }
    }
}

/// Limits of the values in steps. Each limit may be omitted; it is then inherited from another control type.
#[cfg(feature = "schema")]
#[derive(schemars::JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
struct InheritedLimits {
    /// Smallest value that a step may set.
    min_value: Option<f64>,
    /// Largest value that a step may set.
    max_value: Option<f64>,
    /// Granularity; above 0.
    #[schemars(extend("exclusiveMinimum" = 0))]
    granularity: Option<f64>,
    /// Largest error of a value due to construction or operating conditions. `None`: unknown.
    #[schemars(range(min = 0))]
    max_error: Option<f64>,
}

/// The parameters of the control type `script` as written in JSON, before omitted ones are inherited from other control types.
#[derive(Deserialize)]
struct WrittenScript {
    #[serde(default, with = "number::optional")]
    min_value: Option<f64>,
    #[serde(default, with = "number::optional")]
    max_value: Option<f64>,
    #[serde(default, with = "number::optional")]
    granularity: Option<f64>,
    #[serde(default, with = "number::optional")]
    max_error: Option<f64>,
    max_number_of_steps: u32,
    #[serde(default, deserialize_with = "listed")]
    control_types: Option<Vec<ControlType>>,
}

/// Deserializes the control types that scripts may use, without those of a later version.
fn listed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<ControlType>>, D::Error> {
    let known = |word| match word {
        Word::Known(control_type) => Some(control_type),
        Word::Later => None,
    };
    let words = Option::<Vec<Word<ControlType>>>::deserialize(deserializer)?;
    Ok(words.map(|words| words.into_iter().filter_map(known).collect()))
}

/// The reason why the parameters of a script are incomplete or invalid.
#[derive(Debug, thiserror::Error)]
enum InheritError {
    #[error(transparent)]
    Limits(#[from] LimitError),
    #[error(
        "missing field `{key}` of script: it cannot be inherited, because the device's control types have different limits"
    )]
    Ambiguous { key: &'static str },
    #[error("missing field `{key}` of script: the device has no control type to inherit it from")]
    NoSource { key: &'static str },
}

impl WrittenScript {
    /// Inherits omitted parameters from the control type that the script supports. If the script supports several control types with
    /// different limits, it inherits nothing.
    fn inherit(
        self,
        types: &BTreeMap<ControlType, ControlParameters>,
    ) -> Result<ScriptParameters, InheritError> {
        let Self { min_value, max_value, granularity, max_error, max_number_of_steps, control_types } = self;
        if max_number_of_steps == 0 {
            return Err(LimitError::NoneAtAll { key: "max_number_of_steps" }.into());
        }
        let supported = |control_type: &ControlType| {
            control_types.as_ref().is_none_or(|listed| listed.contains(control_type))
        };
        let mut all = types.iter().filter_map(|(control_type, parameters)| match parameters {
            ControlParameters::Motion(limits) if supported(control_type) => Some(limits),
            _ => None,
        });
        let first = all.next();
        let ambiguous = all.any(|other| Some(other) != first);
        let from = |key, own: Option<f64>, inherited: fn(&Limits) -> f64| match (own, first) {
            (Some(own), _) => Ok(own),
            (None, Some(_)) if ambiguous => Err(InheritError::Ambiguous { key }),
            (None, Some(limits)) => Ok(inherited(limits)),
            (None, None) => Err(InheritError::NoSource { key }),
        };
        let complete = min_value.is_some() && max_value.is_some() && granularity.is_some();
        let raw = RawLimits {
            min_value: from("min_value", min_value, |limits| limits.min_value)?,
            max_value: from("max_value", max_value, |limits| limits.max_value)?,
            granularity: from("granularity", granularity, |limits| limits.granularity)?,
            max_error: max_error.or_else(|| first.filter(|_| !complete).and_then(|limits| limits.max_error)),
        };
        let limits = Limits::try_from(Object(raw))?;
        Ok(ScriptParameters { limits, max_number_of_steps, control_types })
    }
}

/// Parameters of the control type `sensor` (paper, table 4).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawSensor>")]
pub struct SensorParameters {
    /// Smallest reading.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub min_value: f64,
    /// Largest reading.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub max_value: f64,
    /// Largest error of a reading. `None`: unknown.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_error: Option<f64>,
    /// Largest latency of a reading in milliseconds. `None`: unknown.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_delay: Option<f64>,
}

#[derive(Deserialize)]
struct RawSensor {
    #[serde(with = "number")]
    min_value: f64,
    #[serde(with = "number")]
    max_value: f64,
    #[serde(default, with = "number::optional")]
    max_error: Option<f64>,
    #[serde(default, with = "number::optional")]
    max_delay: Option<f64>,
}

impl TryFrom<Object<RawSensor>> for SensorParameters {
    type Error = LimitError;

    fn try_from(Object(raw): Object<RawSensor>) -> Result<Self, LimitError> {
        check_range(raw.min_value, raw.max_value)?;
        check_not_negative("max_error", raw.max_error)?;
        check_not_negative("max_delay", raw.max_delay)?;
        let RawSensor { min_value, max_value, max_error, max_delay } = raw;
        Ok(Self { min_value, max_value, max_error, max_delay })
    }
}

impl SensorParameters {
    /// Creates the parameters of a sensor with unknown error and delay.
    ///
    /// # Errors
    /// [`LimitError`] if a number is not finite, or `min_value` exceeds `max_value`.
    pub fn new(min_value: f64, max_value: f64) -> Result<Self, LimitError> {
        finite(&[min_value, max_value])?;
        Self::try_from(Object(RawSensor { min_value, max_value, max_error: None, max_delay: None }))
    }
}

impl ControlTypes {
    /// Adds a control type, or replaces the parameters of a control type that is already present.
    pub(super) fn insert(&mut self, control_type: ControlType, parameters: ControlParameters) {
        self.0.insert(control_type, parameters);
    }

    /// Returns the parameters of a control type; `None` if the device lacks this control type.
    #[must_use]
    pub fn get(&self, control_type: ControlType) -> Option<&ControlParameters> {
        self.0.get(&control_type)
    }

    /// Returns the limits of `position`, `speed` or `acceleration`; `None` for other control types and if the device lacks the control
    /// type.
    #[must_use]
    pub fn limits(&self, control_type: ControlType) -> Option<&Limits> {
        match self.get(control_type)? {
            ControlParameters::Motion(limits) => Some(limits),
            _ => None,
        }
    }

    /// Returns the parameters of `script`; `None` if the device does not accept scripts.
    #[must_use]
    pub fn script(&self) -> Option<&ScriptParameters> {
        match self.get(ControlType::Script)? {
            ControlParameters::Script(script) => Some(script),
            _ => None,
        }
    }

    /// Returns the parameters of `sensor`; `None` if the device is not a sensor.
    #[must_use]
    pub fn sensor(&self) -> Option<&SensorParameters> {
        match self.get(ControlType::Sensor)? {
            ControlParameters::Sensor(sensor) => Some(sensor),
            _ => None,
        }
    }

    /// Returns the setpoint that brings a device to rest, for a command with `count` values (our extension). `None` if the control type
    /// is not a custom one with the parameter `at_rest`, which declares this setpoint. If `at_rest` is a number, it applies to all
    /// values. If `at_rest` is a list, each entry applies to one value, and the last entry also applies to further values.
    #[must_use]
    pub fn at_rest(&self, control_type: ControlType, count: usize) -> Option<Setpoint> {
        let ControlParameters::Custom(parameters) = self.get(control_type)? else { return None };
        let declared = declared_at_rest(parameters).ok()??;
        let value = |index: usize| declared.get(index).or(declared.last()).copied();
        let more = (1..count.max(1)).filter_map(value).collect();
        Some(Setpoint { more, ..Setpoint::new(control_type, value(0)?) })
    }

    /// Iterates over all control types and their parameters, in the order of [`ControlType`].
    pub fn iter(&self) -> impl Iterator<Item = (ControlType, &ControlParameters)> {
        self.0.iter().map(|(control_type, parameters)| (*control_type, parameters))
    }
}

/// Returns the values of the parameter `at_rest`; `None` if it is absent.
fn declared_at_rest(parameters: &Map<String, Value>) -> Result<Option<Vec<f64>>, &'static str> {
    const EXPECTED: &str =
        "invalid `at_rest` of a custom control type, expected a number or a list of 1 to 256 numbers";
    let values = match parameters.get("at_rest") {
        None => return Ok(None),
        Some(Value::Array(values)) => values.iter().map(Value::as_f64).collect(),
        Some(value) => value.as_f64().map(|value| vec![value]),
    };
    values
        .filter(|values: &Vec<f64>| (1..=CONTROL_VALUES_MAX).contains(&values.len()))
        .ok_or(EXPECTED)
        .map(Some)
}

impl Serialize for ControlTypes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(&self.0)
    }
}

impl Serialize for ControlParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Motion(limits) => limits.serialize(serializer),
            Self::Script(script) => script.serialize(serializer),
            Self::Sensor(sensor) => sensor.serialize(serializer),
            Self::Custom(parameters) => parameters.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for ControlTypes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ControlTypesVisitor)
    }
}

struct ControlTypesVisitor;

impl<'de> Visitor<'de> for ControlTypesVisitor {
    type Value = ControlTypes;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a dictionary from control type to its parameters")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ControlTypes, A::Error> {
        let mut types = BTreeMap::new();
        let mut script: Option<WrittenScript> = None;
        let mut skipped = false;
        while let Some(word) = map.next_key::<Word<ControlType>>()? {
            let Word::Known(control_type) = word else {
                map.next_value::<IgnoredAny>()?;
                skipped = true;
                continue;
            };
            let parameters = match control_type {
                // The control types from which the script inherits may come later.
                ControlType::Script if script.is_none() => {
                    script = Some(map.next_value::<Object<WrittenScript>>()?.0);
                    continue;
                }
                ControlType::Script => {
                    return Err(de::Error::custom(format!("duplicate control type `{control_type}`")));
                }
                ControlType::Sensor => ControlParameters::Sensor(map.next_value()?),
                ControlType::Custom(_) => {
                    let Parameters(parameters) = map.next_value()?;
                    declared_at_rest(&parameters).map_err(de::Error::custom)?;
                    ControlParameters::Custom(parameters)
                }
                _ => ControlParameters::Motion(map.next_value()?),
            };
            if types.insert(control_type, parameters).is_some() {
                return Err(de::Error::custom(format!("duplicate control type `{control_type}`")));
            }
        }
        if let Some(script) = script {
            match script.inherit(&types) {
                Ok(script) => {
                    types.insert(ControlType::Script, ControlParameters::Script(script));
                }
                // Its limits are perhaps those of a control type that was skipped.
                Err(InheritError::NoSource { .. }) if skipped => {}
                Err(error) => return Err(de::Error::custom(error)),
            }
        }
        Ok(ControlTypes(types))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiple_has_at_most_as_many_decimals_as_the_granularity() {
        for (granularity, digits) in
            [(0.1, 1), (0.02, 2), (0.25, 2), (2.5, 1), (3.0, 0), (1e-7, 7), (0.017, 3)]
        {
            let limits = Limits::new(-1e6, 1e6, granularity).unwrap();
            for n in -2_000..2_000 {
                let between = f64::from(n) * 1.37 * granularity;
                for value in [limits.nearest(between), limits.nearest_settable(between)] {
                    assert_eq!(
                        value.to_string().parse::<f64>(),
                        format!("{value:.digits$}").parse(),
                        "{value}"
                    );
                    assert!(limits.on_grid(value), "{value} of {granularity}");
                }
            }
        }
        let third = Limits::new(0.0, 10.0, 1.0 / 3.0).unwrap();
        assert_eq!(third.nearest_settable(0.7), 2.0 * (1.0 / 3.0), "no decimal digits write it");
    }

    #[test]
    fn nearest_settable_value_is_a_multiple_within_the_limits() {
        let limits = Limits::new(-9.99, 9.99, 1.0).unwrap();
        for (value, settable) in [(9.8, 9.0), (-9.8, -9.0), (9.49, 9.0), (40.0, 9.0), (3.5, 4.0)] {
            assert_eq!(limits.nearest_settable(value), settable, "{value}");
        }
        // 3 * 0.1 is above 0.3.
        let limits = Limits::new(-0.3, 0.3, 0.1).unwrap();
        assert_eq!([limits.nearest_settable(0.3), limits.nearest_settable(-1.0)], [0.3, -0.3]);
    }

    #[test]
    fn script_inherits_omitted_limits_unless_its_control_types_differ() {
        let read = |speed: &str, script: &str| {
            let position = r#"{"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 2}"#;
            let text = format!(r#"{{"position": {position}, "speed": {speed}, "script": {script}}}"#);
            serde_json::from_str::<ControlTypes>(&text).map(|types| types.script().unwrap().limits.clone())
        };
        let slow = r#"{"min_value": -1, "max_value": 1, "granularity": 0.1}"#;
        let inherited = read(slow, r#"{"max_number_of_steps": 4, "control_types": ["position"]}"#).unwrap();
        assert_eq!(
            inherited,
            Limits { min_value: 0.0, max_value: 90.0, granularity: 0.5, max_error: Some(2.0) }
        );
        let narrower = r#"{"max_number_of_steps": 4, "control_types": ["position"], "max_value": 45}"#;
        assert_eq!(read(slow, narrower).unwrap(), Limits { max_value: 45.0, ..inherited });
        let error = read(slow, r#"{"max_number_of_steps": 4}"#).unwrap_err().to_string();
        assert!(error.contains("the device's control types have different limits"), "{error}");
        assert!(read(slow, "{}").is_err(), "the number of steps is required");
    }

    #[test]
    fn limits_that_contain_no_multiple_are_refused() {
        let error = Limits::new(1.0, 4.0, 5.0).unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("no multiple of the granularity 5 lies between min_value 1 and max_value 4")
        );
        assert!(
            serde_json::from_str::<Limits>(r#"{"min_value": 1, "max_value": 4, "granularity": 5}"#).is_err()
        );
        assert!(Limits::new(0.3, 0.3, 0.1).is_ok());
    }
}
