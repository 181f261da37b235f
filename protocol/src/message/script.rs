//! Setpoints and scripts. A script contains many setpoints in one command.

use std::fmt;
use std::marker::PhantomData;
use std::sync::{Arc, OnceLock};

use serde::de::{self, SeqAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Interpolation, Step};
use crate::content_hash::ContentHash;
use crate::control_type::ControlType;
use crate::limits::{CONTROL_VALUES_MAX, LimitError, SCRIPT_STEPS_MAX};
use crate::number::Number;
use crate::time::Span;

/// The values that a command sets, in the device's unit, and their control type.
#[derive(Clone, Debug, PartialEq)]
pub struct Setpoint {
    /// The control type of the values: `position`, `speed`, `acceleration` or `custom_N`.
    pub control_type: ControlType,
    /// The first value (key `control_value`).
    pub value: f64,
    /// The further values (keys `control_value_2` to `control_value_N`).
    pub more: Box<[f64]>,
}

impl Setpoint {
    /// Creates a setpoint with a single value.
    #[must_use]
    pub fn new(control_type: ControlType, value: f64) -> Self {
        Self { control_type, value, more: Box::default() }
    }

    /// Iterates over all values, including the first.
    pub fn values(&self) -> impl Iterator<Item = f64> + '_ {
        std::iter::once(self.value).chain(self.more.iter().copied())
    }
}

/// A list of steps in order of time. A script without steps cancels commands. Clones share their steps and cached results. The script
/// caches its hash once it has been computed, together with the canonical JSON if that is not too long. The encoder reuses the cached
/// JSON.
#[derive(Clone, Default)]
pub struct Script(Arc<Shared>);

#[derive(Default)]
struct Shared {
    steps: Box<[Step]>,
    hashed: OnceLock<Hashed>,
}

struct Hashed {
    hash: ContentHash,
    /// The canonical JSON of the script; `None` if it is longer than [`KEPT_TEXT_MAX`].
    text: Option<Box<str>>,
}

impl Hashed {
    fn of(text: impl AsRef<str> + Into<Box<str>>) -> Self {
        let hash = ContentHash::of(text.as_ref().as_bytes());
        Self { hash, text: (text.as_ref().len() <= KEPT_TEXT_MAX).then(|| text.into()) }
    }
}

/// Maximum length in bytes of the canonical JSON that a script caches. The text takes about as much memory as the steps.
const KEPT_TEXT_MAX: usize = 64 * 1024;

impl PartialEq for Script {
    fn eq(&self, other: &Self) -> bool {
        self.is_same(other) || self.steps() == other.steps()
    }
}

impl fmt::Debug for Script {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Script").field(&self.steps()).finish()
    }
}

impl Script {
    /// Creates a script from steps with non-decreasing offsets.
    ///
    /// # Errors
    /// [`LimitError::StepsOutOfOrder`] names the first step that is earlier than its predecessor.
    pub fn new(steps: Vec<Step>) -> Result<Self, LimitError> {
        let fall = steps.windows(2).position(|pair| pair[1].offset < pair[0].offset);
        match fall {
            None => Ok(Self(Arc::new(Shared { steps: steps.into(), hashed: OnceLock::new() }))),
            Some(i) => Err(LimitError::StepsOutOfOrder {
                step: i + 1,
                millis: steps[i + 1].offset.get(),
                previous: steps[i].offset.get(),
            }),
        }
    }

    /// Returns the empty script. It cancels all commands that are scheduled to start at its own start time or later.
    #[must_use]
    pub fn cancel() -> Self {
        Self::default()
    }

    /// The steps in order of time.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        &self.0.steps
    }

    /// Returns the SHA-256 hash of the canonical JSON of the steps.
    pub(super) fn content_hash(&self) -> ContentHash {
        let hashed = self.0.hashed.get_or_init(|| {
            // Serialization into memory cannot fail: keys are strings, numbers finite.
            Hashed::of(serde_json::to_string(self).unwrap_or_default())
        });
        hashed.hash
    }

    /// Computes and caches the hash. The caller passes the canonical JSON of the steps, so that the steps need not be serialized again.
    pub(crate) fn hash_as(&self, canonical_json: &str) {
        debug_assert_eq!(serde_json::to_string(self).ok().as_deref(), Some(canonical_json));
        self.0.hashed.get_or_init(|| Hashed::of(canonical_json));
    }

    /// Returns the canonical JSON of the steps; `None` if the script does not cache it.
    pub(crate) fn kept_text(&self) -> Option<&str> {
        self.0.hashed.get()?.text.as_deref()
    }

    /// Whether `self` and `other` are clones of the same script.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Whether the script has no steps, so that it cancels instead of moving.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.steps().is_empty()
    }

    /// Time from the scheduled start of the script until the robot reports it as started. On a device that holds values, this is the
    /// offset of the first step. On a device that moves linearly it is zero, because the device begins to move to the first value at
    /// once.
    #[must_use]
    pub fn until_started(&self, interpolation: Interpolation) -> Span {
        match interpolation {
            Interpolation::Hold => self.steps().first().map_or(Span::ZERO, |step| step.offset.span()),
            Interpolation::Linear => Span::ZERO,
        }
    }

    /// Time from the start of the script to its last step.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.steps().last().map_or(Span::ZERO, |step| step.offset.span())
    }
}

impl Serialize for Script {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.steps())
    }
}

impl<'de> Deserialize<'de> for Script {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Steps)
    }
}

struct Steps;

impl<'de> Visitor<'de> for Steps {
    type Value = Script;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the list of steps of a script")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Script, A::Error> {
        // The length that a list states may be false, so only a limited number of steps is preallocated.
        let mut steps = Vec::with_capacity(list.size_hint().unwrap_or(STEPS_USUAL).min(STEPS_BELIEVED));
        while let Some(step) = list.next_element()? {
            if steps.len() == SCRIPT_STEPS_MAX {
                return Err(de::Error::custom(LimitError::StepCount));
            }
            steps.push(step);
        }
        Script::new(steps).map_err(de::Error::custom)
    }
}

/// Maximum number of steps to allocate in advance, even if the list states a greater length.
const STEPS_BELIEVED: usize = 1_024;
/// Number of steps to allocate in advance if the list does not state its length.
const STEPS_USUAL: usize = 32;

/// Serializes all values of a setpoint: `control_value`, `control_value_2` and so on.
pub(super) fn serialize_values<M: SerializeMap>(setpoint: &Setpoint, map: &mut M) -> Result<(), M::Error> {
    map.serialize_entry("control_value", &Number(setpoint.value))?;
    for (i, value) in setpoint.more.iter().enumerate() {
        map.serialize_entry(&format!("control_value_{}", i + 2), &Number(*value))?;
    }
    Ok(())
}

/// The values of the keys `control_value_2` and above, which may occur in any order.
#[derive(Default)]
pub(super) struct FurtherValues(Vec<Option<f64>>);

impl FurtherValues {
    /// Returns the index of the value with the key `control_value_N`, which is N - 2; `None` for other keys.
    pub(super) fn index<E: de::Error>(key: &str) -> Result<Option<usize>, E> {
        let Some(digits) = key.strip_prefix("control_value_") else { return Ok(None) };
        match digits.parse::<usize>() {
            Ok(n) if (2..=CONTROL_VALUES_MAX).contains(&n) && !digits.starts_with('0') => Ok(Some(n - 2)),
            _ => Err(E::custom(format!(
                "unknown key `{key}`, expected control_value_2 to control_value_{CONTROL_VALUES_MAX}"
            ))),
        }
    }

    /// Stores the value at `index`; null counts as omitted.
    pub(super) fn put<E: de::Error>(&mut self, index: usize, value: Option<Number>) -> Result<(), E> {
        let Some(value) = value else { return Ok(()) };
        if self.0.len() <= index {
            self.0.resize(index + 1, None);
        }
        match self.0[index].replace(value.0) {
            None => Ok(()),
            Some(_) => Err(E::custom(format!("duplicate field `control_value_{}`", index + 2))),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn finish<E: de::Error>(self) -> Result<Box<[f64]>, E> {
        let missing = self.0.iter().position(Option::is_none);
        match missing {
            None => Ok(self.0.into_iter().flatten().collect()),
            Some(i) => Err(E::custom(format!("missing field `control_value_{}`", i + 2))),
        }
    }
}

/// A key of an object, deserialized without allocating a string, because messages may have millions of keys.
pub(super) struct Key<K>(pub(super) K);

/// An enumeration whose variants are the keys of one kind of object.
pub(super) trait Keys: Sized {
    fn named<E: de::Error>(key: &str) -> Result<Self, E>;
}

impl<'de, K: Keys> Deserialize<'de> for Key<K> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Named<K>(PhantomData<K>);
        impl<K: Keys> Visitor<'_> for Named<K> {
            type Value = Key<K>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a key")
            }

            fn visit_str<E: de::Error>(self, key: &str) -> Result<Key<K>, E> {
                K::named(key).map(Key)
            }
        }
        deserializer.deserialize_identifier(Named(PhantomData))
    }
}

/// Sets a field; an error if it is already set.
pub(super) fn set_once<T, E: de::Error>(slot: &mut Option<T>, key: &'static str, value: T) -> Result<(), E> {
    match slot.replace(value) {
        None => Ok(()),
        Some(_) => Err(E::duplicate_field(key)),
    }
}
