"""Drives a Reachy Mini through its maker's daemon, which must run on this machine. Angles are degrees."""

import math
from collections.abc import Sequence

from downbeat_driver import Driver, Refused, Robot, Value
from reachy_mini import ReachyMini
from reachy_mini.utils import create_head_pose


class Reachy(Driver):
    def start(self, robot: Robot) -> None:
        self.target = {device.id: device.default_value for device in robot.devices.values() if not device.is_sensor}
        self.reachy = ReachyMini(connection_mode="localhost_only", media_backend="no_media", automatic_body_yaw=False)

    def set_frame(self, values: Sequence[Value]) -> None:
        self.target.update({value.device: value.value for value in values})
        to = self.target
        self.reachy.set_target(
            head=create_head_pose(roll=to["head_roll"], pitch=to["head_pitch"], yaw=to["head_yaw"]),
            antennas=[math.radians(to["right_antenna"]), math.radians(to["left_antenna"])],
            body_yaw=math.radians(to["body_yaw"]),
        )

    def read(self, sensor: str) -> float:
        head, (right, left) = self.reachy.get_current_joint_positions()
        angles = {"body_yaw_angle": head[0], "right_antenna_angle": right, "left_antenna_angle": left}
        if sensor not in angles:
            raise Refused(f"there is no `{sensor}`")
        return round(math.degrees(angles[sensor]), 4)

    def ping(self) -> None:
        if not self.reachy.client._is_alive:
            raise Refused("the daemon has gone")

    def stop(self) -> None:
        self.reachy.client.disconnect()


if __name__ == "__main__":
    Reachy().run()
