"""Compares an imported scenario with Blender's own curves: `blender -b FILE.blend --python compare.py -- SCENARIO.yaml`.

The exporter has Blender evaluate complete objects; this script evaluates the curves of their channels one by one.
"""

import math
import re
import sys

import bpy
import mathutils

# The error of single precision at values of this size.
ALLOWED = {"m": 2e-6, "degrees": 4e-4, "of 255": 5e-2}
AXES = {"x": ("location", 0), "y": ("location", 1), "z": ("location", 2),
        "rx": ("rotation_euler", 0), "ry": ("rotation_euler", 1), "rz": ("rotation_euler", 2)}


def keyframes(path):
    """Seconds and values per robot and device."""
    found, robot, device = {}, None, None
    for line in open(path, encoding="utf-8"):
        if match := re.match(r"\s*(?:- )?robots: (.+)", line):
            robot = match[1].strip().strip("\"'")
        elif match := re.match(r"\s*- \{at: (\d+(?:\.\d+)?)(ms|s), to: (\[.*\]|[^,}]+)", line):
            at = float(match[1]) / (1000 if match[2] == "ms" else 1)
            for part, value in enumerate(match[3].strip("[]").split(",")):
                name = f"{device}.{part}" if match[3].startswith("[") else device
                found.setdefault((robot, name), []).append((at, float(value)))
        elif match := re.match(r"\s*\"?([^\s\"]+)\"?:\s*$", line):
            device = match[1]
    return found


def encoded(linear):
    """A color component in sRGB encoding."""
    return mathutils.Color((linear, 0, 0)).from_scene_linear_to_srgb().r


def unit_of(device):
    part = device.rpartition(".")[2]
    return "of 255" if device.startswith("lamp.") else "degrees" if part.startswith("r") else "m"


def curve(robot, device):
    """A function from the frame to the device's expected value, from the curves of the device's own channel; zero if it has no curve."""
    item = bpy.data.objects[robot]
    if robot == "Rider":
        table = bpy.data.objects["Table"].animation_data.action.fcurves[0]
        return {"rz": lambda frame: math.degrees(table.evaluate(frame)),
                "x": lambda frame: math.cos(table.evaluate(frame)),
                "y": lambda frame: math.sin(table.evaluate(frame))}.get(device, lambda frame: 0.0)
    bone, _, axis = device.rpartition(".")
    if bone == "lamp":
        color = item.data.animation_data.action.fcurves.find("color", index=int(axis))
        return lambda frame: 255 * encoded(color.evaluate(frame))
    path, index = AXES[axis]
    path = f'pose.bones["{bone}"].{path}' if bone else path
    found = item.animation_data.action.fcurves.find(path, index=index)
    if found is None:
        return lambda frame: 0.0
    return lambda frame: math.degrees(found.evaluate(frame)) if axis.startswith("r") else found.evaluate(frame)


def main():
    scenario = sys.argv[sys.argv.index("--") + 1]
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    imported = keyframes(scenario)
    lines, between, compared = dict.fromkeys(ALLOWED, 0.0), dict.fromkeys(ALLOWED, 0.0), 0
    for (robot, device), values in imported.items():
        unit, wanted = unit_of(device), curve(robot, device)

        def off(at, value):
            return abs(wanted(scene.frame_start + at * rate) - value)

        for at, to in values:
            lines[unit] = max(lines[unit], off(at, to))
            compared += 1
        for (at, to), (next_at, next_to) in zip(values, values[1:]):
            if unit == "of 255":
                continue
            for part in range(1, 8):
                straight = to + (next_to - to) * part / 8
                between[unit] = max(between[unit], off(at + (next_at - at) * part / 8, straight))
    told = ", ".join(f"{value:.2g} {unit}" for unit, value in lines.items())
    print(f"{len(imported)} channels, {compared} values compared with Blender's own curves: largest deviation {told}; "
          f"on the straight ways between them {between['m']:.2g} m, {between['degrees']:.2g} degrees")
    if compared < 1000 or any(lines[unit] > allowed for unit, allowed in ALLOWED.items()):
        sys.exit("error: the scenario is not what Blender plays")


try:
    main()
except SystemExit:
    raise
except Exception as error:  # noqa: BLE001
    sys.exit(f"error: {error!r}")
