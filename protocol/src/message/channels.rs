//! The channels of a device in a fixture that is controlled by DMX512.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Number of channels in a DMX universe.
const CHANNELS_MAX: u16 = 512;
/// Maximum number of values of a device that have channels.
const VALUES_MAX: usize = 256;

/// The channels of a device, counted from the first channel of its fixture, which is 1 (our extension).
///
/// A device with one value has one channel, or two for 16 bits: the coarse one and the fine one. A device with several values, such as a
/// colour, has one or two channels for each value.
///
/// ```
/// use urrcp::Channels;
///
/// let pan: Channels = serde_json::from_str("[1, 2]")?;
/// assert_eq!(pan.of_values(1), Some(vec![vec![1, 2]]));
/// let colour: Channels = serde_json::from_str("[6, 7, [8, 9]]")?;
/// assert_eq!(colour.of_values(3), Some(vec![vec![6], vec![7], vec![8, 9]]));
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channels(Vec<Vec<u16>>);

impl Channels {
    /// Returns the channels of each value of a device with `count` values: the coarse channel, and the fine one if there is one. `None`
    /// if the number of channels does not fit the number of values.
    #[must_use]
    pub fn of_values(&self, count: usize) -> Option<Vec<Vec<u16>>> {
        if count == 1 {
            let channels = self.0.concat();
            return (channels.len() <= 2).then(|| vec![channels]);
        }
        (self.0.len() == count).then(|| self.0.clone())
    }

    /// Returns the number of channels or pairs in the list.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

impl TryFrom<Vec<Vec<u16>>> for Channels {
    type Error = &'static str;

    fn try_from(values: Vec<Vec<u16>>) -> Result<Self, Self::Error> {
        let is_channel = |channel: &u16| (1..=CHANNELS_MAX).contains(channel);
        let is_value = |value: &Vec<u16>| (1..=2).contains(&value.len()) && value.iter().all(is_channel);
        if !(1..=VALUES_MAX).contains(&values.len()) || !values.iter().all(is_value) {
            return Err(EXPECTED);
        }
        let mut channels = values.concat();
        channels.sort_unstable();
        if channels.windows(2).any(|two| two[0] == two[1]) {
            return Err("a channel appears twice in `channel`, expected different channels");
        }
        Ok(Self(values))
    }
}

const EXPECTED: &str = "invalid `channel`, expected a channel (1 to 512), a list of channels, or a list of pairs of a coarse and a fine channel";

#[derive(Deserialize, Serialize)]
#[serde(
    untagged,
    expecting = "a channel (1 to 512), a list of channels, or a list of pairs of a coarse and a fine channel"
)]
enum Written {
    Channel(u16),
    Values(Vec<WrittenValue>),
}

#[derive(Deserialize, Serialize)]
#[serde(untagged, expecting = "a channel (1 to 512), or a coarse and a fine channel")]
enum WrittenValue {
    Coarse(u16),
    Both(Vec<u16>),
}

impl Serialize for Channels {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let value = |channels: &Vec<u16>| match channels[..] {
            [coarse] => WrittenValue::Coarse(coarse),
            _ => WrittenValue::Both(channels.clone()),
        };
        match self.0.as_slice() {
            [single] if single.len() == 1 => Written::Channel(single[0]),
            values => Written::Values(values.iter().map(value).collect()),
        }
        .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Channels {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let values = match Written::deserialize(deserializer)? {
            Written::Channel(channel) => vec![vec![channel]],
            Written::Values(values) => {
                let channels = |value| match value {
                    WrittenValue::Coarse(coarse) => vec![coarse],
                    WrittenValue::Both(both) => both,
                };
                values.into_iter().map(channels).collect()
            }
        };
        Self::try_from(values).map_err(de::Error::custom)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Channels {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Channels".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let channel = serde_json::json!({"type": "integer", "minimum": 1, "maximum": CHANNELS_MAX});
        schemars::json_schema!({
            "anyOf": [
                channel,
                {
                    "type": "array",
                    "minItems": 1,
                    "maxItems": VALUES_MAX,
                    "items": {"anyOf": [channel, {"type": "array", "minItems": 1, "maxItems": 2, "items": channel}]},
                },
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_written_as_they_were_read() {
        for text in ["5", "[5,6]", "[6,7,8]", "[[1,2],[3,4]]", "[1,[2,3],4]"] {
            let channels: Channels = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&channels).unwrap(), text);
        }
        let pair: Channels = serde_json::from_str("[5,6]").unwrap();
        assert_eq!(pair.of_values(1), Some(vec![vec![5, 6]]), "coarse and fine");
        assert_eq!(pair.of_values(2), Some(vec![vec![5], vec![6]]));
        assert_eq!(pair.of_values(3), None);
        let wide: Channels = serde_json::from_str("[1,2,3]").unwrap();
        assert_eq!(wide.of_values(1), None, "one value has at most two channels");
    }

    #[test]
    fn invalid_channels_are_refused() {
        for text in
            ["0", "513", "-1", "1.5", "[]", "[[]]", "[[1,2,3]]", "[1,1]", "[[4,5],5]", "\"5\"", "{}", "70000"]
        {
            assert!(serde_json::from_str::<Channels>(text).is_err(), "{text}");
        }
    }
}
