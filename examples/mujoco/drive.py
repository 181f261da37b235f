"""Drives a robot that MuJoCo simulates: `drive.py MODEL LOG`, where MODEL is `ur5e` or `g1`.

LOG becomes a CSV file with one line for each step of the simulation: nanoseconds of the host's clock, seconds of the simulation, and the
degrees of each joint.
"""

import sys
import threading
import time

import mujoco
import numpy as np
from downbeat_driver import Driver, Refused, Robot
from models import model_of

class Simulated(Driver):
    def start(self, robot: Robot) -> None:
        self.model = model_of(sys.argv[1])
        self.data = mujoco.MjData(self.model)
        self.ended, self.thread = threading.Event(), threading.Thread(target=self.simulate)
        self.moves: dict[str, tuple] = {}  # when each joint began to move, from which and to which position, and in how many seconds
        self.at = {}
        for joint in (device for device in robot.devices.values() if not device.is_sensor):
            self.at[joint.id] = self.model.joint(joint.id + "_joint").qposadr[0]
            self.data.qpos[self.at[joint.id]] = np.radians(joint.default_value)
            self.set(joint.id, "position", joint.default_value)
        self.thread.start()

    def simulate(self) -> None:
        columns, begin = list(self.at.values()), time.monotonic() - self.data.time
        servo = {self.model.joint(i).qposadr[0]: a for a, i in enumerate(self.model.actuator_trnid[:, 0])}
        with open(sys.argv[2], "w") as log:
            print("host_ns,simulated_s", *self.at, sep=",", file=log)
            while not self.ended.is_set():
                for joint, column in self.at.items():
                    self.data.ctrl[servo[column]] = np.radians(self.target(joint))
                mujoco.mj_step(self.model, self.data)
                degrees = np.round(np.degrees(self.data.qpos[columns]), 4)
                print(time.time_ns(), f"{self.data.time:.3f}", *degrees, sep=",", file=log)
                time.sleep(max(0, begin + self.data.time - time.monotonic()))

    def target(self, joint: str) -> float:
        since, at, to, seconds = self.moves[joint]
        return at + (to - at) * min(1, (time.monotonic() - since) / seconds) if seconds else to

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        self.moves[device] = (0, value, value, 0)

    def ramp(self, device: str, control_type: str, value: float, seconds: float) -> None:
        self.moves[device] = (time.monotonic(), self.target(device), value, seconds)

    def read(self, sensor: str) -> float:
        return round(float(np.degrees(self.data.qpos[self.at[sensor.removesuffix("_angle")]])), 4)

    def ping(self) -> None:
        if not self.thread.is_alive():
            raise Refused("the simulation has ended")

    def stop(self) -> None:
        self.ended.set()


if __name__ == "__main__":
    Simulated().run()
