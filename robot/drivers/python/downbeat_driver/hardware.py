"""The base of the ready drivers: places of devices, ramps, rest and signs of life."""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from .driver import Driver, Refused
from .robot import Device, Robot, Value

_SHORTEST_PAUSE = 0.001
"""Seconds between two samples at least, so that a slow bus leaves time for other values."""


class Lost(Exception):
    """The hardware did not answer a single question. It is away only if it stays silent for `hardware_silence_ms`."""


@dataclass(frozen=True)
class _Move:
    """A linear movement, in seconds of `time.monotonic()`."""

    since: float
    origin: float
    target: float
    seconds: float

    def at(self, now: float) -> float:
        part = min(1.0, max(0.0, (now - self.since) / self.seconds)) if self.seconds > 0 else 1.0
        return self.origin + (self.target - self.origin) * part


class Hardware(Driver):
    """Drives devices whose places are given on the command line, as in `shoulder=1`.

    Subclasses write `connect`, `write` and `disconnect`, in most cases `wire`, `ask` and `fetch` too. The methods are never called at the
    same time. After an error in a movement, the edge restarts the program.
    """

    extra: Optional[str] = None
    """Name of the optional dependency, if the driver needs a package."""
    package: Optional[str] = None
    """Name of this package on PyPI."""
    target_help = ""
    """Describes the first argument: the port or address of the hardware."""
    place_help = ""
    """Describes the places of devices."""
    moves_per_second = 100.0
    """Samples of a movement per second."""
    repeat_s: Optional[float] = None
    """Seconds after which the last values are written again, for hardware that expects a steady stream."""
    ask_s = 0.1
    """Seconds between two questions to the hardware at least. Values that the hardware confirms count as answers."""
    hardware_silence_ms = 500

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__()
        self.options = options
        self.wired: dict[str, Any] = {}
        """The place of each device and sensor, as `wire` returned it."""
        self._values: dict[str, Value] = {}
        self._moves: dict[str, _Move] = {}
        self._changed = threading.Event()
        self._ended = False
        self._mover: Optional[threading.Thread] = None
        self._answered = self._written = time.monotonic()

    # Methods that subclasses write.

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        """Adds options to the command line."""

    def wire(self, device: Device, place: Optional[str]) -> Any:
        """Reads the place of a device, which is `None` if the command line does not name it. Raises `Refused` for invalid text."""
        return place

    def connect(self) -> None:
        """Connects to the hardware, checks that each device exists, and moves nothing."""

    def write(self, values: Sequence[Value]) -> None:
        """Writes values that are due at the same instant, if possible together."""
        raise NotImplementedError

    def ask(self) -> None:
        """Asks the hardware whether it could be moved. Raises `Lost` without an answer, and another exception if it could not."""

    def position(self, device: str) -> Optional[float]:
        """Position of a device in its unit, if the hardware knows it. The first ramp begins there."""
        return None

    def disconnect(self) -> None:
        """Closes the connection. Nothing is sent afterwards."""

    # Methods that subclasses call.

    def answered(self) -> None:
        """Records a sign of life."""
        self._answered = time.monotonic()

    def module(self, name: str) -> Any:
        """Imports a module of the package that the driver needs."""
        try:
            return importlib.import_module(name)
        except ImportError as error:
            raise Refused(f"{error}; install the package: pip install {self.package}") from error

    def ask_until_answered(self, seconds: float) -> None:
        """Asks until the hardware answers. Raises `Lost` if it does not within this time."""
        until = time.monotonic() + seconds
        while True:
            try:
                return self.ask()
            except Lost:
                if time.monotonic() > until:
                    raise

    # Calls of the edge.

    def start(self, robot: Robot) -> None:
        places = dict(_place(text) for text in self.options.places)
        for device in places:
            if device not in robot.devices:
                known = ", ".join(robot.devices)
                raise Refused(f"robot `{robot.id}` has no device `{device}`, expected one of {known}")
        self.wired = {device.id: self.wire(device, places.get(device.id)) for device in robot.devices.values()}
        self.connect()
        self.answered()
        self._mover = threading.Thread(target=self._move_devices, name="moves", daemon=True)
        self._mover.start()

    def set_frame(self, values: Sequence[Value]) -> None:
        for value in values:
            self._moves.pop(value.device, None)
        self._write(values)

    def ramp(self, device: str, control_type: str, value: float, seconds: float) -> None:
        with self._setting:
            self._moves[device] = _Move(time.monotonic(), self._origin(device, control_type), value, seconds)
            self._values[device] = Value(device, control_type, self._moves[device].origin)
        self._changed.set()

    def ping(self) -> Optional[float]:
        with self._setting:
            if time.monotonic() - self._answered >= self.ask_s:
                try:
                    self.ask()
                    self.answered()
                except Lost as lost:
                    self.log.debug("%s", lost)
        return time.monotonic() - self._answered

    def stop(self) -> None:
        """Ends movements where they are, sets speeds to zero, and disconnects."""
        self._ended = True
        self._changed.set()
        if self._mover is not None:
            self._mover.join(1.0)
        try:
            with self._setting:
                self._rest()
        finally:
            self.disconnect()

    def _rest(self) -> None:
        moving = [value for value in self._values.values() if value.control_type in ("speed", "acceleration") and value.value != 0]
        if moving:
            self._write([Value(value.device, value.control_type, 0.0) for value in moving])

    def _origin(self, device: str, control_type: str) -> float:
        """The value from which a device begins to move."""
        before = self._values.get(device)
        if before is not None and before.control_type == control_type:
            move = self._moves.get(device)
            return before.value if move is None else move.at(time.monotonic())
        at = self.position(device) if control_type == "position" else 0.0
        if at is None:
            # The edge assumes the same.
            described = self.robot.devices[device]
            ability = described.control_types.get(control_type, {})
            rest = 0.0 if described.default_value is None else described.default_value
            at = min(max(rest, float(ability.get("min_value", rest))), float(ability.get("max_value", rest)))
        return at

    def _write(self, values: Sequence[Value]) -> None:
        self.write(values)
        self._written = time.monotonic()
        self._values.update((value.device, value) for value in values)

    def _move_devices(self) -> None:
        period = 1.0 / self.moves_per_second
        while not self._ended:
            begun = time.monotonic()
            try:
                with self._setting:
                    self._move(begun)
            except Exception as error:  # Report every error to the edge.
                self.log.exception("a movement failed")
                self.fault(f"{type(error).__name__}: {error}")
                return
            if self._moves:
                time.sleep(max(_SHORTEST_PAUSE, begun + period - time.monotonic()))
            else:
                self._changed.wait(self.repeat_s)
                self._changed.clear()

    def _move(self, now: float) -> None:
        """Writes the current values of the devices that move, and repeats the others if the hardware expects this."""
        if self._ended:
            return
        due = [Value(device, self._values[device].control_type, move.at(now)) for device, move in self._moves.items()]
        if self.repeat_s is not None and now - self._written >= self.repeat_s:
            due.extend(value for device, value in self._values.items() if device not in self._moves)
        self._moves = {device: move for device, move in self._moves.items() if now < move.since + move.seconds}
        if due:
            self._write(due)


def _place(text: str) -> tuple[str, str]:
    device, separator, place = text.partition("=")
    if not separator or not device or not place:
        raise Refused(f"`{text}` is not the place of a device, expected DEVICE=PLACE, for example shoulder=1")
    return device, place


def main(driver: type[Hardware]) -> None:
    """Runs a driver with the arguments of the command line."""
    module = Path(inspect.getfile(driver)).stem
    parser = argparse.ArgumentParser(prog=f"python3 -m downbeat_driver.{module}", description=driver.__doc__)
    parser.add_argument("target", help=driver.target_help)
    parser.add_argument("places", nargs="*", metavar="DEVICE=PLACE", help=driver.place_help)
    driver.add_options(parser)
    # Otherwise a library that polls in a loop delays other threads by up to 5 ms.
    sys.setswitchinterval(0.0005)
    driver(parser.parse_intermixed_args()).run()
