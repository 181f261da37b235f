"""Drives by writing values to the file argv[1]; in its place would stand the library of your hardware."""

import sys

from downbeat_driver import Driver, Refused, Robot


class Tank(Driver):
    latency_ms = None  # milliseconds from a value to visible motion, once you have measured it

    def start(self, robot: Robot) -> None:
        self.driven = open(sys.argv[1], "a", buffering=1)
        self.log.debug("drives %s", ", ".join(robot.devices))

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        self.driven.write(f"{device} {control_type} {value}\n")

    def read(self, sensor: str) -> float:
        raise Refused("no sensor is connected")

    def ping(self) -> None:
        """Raise an exception here if the hardware does not answer. If it answers and something is wrong, call `self.fault(reason)`."""

    def stop(self) -> None:  # called at the end, if `start` has ended well
        self.driven.close()


if __name__ == "__main__":
    Tank().run()
