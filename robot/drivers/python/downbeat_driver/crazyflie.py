"""Flies a Crazyflie with position setpoints, by its maker's library."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Sequence
from typing import Any, Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value
from .units import ANGLES, LENGTHS, factor

AXES = {"x": "stateEstimate.x", "y": "stateEstimate.y", "z": "stateEstimate.z", "yaw": "stateEstimate.yaw"}
"""The variable of the drone's estimate for each axis."""
REPORT_MS = 50
LANDING_M_PER_S = TAKE_OFF_M_PER_S = 0.3
TAKE_OFF_SPARE_S = 3.0
"""How much longer a take-off may last than planned."""


class Crazyflie(Hardware):
    """Flies a Crazyflie to positions of x, y and z in metres and yaw in degrees. Arms with the first value, and lands at the end."""

    extra = "crazyflie"
    package = "cflib"
    target_help = "address of the drone, such as radio://0/80/2M/E7E7E7E7E7"
    place_help = "x, y, z or yaw; by default the id of the device. Of a sensor: a log variable, such as pm.vbat"
    moves_per_second = 50.0
    repeat_s = 0.05
    hardware_silence_ms = 1000

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--take-off", type=float, metavar="METRES",
                            help="take off to this height before the driver is ready, for example to measure the drone by `downbeat calibrate`; "
                            "it needs a longer --driver-start-timeout")

    def wire(self, device: Device, place: Optional[str]) -> str:
        place = place or device.id
        if device.is_sensor:
            return AXES.get(place, place)
        if place not in AXES:
            raise Refused(f"`{place}` is not an axis for `{device.id}`, expected one of {', '.join(AXES)}")
        return place

    def connect(self) -> None:
        crtp = self.module("cflib.crtp")
        log = self.module("cflib.crazyflie.log")
        crtp.init_drivers()
        self.drone = self.module("cflib.crazyflie").Crazyflie()
        self.units = {device.id: factor(device, ANGLES if self.wired[device.id] == "yaw" else LENGTHS)
                      for device in self.robot.devices.values() if not device.is_sensor}
        self.estimate: dict[str, float] = {}
        self.goal: dict[str, float] = {}
        ready, reported = threading.Event(), threading.Event()
        self.failure = "it does not answer"
        self.drone.connected.add_callback(lambda _: ready.set())
        self.drone.connection_failed.add_callback(lambda _, reason: self._fail(reason, ready))
        self.drone.connection_lost.add_callback(lambda _, reason: self._ended or self.fault(f"the link to the drone is lost: {reason.splitlines()[0]}"))
        self.drone.open_link(self.options.target)
        if not ready.wait(8) or not self.drone.is_connected():
            raise ConnectionError(f"{self.options.target}: {self.failure.splitlines()[0]}")
        self._report(log, list(AXES.values()), lambda values: (self.estimate.update(values), self.answered(), reported.set()))
        for sensor, variable in self.wired.items():
            if self.robot.devices[sensor].is_sensor:
                self._report(log, [variable], lambda values, sensor=sensor: self.push_reading(sensor, *values.values()))
        if not reported.wait(1):
            raise ConnectionError("the drone does not report its position; it needs a positioning system, such as a Flow deck")
        self.has_armed = False
        if self.options.take_off:
            self._take_off(self.options.take_off)

    def _arm(self) -> None:
        if not self.has_armed:
            self.drone.supervisor.send_arming_request(True)
            self.has_armed = True

    def _take_off(self, height: float) -> None:
        """Takes off, and returns when the drone is at this height. It hovers there by itself."""
        self._arm()
        seconds = max(1.0, height / TAKE_OFF_M_PER_S)
        self.drone.high_level_commander.takeoff(height, seconds)
        until = time.monotonic() + seconds + TAKE_OFF_SPARE_S
        while self.estimate[AXES["z"]] < 0.9 * height:
            if time.monotonic() > until:
                self.disconnect()
                raise OSError(f"the drone has not reached {height:g} m, but {self.estimate[AXES['z']]:.2f} m; it lands")
            time.sleep(0.02)

    def _fail(self, reason: str, ready: threading.Event) -> None:
        self.failure = reason
        ready.set()

    def _report(self, log: Any, variables: list[str], take: Any) -> None:
        """Lets the drone report variables by itself."""
        block = log.LogConfig(variables[0], period_in_ms=REPORT_MS)
        for variable in variables:
            block.add_variable(variable, "float")
        try:
            self.drone.log.add_config(block)
        except (KeyError, AttributeError) as error:
            raise Refused(f"the drone has no log variable of {', '.join(variables)}: {error}") from error
        block.data_received_cb.add_callback(lambda _time, values, _block: take(values))
        block.start()

    def write(self, values: Sequence[Value]) -> None:
        if not self.goal:
            self.goal = {axis: self.estimate[variable] for axis, variable in AXES.items()}
            self._arm()
        for value in values:
            self.goal[self.wired[value.device]] = value.value * self.units[value.device]
        self.drone.commander.send_position_setpoint(*(self.goal[axis] for axis in AXES))

    def position(self, device: str) -> Optional[float]:
        return self.estimate[AXES[self.wired[device]]] / self.units[device]

    def ask(self) -> None:
        raise Lost("the drone has not reported its position")

    def disconnect(self) -> None:
        height = self.estimate.get(AXES["z"], 0.0)
        if self.has_armed:
            # The drone lands by itself, even if this program ends before.
            self.drone.commander.send_notify_setpoint_stop()
            self.drone.high_level_commander.land(0.0, max(1.0, height / LANDING_M_PER_S))
            time.sleep(0.1)
        # `close_link` would switch the motors off in the air.
        if self.drone.link is not None:
            self.drone.link.close()


if __name__ == "__main__":
    main(Crazyflie)
