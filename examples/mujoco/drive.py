"""Drives a robot that MuJoCo simulates: `drive.py MODEL LOG`, where MODEL is `ur5e` or `g1`.

LOG becomes a CSV file with a line for each step of the simulation: nanoseconds of the host's clock, seconds of the simulation, and
the degrees of each joint.
"""

import importlib.util
import pathlib
import sys
import threading
import time

import mujoco
import numpy as np
from downbeat_driver import Driver, Refused, Robot

# The package with the model, its file, and the stiffness of its servos in newton metres for a radian: this example's choice, as stiff as
# the steps of the simulation allow. Each servo is damped critically.
MODELS = {
    "ur5e": ("robosuite", "models/assets/robots/ur5e/robot.xml", [10000] * 3 + [500] * 3),
    "g1": ("robosuite_models", "assets/robots/g1/robot.xml", [200] * 23),
}


def model_of(name: str) -> mujoco.MjModel:
    package, path, stiffness = MODELS[name]
    spec = mujoco.MjSpec.from_file(str(pathlib.Path(importlib.util.find_spec(package).origin).parent / path))
    for motor, kp in zip(spec.actuators, stiffness):
        motor.forcelimited, motor.forcerange, motor.ctrllimited = True, motor.ctrlrange, False
        motor.set_to_position(kp=kp, dampratio=1)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:  # The humanoid hangs at its pelvis.
            spec.delete(joint)
    for body in spec.bodies:  # As controllers of arms do, the servos carry the weight.
        body.gravcomp = 1
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()


class Simulated(Driver):
    def start(self, robot: Robot) -> None:
        self.model = model_of(sys.argv[1])
        self.data = mujoco.MjData(self.model)
        self.joints = [device for device in robot.devices.values() if not device.is_sensor]
        self.at = {joint.id: self.model.joint(joint.id + "_joint").qposadr[0] for joint in self.joints}
        self.servos = {self.model.joint(i).name: a for a, i in enumerate(self.model.actuator_trnid[:, 0])}
        for joint in self.joints:
            self.set(joint.id, "position", joint.default_value)
            self.data.qpos[self.at[joint.id]] = np.radians(joint.default_value)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.simulate)
        self.thread.start()

    def simulate(self) -> None:
        columns, begin = list(self.at.values()), time.monotonic() - self.data.time
        with open(sys.argv[2], "w") as log:
            print("host_ns,simulated_s", *self.at, sep=",", file=log)
            while not self.ended.is_set():
                mujoco.mj_step(self.model, self.data)
                degrees = np.degrees(self.data.qpos[columns])
                print(time.time_ns(), f"{self.data.time:.3f}", *np.round(degrees, 4), sep=",", file=log)
                time.sleep(max(0, begin + self.data.time - time.monotonic()))

    def set(self, device: str, control_type: str, value: float, *more: float) -> None:
        self.data.ctrl[self.servos[device + "_joint"]] = np.radians(value)

    def read(self, sensor: str) -> float:
        return round(float(np.degrees(self.data.qpos[self.at[sensor.removesuffix("_angle")]])), 4)

    def ping(self) -> None:
        if not self.thread.is_alive():
            raise Refused("the simulation has ended")

    def stop(self) -> None:
        self.ended.set()


if __name__ == "__main__":
    Simulated().run()
