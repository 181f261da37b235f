"""Sends lines of text to a microcontroller on a serial port."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value


class SerialLine(Hardware):
    """Sends a line of text for each value to a microcontroller, such as an Arduino, and expects an answer to each."""

    extra = "serial"
    package = "pyserial"
    target_help = "the serial port, such as /dev/ttyACM0"
    place_help = "the name of the device in the lines; by default its id"

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--baud", type=int, default=115200, help="bits per second (default: 115200)")
        parser.add_argument("--set", default="{name} {value}", help="line for a value (default: '{name} {value}')")
        parser.add_argument("--read", default="{name}?", help="line that requests a reading (default: '{name}?')")
        parser.add_argument("--ask", default="?", help="line that the controller answers at any time (default: '?')")
        parser.add_argument("--error", default="error", help="beginning of an answer that refuses (default: error)")
        parser.add_argument("--no-answers", action="store_true", help="the controller answers nothing: only the port is known to be alive")
        parser.add_argument("--boot-s", type=float, default=2.0, help="time that the controller needs after the port is opened (default: 2)")

    def wire(self, device: Device, place: Optional[str]) -> str:
        return place or device.id

    def connect(self) -> None:
        serial = self.module("serial")
        self.port = serial.Serial(self.options.target, self.options.baud, timeout=0.2, write_timeout=0.5)
        self.ask_until_answered(self.options.boot_s)

    def _exchange(self, line: str) -> str:
        # An answer that came too late must not be taken for the next one.
        self.port.reset_input_buffer()
        self.port.write(line.encode() + b"\n")
        if self.options.no_answers:
            return ""
        answer = self.port.readline()
        if not answer.endswith(b"\n"):
            raise Lost(f"no answer to `{line}` within 200 ms")
        text = answer.decode(errors="replace").strip()
        if text.startswith(self.options.error):
            raise Refused(f"the controller answered `{text}` to `{line}`")
        self.answered()
        return text

    def write(self, values: Sequence[Value]) -> None:
        for value in values:
            numbers = " ".join(f"{number:.9g}" for number in (value.value, *value.more))
            line = self.options.set.format(name=self.wired[value.device], value=numbers, control=value.control_type)
            try:
                self._exchange(line)
            except Lost:
                self._exchange(line)

    def read(self, sensor: str) -> float:
        with self._setting:
            return float(self._exchange(self.options.read.format(name=self.wired[sensor])))

    def ask(self) -> None:
        if self.options.no_answers:
            _ = self.port.in_waiting
        else:
            self._exchange(self.options.ask)

    def disconnect(self) -> None:
        self.port.close()


if __name__ == "__main__":
    main(SerialLine)
