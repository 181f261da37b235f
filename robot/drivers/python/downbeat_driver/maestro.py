"""Moves hobby servos by a Pololu Maestro on a serial port."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value
from .servos import PLACE_HELP, Servo, servo

SET_TARGET, GET_POSITION, GET_ERRORS = 0x84, 0x90, 0xA1
CHANNELS = 24
QUARTERS = 4
"""The unit of targets is a quarter of a microsecond."""


class Maestro(Hardware):
    """Moves hobby servos by a Pololu Maestro in the serial mode `USB Dual Port` or `UART`."""

    extra = "serial"
    package = "pyserial"
    target_help = "the command port of the controller, such as /dev/ttyACM0"
    place_help = PLACE_HELP
    moves_per_second = 50.0

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--baud", type=int, default=115200, help="bits per second of a UART (default: 115200)")

    def wire(self, device: Device, place: Optional[str]) -> Optional[Servo]:
        return servo(device, place, CHANNELS)

    def connect(self) -> None:
        serial = self.module("serial")
        self.port = serial.Serial(self.options.target, self.options.baud, timeout=0.1, write_timeout=0.5)
        self.ask_until_answered(2.0)

    def _question(self, command: bytes) -> int:
        self.port.reset_input_buffer()
        self.port.write(command)
        answer = self.port.read(2)
        if len(answer) < 2:
            raise Lost("the controller did not answer within 100 ms")
        self.answered()
        return int.from_bytes(answer, "little")

    def write(self, values: Sequence[Value]) -> None:
        line = bytearray()
        for value in values:
            wired = self.wired[value.device]
            target = round(wired.pulse(value.value) * QUARTERS)
            line += bytes([SET_TARGET, wired.channel, target & 0x7F, target >> 7 & 0x7F])
        self.port.write(line)
        self.port.flush()

    def _position(self, device: str) -> Optional[float]:
        wired = self.wired[device]
        quarters = self._question(bytes([GET_POSITION, wired.channel]))
        return wired.value(quarters / QUARTERS) if quarters else None

    def position(self, device: str) -> Optional[float]:
        return self._position(device)

    def read(self, sensor: str) -> float:
        with self._setting:
            at = None if self.wired[sensor] is None else self._position(sensor)
        if at is None:
            raise Refused(f"the channel of `{sensor}` has no pulse yet")
        return at

    def ask(self) -> None:
        errors = self._question(bytes([GET_ERRORS]))
        if errors:
            raise OSError(f"the controller reports errors, bits {errors:#06x} (page *Serial Error* of its manual)")

    def disconnect(self) -> None:
        self.port.close()


if __name__ == "__main__":
    main(Maestro)
