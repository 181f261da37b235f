"""Plans of several devices that start at the same instant, for hardware that takes one trajectory for all joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Optional

from .plan import Plan, Step
from .robot import Value


@dataclass(frozen=True)
class Frame:
    """The values of all devices at an instant."""

    at: float
    """When they are due, in seconds of `time.monotonic()`."""
    at_ns: int
    """The same in nanoseconds of `time.time_ns()`, by the setting of that clock when the plans arrived."""
    values: dict[str, Value]
    """The value of each device: of its step at this instant, or in between. A device is missing before its first value."""
    steps: list[tuple[Plan, Step]] = field(default_factory=list)
    """The steps that are due at this instant."""


class Group:
    """Plans that start at the same instant. `Driver.play_group` receives it before they start. If one of them ends early, all end."""

    def __init__(self, plans: Sequence[Plan], where: Callable[[str, str], Optional[float]]) -> None:
        self.plans = list(plans)
        self.start, self.start_ns = self.plans[0].start, self.plans[0].start_ns
        self._where = where

    def frames(self) -> list[Frame]:
        """The trajectory: a frame for the start of devices that move linearly, and for each instant at which a step is due."""
        instants = {step.at_ns: step.at for plan in self.plans for step in plan.steps()}
        if any(plan.is_linear for plan in self.plans):
            instants[self.start_ns] = self.start
        frames = [Frame(at, at_ns, {}) for at_ns, at in sorted(instants.items())]
        for plan in self.plans:
            self._fill(frames, plan)
        return frames

    def _fill(self, frames: Sequence[Frame], plan: Plan) -> None:
        """Adds the values of a device to all frames."""
        before, rest = self._origin(plan), plan.steps()
        for frame in frames:
            while rest and rest[0].at_ns <= frame.at_ns:
                before = rest.pop(0)
                if before.at_ns == frame.at_ns:
                    frame.steps.append((plan, before))
            if before is None:
                continue
            value = before.value.value
            if plan.is_linear and rest and rest[0].value.control_type == before.value.control_type:
                part = (frame.at_ns - before.at_ns) / (rest[0].at_ns - before.at_ns)
                value += (rest[0].value.value - value) * part
            frame.values[plan.device] = Value(plan.device, before.value.control_type, value, before.value.more)

    def _origin(self, plan: Plan) -> Optional[Step]:
        """The place from which a device moves linearly to its first step, as far as the driver knows it."""
        first = plan.steps()[0].value
        if not plan.is_linear or (at := self._where(plan.device, first.control_type)) is None:
            return None
        return Step(-1, plan.start, plan.start_ns, Value(plan.device, first.control_type, at))

    def begin(self, *, assumed: bool = False) -> None:
        """Waits for the start, as `Plan.begin` does. Raises `PlanEnded` if one of the plans must not begin."""
        for plan in self.plans:
            plan.begin(assumed=assumed)

    def wait_until(self, at: float) -> None:
        """Waits until an instant of `time.monotonic()`. Raises `PlanEnded` as soon as one of the plans is over."""
        self.plans[0].wait_with(self.plans, at)

    def reached(self, frame: Frame, at_ns: Optional[int] = None, *, assumed: bool = False) -> None:
        """Reports that the steps of a frame are done, at `at_ns` or now."""
        for plan, step in frame.steps:
            plan.reached(step, at_ns, assumed=assumed)

    def finished(self, at_ns: Optional[int] = None, *, assumed: bool = False) -> None:
        """Records when all steps were done, as `Plan.finished` does."""
        for plan in self.plans:
            plan.finished(at_ns, assumed=assumed)

