"""The class to subclass, and the lines that it exchanges with the edge."""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Optional, Union

from .output import Lines, protected_stdout
from .robot import Robot, Value


class Refused(Exception):
    """The hardware says no. The text tells people why."""


class Driver:
    """Drives the hardware of one robot. Subclass it, write `set`, and call `run`."""

    latency_ms: Union[float, Mapping[str, float], None] = None
    """From a value to the first visible motion, in milliseconds: of all devices, or by their ids."""

    robot: Robot
    """The robot that is driven; there from `start` on."""

    def __init__(self) -> None:
        self.log = logging.getLogger(type(self).__module__ + "." + type(self).__name__)
        self._lines: Optional[Lines] = None

    # What you write.

    def start(self, robot: Robot) -> None:
        """Connects to the hardware. Called once, before anything else."""

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        """Sets one value, and returns when the hardware has it."""
        raise NotImplementedError("write `set` or `set_frame`")

    def set_frame(self, values: Sequence[Value]) -> None:
        """Sets all values that are due at one instant. By default one after another."""
        for value in values:
            self.set(value.device, value.control_type, value.value, *value.more)

    def ramp(self, device: str, control_type: str, value: float, seconds: float) -> None:
        """Begins a linear movement to a value and returns at once. Written only for hardware that moves by itself."""
        raise Refused("this driver takes no ramps")

    def read(self, sensor: str) -> float:
        """What a sensor reads now, in its unit."""
        raise Refused(f"no sensor `{sensor}` is connected")

    def ping(self) -> None:
        """Raises an exception if the hardware could not be moved now."""

    def stop(self) -> None:
        """Lets the hardware go. Called last; the devices are in their default state."""

    # What you call.

    def push_reading(self, sensor: str, value: float) -> None:
        """Tells the edge a reading, which it then need not ask for. From any thread, after `start`."""
        if not math.isfinite(value):
            raise ValueError(f"the reading of {sensor} is {value}, expected a finite number")
        self._push(f"reading {sensor} {float(value)!r}")

    def fault(self, reason: str) -> None:
        """Tells the edge that the hardware has failed: everything ends, and the program is started again. From any thread."""
        self._push(f"fault {reason}")

    def run(self, lines: Optional[Iterable[str]] = None, output: Optional[Lines] = None) -> None:
        """Drives until the edge ends. The arguments are for tests."""
        level = os.environ.get("DOWNBEAT_DRIVER_LOG", "INFO").upper()
        logging.basicConfig(stream=sys.stderr, level=level, format="%(levelname)s %(name)s: %(message)s")
        self._lines = output if output is not None else protected_stdout()
        try:
            for line in sys.stdin if lines is None else lines:
                line = line.strip()
                answer = self._answer(line)
                self.log.debug("%s -> %s", line, answer)
                self._lines.write(answer)
        except BrokenPipeError:
            self.log.warning("the edge has gone")
        finally:
            self.stop()

    # The lines.

    def _push(self, line: str) -> None:
        if self._lines is None:
            raise RuntimeError("the driver does not run yet: call `run` first")
        self._lines.write(line)

    def _answer(self, line: str) -> str:
        try:
            return self._obey(line)
        except Refused as refused:
            return f"error {refused}"
        except Exception as error:  # The edge has to know, whatever it is.
            self.log.exception("`%s` failed", line)
            return f"error {type(error).__name__}: {error}"

    def _obey(self, line: str) -> str:
        verb, _, rest = line.partition(" ")
        if verb == "hello":
            return "ok 2"
        if verb == "init":
            self.robot = Robot.of(json.loads(rest)["block"])
            self.start(self.robot)
            return "ok " + json.dumps(self._declared())
        if verb == "frame":
            self.set_frame([
                Value(of["device"], of["control_type"], of["values"][0], tuple(of["values"][1:]))
                for of in json.loads(rest)
            ])
        elif verb == "set":
            device, control_type, *values = rest.split()
            self.set_frame([Value(device, control_type, float(values[0]), tuple(map(float, values[1:])))])
        elif verb == "ramp":
            device, control_type, value, milliseconds = rest.split()
            self.ramp(device, control_type, float(value), float(milliseconds) / 1000)
        elif verb == "read":
            return repr(float(self.read(rest)))
        elif verb == "ping":
            self.ping()
        else:
            raise Refused(f"unknown command `{verb}`")
        return "ok"

    def _declared(self) -> dict[str, object]:
        declared: dict[str, object] = {
            "frames": type(self).set_frame is not Driver.set_frame,
            "ramps": type(self).ramp is not Driver.ramp,
        }
        latency = self.latency_ms
        if latency is not None:
            driven = [device.id for device in self.robot.devices.values() if not device.is_sensor]
            by_device = dict(latency) if isinstance(latency, Mapping) else dict.fromkeys(driven, latency)
            declared["latency_ms"] = by_device
        return declared
