"""Moves the joints of an arm of Universal Robots, by the library ur_rtde."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value
from .units import ANGLES, factor

JOINTS = ["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"]
JUMP_MAX_DEG = 20.0
"""A target further away than this is refused: the arm would move there as fast as it can."""


class UrRtde(Hardware):
    """Moves the joints of an arm of Universal Robots, which must be in remote control, by `servoJ`."""

    extra = "ur_rtde"
    package = "ur-rtde"
    target_help = "host name or IP address of the controller"
    place_help = f"one of {', '.join(JOINTS)}; by default the id of the device. Of a sensor: the joint that it measures"
    moves_per_second = 125.0

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--lookahead-s", type=float, default=0.05,
                            help="smoothing of servoJ, 0.03 to 0.2 s; the arm follows later by about this time (default: 0.05)")
        parser.add_argument("--gain", type=float, default=300, help="gain of servoJ, 100 to 2000 (default: 300)")

    def wire(self, device: Device, place: Optional[str]) -> int:
        place = place or device.id
        if place not in JOINTS:
            raise Refused(f"`{place}` is not a joint for `{device.id}`, expected one of {', '.join(JOINTS)}")
        return JOINTS.index(place)

    def connect(self) -> None:
        host = self.options.target
        self.receiver = self.module("rtde_receive").RTDEReceiveInterface(host)
        self.control = self.module("rtde_control").RTDEControlInterface(host)
        self.units = {device.id: math.radians(factor(device, ANGLES)) for device in self.robot.devices.values()}
        self.goal = list(self.receiver.getActualQ())
        self.reported = self.receiver.getTimestamp()

    def write(self, values: Sequence[Value]) -> None:
        self._check_arm()
        goal, actual = list(self.goal), self.receiver.getActualQ()
        for value in values:
            joint = self.wired[value.device]
            goal[joint] = value.value * self.units[value.device]
            away = abs(math.degrees(goal[joint] - actual[joint]))
            if away > JUMP_MAX_DEG:
                raise Refused(f"`{value.device}` is {away:.0f} deg away from {value.value:g}, expected at most {JUMP_MAX_DEG:g}; "
                              "begin the act with a linear movement")
        if not self.control.servoJ(goal, 0.5, 0.5, 1 / self.moves_per_second, self.options.lookahead_s, self.options.gain):
            raise ConnectionError("the controller does not take a target; its control script may have ended")
        self.goal = goal

    def _check_arm(self) -> None:
        if self.receiver.isProtectiveStopped() or self.receiver.isEmergencyStopped():
            raise OSError("the arm is in a protective or emergency stop")

    def position(self, device: str) -> Optional[float]:
        return self.receiver.getActualQ()[self.wired[device]] / self.units[device]

    def read(self, sensor: str) -> float:
        return self.position(sensor) or 0.0

    def ask(self) -> None:
        self._check_arm()
        if not self.control.isProgramRunning():
            raise OSError("the control script on the arm has ended; check that the arm is in remote control")
        reported = self.receiver.getTimestamp()
        if reported == self.reported:
            raise Lost("the controller has reported nothing new")
        self.reported = reported

    def disconnect(self) -> None:
        self.control.servoStop()
        self.control.stopScript()


if __name__ == "__main__":
    main(UrRtde)
