"""Drivers of hardware for `downbeat edge`: subclass `Driver`, and call `run`."""

from .driver import Driver, Refused
from .robot import Device, Robot, Value

__all__ = ["Device", "Driver", "Refused", "Robot", "Value"]
