"""The class to subclass, and the lines that it exchanges with the edge."""

from __future__ import annotations

import inspect
import json
import logging
import math
import os
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Optional, Union

from .group import Group
from .output import Lines, protected_stdout
from .plan import Plan, Step
from .playing import Plans
from .robot import Reading, Robot, Value


SHOWN_MAX = 200
"""Of longer lines, a log contains only the first word."""


class Refused(Exception):
    """The hardware refuses. The text explains the reason to people."""


class Driver:
    """Drives the hardware of one robot. Subclass it, write `set`, and call `run`."""

    latency_ms: Union[float, Mapping[str, float], None] = None
    """Time from a value to the first visible motion, in milliseconds: for all devices, or by device id."""

    lookahead: Union[str, float, Mapping[str, Union[str, float]], None] = None
    """How far ahead the driver receives scripts, to time them itself in `play`: `"script"` for the whole script as soon as it is
    accepted, or milliseconds; for all devices, or by device id. If it is `None`, the driver receives each value when it is due."""

    gather_ms: float = 100.0
    """How long before the start `play_group` is called, in milliseconds."""

    samples_per_second: Union[float, Mapping[str, float], None] = None
    """How often a device is set while it moves linearly or slows down: for all devices, or by device id."""

    pings_per_second: Optional[float] = None
    """Highest rate at which `ping` is called, 10 to 200."""

    readings_per_second: Union[float, Mapping[str, float], None] = None
    """Highest rate at which `read` is called, per sensor."""

    hardware_silence_ms: Optional[float] = None
    """Longest time between signs of life of the hardware, if `ping` returns the age of the last one: 50 to 60000, by default 1000."""

    robot: Robot
    """The robot that is driven. Set before `start` is called."""

    def __init__(self) -> None:
        self.log = logging.getLogger(type(self).__module__ + "." + type(self).__name__)
        self._lines: Optional[Lines] = None
        self._setting = threading.RLock()
        self._heard = time.monotonic()
        self._is_obeying = False
        self._has_started = False
        self._plans = Plans(self.play, self._push, self._silence, self.log)

    # Methods that you write.

    def start(self, robot: Robot) -> None:
        """Connects to the hardware. Called once, before anything else."""

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        """Sets one value. Returns when the hardware has received it."""
        raise NotImplementedError("write `set` or `set_frame`")

    def set_frame(self, values: Sequence[Value]) -> None:
        """Sets all values that are due at one instant. By default, one after another."""
        for value in values:
            self.set(value.device, value.control_type, value.value, *value.more)

    def ramp(self, device: str, control_type: str, value: float, seconds: float) -> None:
        """Begins a linear movement to a value, which takes this many seconds, and returns at once. Write it only for hardware that moves
        by itself. A later `set` or `ramp` of the device replaces the movement."""
        raise Refused("this driver does not support ramps")

    def play(self, plan: Plan) -> None:
        """Plays a plan of one device, on its own thread. Called if `lookahead` is set, before the plan starts.

        Returns when the last step is done, and raises an exception if the hardware fails. By default it calls `set` for each step at its
        time, and in between for a device that moves linearly. Write your own for hardware that takes trajectories: pass the plan to the
        hardware, then report its progress with `plan.started` and `plan.reached`. `plan.wait_until` raises `PlanEnded` when the plan is
        cancelled: stop the hardware then, for example in `finally`.
        """
        plan.begin()
        before = None
        for step in plan:
            if plan.is_linear:
                self._move(plan, before, step)
            plan.wait_until(step.at)
            with self._setting:
                plan.wait_until(step.at)
                if not plan.is_started:
                    plan.started()
                self.set_frame([step.value])
            plan.reached(step)
            before = step

    def play_group(self, group: Group) -> None:
        """Plays the plans that start at the same instant, on one thread, for hardware that takes one trajectory for all of its joints.

        If a class with `lookahead = "script"` has this method, it is called instead of `play`, `gather_ms` before the start, with all plans
        that have arrived. A plan that arrives later is a group of its own: merge it with the trajectory that the hardware follows. Returns
        when the last step is done. If a plan is cancelled, `group.wait_until` raises `PlanEnded`: stop the hardware then.
        """
        raise NotImplementedError

    def where(self, device: str, control_type: str) -> Optional[float]:
        """Position of a device, as far as the driver knows it. The default `play` moves from there to the first step of a plan. If it is
        `None`, the first value is set at the time of its step."""
        return None

    def read(self, sensor: str) -> Union[float, Reading]:
        """Current value of a sensor, in its unit; a `Reading` if its age is known."""
        raise Refused(f"no sensor `{sensor}` is connected")

    def ping(self) -> Optional[float]:
        """Raises an exception if the hardware cannot be moved now. Without this method, only the program is known to be alive. If the
        hardware reports by itself, return the age of its last report in seconds, for example of a joint state or a heartbeat."""
        return None

    def stop(self) -> None:
        """Disconnects from the hardware. Called last, if `start` succeeded; the devices are at rest."""

    # Methods that you call.

    def push_reading(self, sensor: str, value: float, *, age: Optional[float] = None) -> None:
        """Reports a reading to the edge, which then need not request it. `age` are the seconds since the hardware took the value, if they
        are known. Can be called from any thread, after `start`."""
        if not math.isfinite(value):
            raise ValueError(f"the reading of {sensor} is {value}, expected a finite number")
        self._push(f"reading {sensor} {_reading(value if age is None else Reading(value, age))}")

    def fault(self, reason: str) -> None:
        """Reports to the edge that the hardware has failed: all commands end, and the program is restarted. Can be called from any
        thread."""
        self._push(f"fault {reason}")

    def run(self, lines: Optional[Iterable[str]] = None, output: Optional[Lines] = None) -> None:
        """Drives the robot until the edge ends. The arguments are for tests."""
        level = os.environ.get("DOWNBEAT_DRIVER_LOG", "INFO").upper()
        logging.basicConfig(stream=sys.stderr, level=level, format="%(levelname)s %(name)s: %(message)s")
        self._lines = output if output is not None else protected_stdout()
        try:
            for line in sys.stdin if lines is None else lines:
                line = line.strip()
                self._heard, self._is_obeying = time.monotonic(), True
                answer = self._answer(line)
                self.log.debug("%s -> %s", line, answer)
                self._lines.write(answer)
                self._heard, self._is_obeying = time.monotonic(), False
        except BrokenPipeError:
            self.log.warning("the edge has gone")
        finally:
            self._end_plans()
            if self._has_started:
                self.stop()

    def _move(self, plan: Plan, before: Optional[Step], step: Step) -> None:
        """Moves linearly until shortly before a step."""
        of_device = self.samples_per_second
        rate = of_device.get(plan.device) if isinstance(of_device, Mapping) else of_device
        begin = plan.start if before is None else before.at
        if before is None:
            origin = self.where(plan.device, step.value.control_type)
        else:
            origin = before.value.value if before.value.control_type == step.value.control_type else None
        if origin is None or step.value.more:
            return
        sample = 1
        while (at := begin + sample / (rate or 50.0)) < step.at:
            plan.wait_until(at)
            part = min(1.0, max(0.0, (time.monotonic() - begin) / (step.at - begin)))
            value = origin + (step.value.value - origin) * part
            with self._setting:
                plan.wait_until(at)
                self.set_frame([Value(plan.device, step.value.control_type, value)])
            # Skips the samples that a slow device has missed.
            sample = max(sample + 1, math.ceil((time.monotonic() - begin) * (rate or 50.0)))

    def _end_plans(self) -> None:
        """The edge has ended: plans end, positions stay, and speeds set by a plan go to zero."""
        for plan in self._plans.cancel_all("hold", "the edge has gone"):
            rates = {step.value.control_type for step in plan.steps()} & {"speed", "acceleration"}
            try:
                for rate in sorted(rates):
                    self.set_frame([Value(plan.device, rate, 0.0)])
            except Exception:
                self.log.exception("%s may still be moving", plan.device)

    def _silence(self) -> float:
        """Seconds since the edge last sent a line; zero while it waits for an answer of this driver."""
        return 0.0 if self._is_obeying else time.monotonic() - self._heard

    # Protocol with the edge.

    def _push(self, line: str) -> None:
        if self._lines is None:
            raise RuntimeError("the driver does not run yet: call `run` first")
        self._lines.write(line)

    def _answer(self, line: str) -> str:
        try:
            return self._obey(line)
        except Refused as refused:
            return f"error {refused}"
        except Exception as error:  # Report every error to the edge.
            self.log.exception("`%s` failed", line if len(line) <= SHOWN_MAX else line.partition(" ")[0])
            return f"error {type(error).__name__}: {error}"

    def _obey(self, line: str) -> str:
        verb, _, rest = line.partition(" ")
        if verb == "hello":
            return "ok 2"
        if verb == "init":
            self.robot = Robot.of(json.loads(rest)["block"])
            self._check()
            if type(self).play_group is not Driver.play_group:
                self._plans.gather(lambda plans: self.play_group(Group(plans, self.where)), self.gather_ms / 1000)
            self.start(self.robot)
            self._has_started = True
            return "ok " + json.dumps(self._declared())
        if verb == "frame":
            values = [
                Value(of["device"], of["control_type"], of["values"][0], tuple(of["values"][1:]))
                for of in json.loads(rest)
            ]
            with self._setting:
                self.set_frame(values)
        elif verb == "plan":
            self._plans.take(json.loads(rest))
        elif verb == "more":
            self._plans.take_more(json.loads(rest))
        elif verb == "cancel":
            told = json.loads(rest)
            if not self._plans.cancel(int(told["plan"]), told["then"], told["why"]):
                raise Refused(f"plan {told['plan']} does not end")
        elif verb == "set":
            device, control_type, *values = rest.split()
            with self._setting:
                self.set_frame([Value(device, control_type, float(values[0]), tuple(map(float, values[1:])))])
        elif verb == "ramp":
            device, control_type, value, milliseconds = rest.split()
            self.ramp(device, control_type, float(value), float(milliseconds) / 1000)
        elif verb == "read":
            return _reading(self.read(rest))
        elif verb == "ping":
            age = self.ping()
            return "ok" if age is None else f"ok {age * 1000:.3f}"
        else:
            raise Refused(f"unknown command `{verb}`")
        return "ok"

    def _check(self) -> None:
        """Rejects a `ramp` without `seconds`: the edge writes milliseconds, and a `ramp` that took the seconds for milliseconds would
        move a thousand times too fast."""
        known = inspect.signature(self.ramp).parameters
        if "seconds" not in known:
            raise TypeError(f"`ramp` takes {', '.join(known)}; expected device, control_type, value, seconds")
        if type(self).play_group is not Driver.play_group and self.lookahead != "script":
            raise TypeError(f"`play_group` needs whole scripts, but `lookahead` is {self.lookahead!r}; expected 'script'")

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
        declared.update(self._declared_ahead())
        rates = {
            "samples_per_second": self.samples_per_second,
            "pings_per_second": self.pings_per_second,
            "readings_per_second": self.readings_per_second,
            "hardware_silence_ms": self.hardware_silence_ms,
        }
        declared.update({
            key: dict(rate) if isinstance(rate, Mapping) else rate for key, rate in rates.items() if rate is not None
        })
        return declared

    def _declared_ahead(self) -> dict[str, object]:
        ahead = self.lookahead
        if ahead is None:
            return {}
        if not isinstance(ahead, Mapping):
            return {"lookahead": ahead} if isinstance(ahead, str) else {"lookahead_ms": ahead}
        whole = {device: of for device, of in ahead.items() if isinstance(of, str)}
        horizons = {device: of for device, of in ahead.items() if not isinstance(of, str)}
        both = {"lookahead": whole, "lookahead_ms": horizons}
        return {key: of_devices for key, of_devices in both.items() if of_devices}


def _reading(of: Union[float, Reading]) -> str:
    """A reading as the edge expects it: the value, and its age in milliseconds if it is known."""
    if isinstance(of, Reading):
        return f"{float(of.value)!r} {of.age * 1000:.3f}"
    return repr(float(of))
