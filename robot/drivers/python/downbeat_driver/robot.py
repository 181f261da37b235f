"""Data that a driver receives: the robot that it drives, and values for its devices."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Optional


@dataclass(frozen=True)
class Device:
    """A device of the robot, as its initialization block describes it."""

    id: str
    unit: Optional[str] = None
    """Unit of its values; `None` if the block does not state it."""
    default_value: Optional[float] = None
    control_types: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Its abilities: `position`, `speed`, `sensor` and others, each with `min_value`, `max_value`, `granularity`."""

    @property
    def is_sensor(self) -> bool:
        return "sensor" in self.control_types


@dataclass(frozen=True)
class Robot:
    """The robot that is driven."""

    id: str
    devices: dict[str, Device]
    """The devices by id, in the order of the block."""
    block: dict[str, Any]
    """The whole initialization block."""

    @staticmethod
    def of(block: dict[str, Any]) -> Robot:
        """Reads an initialization block."""
        devices = [
            Device(
                id=device["id"],
                unit=device.get("unit"),
                default_value=device.get("default_value"),
                control_types=device.get("available_control_types", {}),
            )
            for device in block["devices"]
        ]
        return Robot(block["id"], {device.id: device for device in devices}, block)


@dataclass(frozen=True)
class Reading:
    """A value of a sensor, with its age."""

    value: float
    age: float
    """Seconds since the hardware took the value."""


@dataclass(frozen=True)
class Value:
    """A value that is to be set now."""

    device: str
    control_type: str
    value: float
    more: tuple[float, ...] = ()
    """Further values of a `custom_N`."""
