//! Hardware events that an edge shows in its terminal.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use urrcp::DeviceId;

use super::{News, PlanNews};

/// An event of the hardware of an edge.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum HardwareEvent {
    /// The hardware has answered, for the first time or again.
    There {
        /// Latency from a value to visible motion, by device, as the driver declares it.
        latency: BTreeMap<DeviceId, Duration>,
    },
    /// The hardware is disconnected or refused a value, for the contained reason. The edge tries to connect again; each failed attempt
    /// repeats this event.
    Lost(String),
    /// The hardware refused a script, for the contained reason.
    Refused(String),
    /// A sensor gave no reading, for the contained reason.
    Unread(String),
    /// A value reached the driver so late that it was not set.
    Late {
        /// Device for which the value was intended.
        device: DeviceId,
        /// Delay of the value.
        late: Duration,
    },
}

impl HardwareEvent {
    /// Converts a report of a driver's thread to an event for the terminal. `None` if users need not see the report.
    pub(crate) fn of(news: &News) -> Option<Self> {
        match news {
            News::There { latency, .. } => Some(Self::There { latency: latency.clone() }),
            News::Away { reason } => Some(Self::Lost(reason.clone())),
            News::Stale { device, late } => Some(Self::Late { device: device.clone(), late: *late }),
            News::Reading { reading: Err(reason), .. } => Some(Self::Unread(reason.clone())),
            News::Plan(PlanNews::Refused { error, .. }) => Some(Self::Refused(error.message.to_string())),
            News::Reading { .. } | News::Confirmed(_) | News::Plan(_) => None,
        }
    }
}

impl fmt::Display for HardwareEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::There { latency } if latency.is_empty() => f.write_str("the hardware is responding"),
            Self::There { latency } => {
                let of = |(device, latency): (&DeviceId, &Duration)| {
                    format!("{device} {} ms", latency.as_secs_f64() * 1_000.0)
                };
                let all: Vec<_> = latency.iter().map(of).collect();
                write!(f, "its driver declares a latency, which is reported to missions: {}", all.join(", "))
            }
            Self::Lost(why) | Self::Refused(why) => f.write_str(why),
            Self::Unread(why) => write!(f, "a sensor gave no reading: {why}"),
            Self::Late { device, late } => {
                write!(f, "a value for `{device}` came {} ms late and was not set", late.as_millis())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_hardware_event_is_a_sentence_with_its_subject() {
        let arm = DeviceId::new("arm").unwrap();
        let latency = BTreeMap::from([(arm.clone(), Duration::from_micros(12_500))]);
        for (event, expected) in [
            (HardwareEvent::There { latency: BTreeMap::new() }, "the hardware is responding"),
            (
                HardwareEvent::There { latency },
                "its driver declares a latency, which is reported to missions: arm 12.5 ms",
            ),
            (HardwareEvent::Lost("pulled out".to_owned()), "pulled out"),
            (HardwareEvent::Unread("dark".to_owned()), "a sensor gave no reading: dark"),
            (
                HardwareEvent::Late { device: arm, late: Duration::from_millis(300) },
                "a value for `arm` came 300 ms late and was not set",
            ),
        ] {
            assert_eq!(event.to_string(), expected);
        }
    }
}
