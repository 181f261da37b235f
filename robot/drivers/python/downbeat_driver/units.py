"""Units of devices, and their conversion into those of hardware."""

from __future__ import annotations

import math

from .driver import Refused
from .robot import Device

ANGLES = {"deg": 1.0, "°": 1.0, "degrees": 1.0, "rad": math.degrees(1.0), "turn": 360.0}
"""Degrees in each unit of an angle."""
ANGULAR_SPEEDS = {"deg/s": 1.0, "°/s": 1.0, "rad/s": math.degrees(1.0), "rpm": 6.0}
"""Degrees per second in each unit of an angular speed."""
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres in each unit of a length."""


def factor(device: Device, units: dict[str, float]) -> float:
    """The number by which values of a device are multiplied. A device without a unit has the first unit of the table."""
    if device.unit is None:
        return 1.0
    if device.unit not in units:
        raise Refused(f"device `{device.id}` has the unit `{device.unit}`, expected one of {', '.join(units)}; change `unit` in its description")
    return units[device.unit]


def bounds(device: Device, control_type: str) -> tuple[float, float]:
    """The smallest and the largest value of a device, from its description."""
    ability = device.control_types.get(control_type, {})
    if "min_value" not in ability or "max_value" not in ability:
        raise Refused(f"device `{device.id}` has no range, expected `min_value` and `max_value` of `{control_type}` in its description")
    return float(ability["min_value"]), float(ability["max_value"])
