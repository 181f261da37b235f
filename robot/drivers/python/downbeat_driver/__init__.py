"""Drivers of hardware for `downbeat edge`: subclass `Driver`, and call `run`."""

from .driver import Driver, Refused
from .group import Frame, Group
from .plan import Plan, PlanEnded, Step
from .robot import Device, Reading, Robot, Value

__all__ = ["Device", "Driver", "Frame", "Group", "Plan", "PlanEnded", "Reading", "Refused", "Robot", "Step", "Value"]
