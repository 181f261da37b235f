"""Simulated hardware: a device that moves late, slowly and inexactly, and a driver of such devices."""

from __future__ import annotations

import argparse
import math
import random
import time
from typing import Optional, Union

from .driver import Driver, Refused
from .plan import Plan
from .robot import Robot


class SimulatedDevice:
    """Follows its target after a delay, with a time constant; its readings have noise. Times are seconds."""

    def __init__(
        self,
        position: float = 0.0,
        *,
        delay: float = 0.0,
        time_constant: float = 0.0,
        noise: float = 0.0,
        seed: Optional[int] = None,
    ) -> None:
        if delay < 0 or time_constant < 0 or noise < 0:
            raise ValueError("delay, time_constant and noise are at least 0")
        self.delay, self.time_constant, self.noise = delay, time_constant, noise
        self._random = random.Random(seed)
        self._from, self._target, self._since = position, position, -math.inf
        self._waiting: list[tuple[float, float]] = []

    def set(self, value: float, now: Optional[float] = None) -> None:
        """Sets a new target."""
        now = time.monotonic() if now is None else now
        self._waiting.append((now + self.delay, value))

    def position(self, now: Optional[float] = None) -> float:
        """Its position, without noise."""
        now = time.monotonic() if now is None else now
        while self._waiting and self._waiting[0][0] <= now:
            since, target = self._waiting.pop(0)
            self._from, self._target, self._since = self._at(since), target, since
        return self._at(now)

    def read(self, now: Optional[float] = None) -> float:
        """The reading of its sensor, with noise."""
        position = self.position(now)
        return position + self._random.gauss(0.0, self.noise) if self.noise else position

    def _at(self, now: float) -> float:
        if self.time_constant == 0 or self._since == -math.inf:
            return self._target
        left = math.exp(-(now - self._since) / self.time_constant)
        return self._target + (self._from - self._target) * left


class SimulatedDriver(Driver):
    """Drives a simulated device for each device of the robot. A sensor reads the middle of its range.

    With `lookahead` it follows plans, and logs its actions with the time in nanoseconds."""

    def __init__(
        self,
        *,
        delay: float = 0.0,
        time_constant: float = 0.0,
        noise: float = 0.0,
        lookahead: Union[str, float, None] = None,
    ) -> None:
        super().__init__()
        self.lookahead = lookahead
        self._physics = {"delay": delay, "time_constant": time_constant, "noise": noise}
        self.devices: dict[str, SimulatedDevice] = {}

    def start(self, robot: Robot) -> None:
        for device in robot.devices.values():
            sensor = device.control_types.get("sensor", {})
            middle = (float(sensor.get("min_value", 0)) + float(sensor.get("max_value", 0))) / 2
            at = device.default_value if device.default_value is not None else middle
            self.devices[device.id] = SimulatedDevice(at, **self._physics)

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        if control_type in ("position", "speed"):
            self.devices[device].set(value)
        self.log.info("%s %s %s", device, control_type, " ".join(map(str, (value, *more))))

    def play(self, plan: Plan) -> None:
        self.log.info("plan %d of %s starts at %d", plan.id, plan.device, plan.start_ns)
        try:
            super().play(plan)
        finally:
            end = "ends before its end" if plan.is_cancelled else "is over"
            self.log.info("plan %d of %s %s", plan.id, plan.device, end)

    def where(self, device: str, control_type: str) -> Optional[float]:
        return self.devices[device].position() if control_type == "position" else None

    def read(self, sensor: str) -> float:
        if sensor not in self.devices:
            raise Refused(f"there is no `{sensor}`")
        return self.devices[sensor].read()


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description="Drives simulated hardware for `downbeat edge`.")
    arguments.add_argument("--delay-ms", type=float, default=0.0, help="from a value to the first motion")
    arguments.add_argument("--time-constant-ms", type=float, default=0.0, help="how slowly it follows")
    arguments.add_argument("--noise", type=float, default=0.0, help="standard deviation of its readings")
    arguments.add_argument("--lookahead", metavar="script|MS", help="follow scripts by itself, told whole or so far ahead")
    given = arguments.parse_args()
    ahead = given.lookahead
    SimulatedDriver(
        delay=given.delay_ms / 1000,
        time_constant=given.time_constant_ms / 1000,
        noise=given.noise,
        lookahead=ahead if ahead in (None, "script") else float(ahead),
    ).run()
