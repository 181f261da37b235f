"""Drives a Reachy Mini through its maker's daemon, which must run on this machine. Angles are degrees."""

import math
import threading
import time

from downbeat_driver import Driver, Refused, Robot
from reachy_mini import ReachyMini
from reachy_mini.utils import create_head_pose

PERIOD = 0.004
"""Seconds between two targets."""


class Reachy(Driver):
    def start(self, robot: Robot) -> None:
        self.moves: dict[str, tuple] = {}  # when each device began to move, from which and to which position, and in how many seconds
        for device in robot.devices.values():
            if not device.is_sensor:
                self.set(device.id, "position", device.default_value)
        self.reachy = ReachyMini(connection_mode="localhost_only", media_backend="no_media", automatic_body_yaw=False)
        self.ended, self.thread = threading.Event(), threading.Thread(target=self.stream)
        self.thread.start()

    def stream(self) -> None:
        """Sends each change to the daemon. The daemon reads the target 50 times a second, and the target should be fresh then."""
        sent = {}
        while not self.ended.wait(PERIOD):
            to = {device: self.target(device) for device in self.moves}
            if to != sent:
                self.reachy.set_target(
                    head=create_head_pose(roll=to["head_roll"], pitch=to["head_pitch"], yaw=to["head_yaw"]),
                    antennas=[math.radians(to["right_antenna"]), math.radians(to["left_antenna"])],
                    body_yaw=math.radians(to["body_yaw"]),
                )
            sent = to

    def target(self, device: str) -> float:
        since, at, to, seconds = self.moves[device]
        return at + (to - at) * min(1, (time.monotonic() - since) / seconds) if seconds else to

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        self.moves[device] = (0, value, value, 0)

    def ramp(self, device: str, control_type: str, value: float, seconds: float) -> None:
        self.moves[device] = (time.monotonic(), self.target(device), value, seconds)

    def read(self, sensor: str) -> float:
        # The daemon publishes the joint positions 50 times a second. Waits for the next ones, so that the answer is fresh.
        told = self.reachy.client.joint_position_received
        told.clear()
        if not told.wait(0.5):
            raise Refused("the daemon does not tell where the joints are")
        head, (right, left) = self.reachy.get_current_joint_positions()
        angles = {"body_yaw_angle": head[0], "right_antenna_angle": right, "left_antenna_angle": left}
        if sensor not in angles:
            raise Refused(f"there is no `{sensor}`")
        return round(math.degrees(angles[sensor]), 4)

    def ping(self) -> None:
        if not self.thread.is_alive():
            raise Refused("the daemon takes no targets")

    def stop(self) -> None:
        self.ended.set()
        self.thread.join()
        self.reachy.client.disconnect()


if __name__ == "__main__":
    Reachy().run()
