"""Moves hobby servos by a PCA9685 on an I2C bus."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Optional

from .hardware import Hardware, main
from .robot import Device, Value
from .servos import PLACE_HELP, Servo, servo

MODE1, LED0, PRESCALE = 0x00, 0x06, 0xFE
SLEEP, AUTO_INCREMENT, RESTART = 0x10, 0x20, 0x80
OSCILLATOR_HZ, TICKS = 25_000_000, 4096
CHANNELS = 16


class Pca9685(Hardware):
    """Moves hobby servos by a PCA9685, a 16-channel pulse generator on an I2C bus."""

    extra = "pca9685"
    package = "smbus2"
    target_help = "number or path of the I2C bus, such as 1 or /dev/i2c-1"
    place_help = PLACE_HELP
    moves_per_second = 50.0

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--address", type=lambda text: int(text, 0), default=0x40, help="address on the bus (default: 0x40)")
        parser.add_argument("--hz", type=float, default=50.0, help="pulses per second, 24 to 1526 (default: 50)")
        parser.add_argument("--release", action="store_true", help="end the pulses when the driver ends, so that the servos go limp")

    def wire(self, device: Device, place: Optional[str]) -> Optional[Servo]:
        return servo(device, place, CHANNELS)

    def connect(self) -> None:
        bus = self.options.target
        self.bus = self.module("smbus2").SMBus(int(bus) if bus.isdigit() else bus)
        self.prescale = round(OSCILLATOR_HZ / (TICKS * self.options.hz)) - 1
        if self._get(PRESCALE) != self.prescale or self._get(MODE1) & SLEEP:
            # The chip takes the frequency only while it sleeps, which stops all pulses.
            self._put(MODE1, SLEEP | AUTO_INCREMENT)
            self._put(PRESCALE, self.prescale)
        self._put(MODE1, AUTO_INCREMENT)
        self.us_per_tick = 1e6 * (self.prescale + 1) / OSCILLATOR_HZ

    def _get(self, register: int) -> int:
        return int(self.bus.read_byte_data(self.options.address, register))

    def _put(self, register: int, value: int) -> None:
        self.bus.write_byte_data(self.options.address, register, value)

    def write(self, values: Sequence[Value]) -> None:
        for value in values:
            wired = self.wired[value.device]
            ticks = min(TICKS - 1, max(0, round(wired.pulse(value.value) / self.us_per_tick)))
            self._write_channel(wired.channel, ticks)
        # The chip has acknowledged each byte.
        self.answered()

    def _write_channel(self, channel: int, ticks: int) -> None:
        self.bus.write_i2c_block_data(self.options.address, LED0 + 4 * channel, [0, 0, ticks & 0xFF, ticks >> 8])

    def ask(self) -> None:
        # After a loss of power, the chip sleeps.
        if self._get(MODE1) & SLEEP or self._get(PRESCALE) != self.prescale:
            raise OSError("the chip was reset; the servos have no pulses")

    def disconnect(self) -> None:
        if self.options.release:
            for wired in filter(None, self.wired.values()):
                self._write_channel(wired.channel, 0)
        self.bus.close()


if __name__ == "__main__":
    main(Pca9685)
