"""Hobby servos that follow the length of a pulse."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Optional

from .driver import Refused
from .robot import Device
from .units import bounds

PLACE_HELP = "CHANNEL:SHORTEST-LONGEST, with the pulses in microseconds for the ends of the device's range; 0:1000-2000 by default for channel 0"
_PLACE = re.compile(r"(\d+)(?::(\d+)-(\d+))?")


@dataclass(frozen=True)
class Servo:
    """A servo on a channel, with the pulses in microseconds for the ends of its range."""

    channel: int
    low: float
    high: float
    shortest: float
    longest: float

    def pulse(self, value: float) -> float:
        """The pulse for a value, in microseconds."""
        return self.shortest + (value - self.low) / (self.high - self.low) * (self.longest - self.shortest)

    def value(self, pulse: float) -> float:
        """The value for a pulse in microseconds."""
        return self.low + (pulse - self.shortest) / (self.longest - self.shortest) * (self.high - self.low)


def servo(device: Device, place: Optional[str], channels: int) -> Optional[Servo]:
    """Reads the place of a servo; `None` for a sensor without a place."""
    if device.is_sensor and place is None:
        return None
    match = _PLACE.fullmatch(place or "")
    if match is None or int(match[1]) >= channels or (match[2] and match[2] == match[3]):
        raise Refused(f"`{place}` is not a place for `{device.id}`, expected CHANNEL or CHANNEL:SHORTEST-LONGEST, "
                      f"with a channel of 0 to {channels - 1}, for example {device.id}=0:1000-2000")
    low, high = bounds(device, "sensor" if device.is_sensor else "position")
    return Servo(int(match[1]), low, high, float(match[2] or 1000), float(match[3] or 2000))
