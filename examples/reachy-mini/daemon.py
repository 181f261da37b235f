"""The maker's daemon with a log of its simulator: `daemon.py LOG --sim --headless --no-media`.

LOG becomes a CSV file with one line for each step of the simulation: nanoseconds of the host's clock, seconds of the simulation, and the
degrees of each motorized joint.
"""

import sys
import time

import mujoco
import numpy as np
from reachy_mini.daemon.app.main import main

step, log = mujoco.mj_step, open(sys.argv.pop(1), "w", buffering=1)
columns: list[int] = []


def logged(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    step(model, data)
    if not columns:
        joints = [model.joint(joint) for joint in model.actuator_trnid[:, 0]]
        columns.extend(joint.qposadr[0] for joint in joints)
        print("host_ns,simulated_s", *(joint.name for joint in joints), sep=",", file=log)
    degrees = np.round(np.degrees(data.qpos[columns]), 4)
    print(time.time_ns(), f"{data.time:.3f}", *degrees, sep=",", file=log)


if __name__ == "__main__":
    mujoco.mj_step = logged
    main()
