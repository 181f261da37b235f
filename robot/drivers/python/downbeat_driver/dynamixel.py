"""Moves Dynamixel servos with protocol 2.0 (X, P and Y series) on a serial bus."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value
from .units import ANGLES, ANGULAR_SPEEDS, bounds, factor

MODE, LIMIT_HIGH, LIMIT_LOW, TORQUE, ERRORS, WATCHDOG = 11, 48, 52, 64, 70, 98
GOAL_SPEED, GOAL_POSITION, POSITION = 104, 116, 132
"""Addresses in the control table of the X series."""
SPEED_MODE, POSITION_MODE, TURNS_MODE = 1, 3, 4
TICKS_PER_DEGREE, MIDDLE = 4096 / 360, 2048
TICKS_PER_DEGREE_PER_S = 1 / (0.229 * 6)
TRIES_AT_FIRST, TRIES = 20, 2
"""How often a question is asked before its answer is lost: each try takes some 40 ms. Values should not wait longer."""
WATCHDOG_UNIT_MS, WATCHDOG_MS = 20, 1000
"""If the bus is silent for this time, servos in speed mode stop by themselves."""


class Dynamixel(Hardware):
    """Moves Dynamixel servos with protocol 2.0; those that are due at the same instant in one packet. 0 degrees are the middle."""

    extra = "dynamixel"
    package = "dynamixel-sdk"
    target_help = "the serial port, such as /dev/ttyUSB0"
    place_help = "id of the servo, 0 to 252; a sensor reads the position of the servo"

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--baud", type=int, default=57600, help="bits per second (default: 57600)")
        parser.add_argument("--release", action="store_true", help="switch the torque off when the driver ends, so that the servos go limp")

    def wire(self, device: Device, place: Optional[str]) -> int:
        if place is None or not place.isdigit() or int(place) > 252:
            raise Refused(f"`{place}` is not a place for `{device.id}`, expected the id of a servo, 0 to 252, for example {device.id}=1")
        return int(place)

    def connect(self) -> None:
        self.sdk = self.module("dynamixel_sdk")
        self.port = self.sdk.PortHandler(self.options.target)
        if not self.port.openPort() or not self.port.setBaudRate(self.options.baud):
            raise ConnectionError(f"{self.options.target} cannot be opened with {self.options.baud} bits per second")
        self.packets = self.sdk.PacketHandler(2.0)
        self.driven = [device for device in self.robot.devices.values() if not device.is_sensor]
        self.next_asked = 0
        self.tries = TRIES_AT_FIRST
        for device in self.robot.devices.values():
            self._get(self.wired[device.id], MODE, 1)
        for device in self.driven:
            self._prepare(device, self.wired[device.id])
        self.tries = TRIES

    def _prepare(self, device: Device, servo: int) -> None:
        mode = self._get(servo, MODE, 1)
        turns = "speed" in device.control_types
        if turns != (mode == SPEED_MODE) or mode not in (SPEED_MODE, POSITION_MODE, TURNS_MODE):
            wanted = SPEED_MODE if turns else f"{POSITION_MODE} or {TURNS_MODE}"
            raise Refused(f"servo {servo} of `{device.id}` has the operating mode {mode}, expected {wanted}; change it with Dynamixel Wizard")
        if mode == POSITION_MODE:
            low, high = (self._degrees(self._get(servo, limit, 4)) for limit in (LIMIT_LOW, LIMIT_HIGH))
            lowest, highest = (bound * factor(device, ANGLES) for bound in bounds(device, "position"))
            if lowest < low - 0.1 or highest > high + 0.1:
                raise Refused(f"device `{device.id}` may go from {lowest:g} to {highest:g} deg, but servo {servo} from {low:.1f} to {high:.1f}; "
                              "change `min_value` and `max_value` in its description")
        if not self._get(servo, TORQUE, 1):
            # Otherwise the servo would move to an old goal.
            if not turns:
                self._put(servo, GOAL_POSITION, 4, self._get(servo, POSITION, 4))
            self._put(servo, TORQUE, 1, 1)
        if turns:
            self._put(servo, WATCHDOG, 1, 0)
            self._put(servo, WATCHDOG, 1, WATCHDOG_MS // WATCHDOG_UNIT_MS)

    def _get(self, servo: int, address: int, size: int) -> int:
        read = {1: self.packets.read1ByteTxRx, 4: self.packets.read4ByteTxRx}[size]
        value, result, error = self._repeat(read, servo, address)
        self._verify(servo, result, error)
        return value - (1 << 32) if size == 4 and value >= 1 << 31 else value

    def _put(self, servo: int, address: int, size: int, value: int) -> None:
        write = {1: self.packets.write1ByteTxRx, 4: self.packets.write4ByteTxRx}[size]
        self._verify(servo, *self._repeat(write, servo, address, value & 0xFFFFFFFF))

    def _repeat(self, call: Any, *arguments: int) -> Any:
        """Asks again if a packet was lost."""
        for _ in range(self.tries):
            answer = call(self.port, *arguments)
            if answer[-2] == self.sdk.COMM_SUCCESS:
                break
        return answer

    def _verify(self, servo: int, result: int, error: int) -> None:
        if result != self.sdk.COMM_SUCCESS:
            raise Lost(f"servo {servo} does not answer: {self.packets.getTxRxResult(result)}")
        if error & 0x80:
            bits = self._get_errors(servo)
            raise OSError(f"servo {servo} reports a hardware error, bits {bits:#04x}; its manual explains *Hardware Error Status*")
        self.answered()

    def _get_errors(self, servo: int) -> int:
        return int(self.packets.read1ByteTxRx(self.port, servo, ERRORS)[0])

    def write(self, values: Sequence[Value]) -> None:
        for control_type, address in (("position", GOAL_POSITION), ("speed", GOAL_SPEED)):
            goals = [(self.wired[value.device], self._ticks(value)) for value in values if value.control_type == control_type]
            if goals:
                packet = self.sdk.GroupSyncWrite(self.port, self.packets, address, 4)
                for servo, ticks in goals:
                    packet.addParam(servo, list((ticks & 0xFFFFFFFF).to_bytes(4, "little")))
                if packet.txPacket() != self.sdk.COMM_SUCCESS:
                    raise ConnectionError("the serial port did not take a packet")

    def _ticks(self, value: Value) -> int:
        device = self.robot.devices[value.device]
        if value.control_type == "speed":
            return round(value.value * factor(device, ANGULAR_SPEEDS) * TICKS_PER_DEGREE_PER_S)
        return MIDDLE + round(value.value * factor(device, ANGLES) * TICKS_PER_DEGREE)

    @staticmethod
    def _degrees(ticks: int) -> float:
        return (ticks - MIDDLE) / TICKS_PER_DEGREE

    def position(self, device: str) -> Optional[float]:
        ticks = self._get(self.wired[device], POSITION, 4)
        return self._degrees(ticks) / factor(self.robot.devices[device], ANGLES)

    def read(self, sensor: str) -> float:
        with self._setting:
            return self.position(sensor) or 0.0

    def ask(self) -> None:
        # One servo at a time, because each answer occupies the bus.
        device = self.driven[self.next_asked % len(self.driven)]
        self.next_asked += 1
        if not self._get(self.wired[device.id], TORQUE, 1):
            raise OSError(f"servo {self.wired[device.id]} of `{device.id}` has no torque: it was switched off or lost its power")

    def disconnect(self) -> None:
        for device in self.driven if self.options.release else []:
            self._put(self.wired[device.id], TORQUE, 1, 0)
        self.port.closePort()


if __name__ == "__main__":
    main(Dynamixel)
