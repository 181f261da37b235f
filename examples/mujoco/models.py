"""The models that `drive.py` simulates, with servos in place of their motors."""

import importlib.util
import pathlib

import mujoco

# The package with the model, its file, and the stiffness of its servos in newton metres per radian: this example's choice, as stiff as
# the time step of the simulation allows. Each servo is critically damped.
MODELS = {
    "ur5e": ("robosuite", "models/assets/robots/ur5e/robot.xml", [10000] * 3 + [500] * 3),
    "g1": ("robosuite_models", "assets/robots/g1/robot.xml", [200] * 23),
}


def model_of(name: str) -> mujoco.MjModel:
    package, path, stiffness = MODELS[name]
    folder = pathlib.Path(importlib.util.find_spec(package).origin).parent
    spec = mujoco.MjSpec.from_file(str(folder / path))
    for motor, kp in zip(spec.actuators, stiffness):
        motor.forcelimited, motor.forcerange, motor.ctrllimited = True, motor.ctrlrange, False
        motor.set_to_position(kp=kp, dampratio=1)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:  # The humanoid hangs at its pelvis.
            spec.delete(joint)
    for body in spec.bodies:  # Like the controllers of real arms, the servos carry the weight.
        body.gravcomp = 1
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile()
