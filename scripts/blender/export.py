"""Writes what moves in a Blender file as a CSV that `downbeat import csv` reads: a robot for each object, a line for each frame.

    blender -b show.blend --python export.py -- --output show.csv [--rate HZ] [--objects NAME,NAME]
    downbeat import csv show.csv --time "Time [ms]" --map "*=*" --output show

Values are those of Blender's own evaluation, with parents, constraints and drivers: an object's place and its rotation in the
world, in metres and degrees, and a bone's place and rotation relative to its rest pose. Each line is evaluated at the whole
millisecond that stands in it, so no time is off. docs/import-formats.md has the rules.
"""

import argparse
import csv
import math
import re
import sys

import bpy

# A turn that is larger between two lines may have been in the opposite direction.
TURN_MAX = math.radians(120)
# Smaller changes are the noise of single precision.
STILL = 1e-6


def arguments():
    """What stands behind `--` on Blender's command line."""
    parser = argparse.ArgumentParser(prog="blender -b FILE.blend --python export.py --", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", required=True, metavar="FILE", help="the CSV")
    parser.add_argument("--rate", type=float, metavar="HZ", help="lines a second; otherwise one for each frame")
    parser.add_argument("--objects", metavar="NAME,NAME", help="these objects; otherwise all that move")
    behind = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    options = parser.parse_args(behind)
    if options.rate is not None and not 0.001 <= options.rate <= 1000:
        parser.error("--rate is from 0.001 to 1000 Hz")
    return options


def note(text):
    """Said on standard error, as `downbeat import` says its notes."""
    print(f"note: {text}", file=sys.stderr)


def times_ms(scene, rate):
    """Whole milliseconds from the scene's first frame to its last."""
    seconds = (scene.frame_end - scene.frame_start) * scene.render.fps_base / scene.render.fps
    a_second = rate or scene.render.fps / scene.render.fps_base
    count = math.floor(seconds * a_second + 1e-6)
    times = [round(index * 1000 / a_second) for index in range(count + 1)]
    return sorted({*times, round(seconds * 1000)})


def go_to(scene, at_ms):
    """Has Blender evaluate everything at a time, also between two frames."""
    frame = scene.frame_start + at_ms / 1000 * scene.render.fps / scene.render.fps_base
    whole = math.floor(frame)
    scene.frame_set(whole, subframe=min(frame - whole, 0.999999))


class Channels:
    """Columns that belong together: they are written if one of them changes."""

    def __init__(self, names, unit, read):
        self.names, self.unit, self.read, self.rows = names, unit, read, []

    def take(self):
        self.rows.append(tuple(self.read()))

    def moves(self):
        return any(abs(value - first) > STILL for row in self.rows for value, first in zip(row, self.rows[0]))

    def headers(self):
        return [f"{name} [{self.unit}]" if self.unit else name for name in self.names]


class Rotation(Channels):
    """Euler angles in degrees that go on beyond a turn."""

    def __init__(self, names, angles, order, matrix):
        super().__init__(names, "deg", self.degrees)
        # Plain angles are taken as they are, however fast they turn. Others come from a matrix, which knows no turns.
        self.angles, self.order, self.matrix, self.before, self.fast = angles, order, matrix, None, False

    def degrees(self):
        if self.angles:
            now = self.angles()
        else:
            # To the angles next to those of the line before.
            now = self.matrix().to_euler(self.order, self.before) if self.before else self.matrix().to_euler(self.order)
            self.fast |= self.before is not None and any(abs(a - b) > TURN_MAX for a, b in zip(now, self.before))
            self.before = now.copy()
        return [math.degrees(angle) for angle in now]


def is_driven(holder):
    """Whether something else than its own channels moves it."""
    return bool(holder.constraints) or getattr(holder, "parent", None) is not None


def euler_order(holder):
    return holder.rotation_mode if holder.rotation_mode not in {"QUATERNION", "AXIS_ANGLE"} else None


def of_object(item, graph):
    """The channels of an object: `x`, `y`, `z` and `rx`, `ry`, `rz`."""
    def evaluated():
        return item.evaluated_get(graph())

    order = euler_order(item)
    plain = order and not is_driven(item) and item.delta_rotation_euler.to_quaternion().angle < STILL
    angles = (lambda: evaluated().rotation_euler) if plain else None
    rotation = Rotation(["rx", "ry", "rz"], angles, order or "XYZ", lambda: evaluated().matrix_world)
    return [Channels(["x", "y", "z"], "m", lambda: evaluated().matrix_world.translation), rotation]


def of_bone(item, name, graph):
    """The same of a bone, relative to its rest pose and its parent: `BONE.rx`."""
    def evaluated():
        return item.evaluated_get(graph()).pose.bones[name]

    def local():
        bone = evaluated()
        return item.evaluated_get(graph()).convert_space(
            pose_bone=bone, matrix=bone.matrix, from_space="POSE", to_space="LOCAL")

    bone = item.pose.bones[name]
    order = euler_order(bone)
    angles = (lambda: evaluated().rotation_euler) if order and not bone.constraints else None
    rotation = Rotation([f"{name}.{axis}" for axis in ("rx", "ry", "rz")], angles, order or "XYZ", local)
    return [Channels([f"{name}.{axis}" for axis in "xyz"], "m", lambda: local().translation), rotation]


def byte_of(linear):
    """A colour's part from 0 to 1, as light adds up, as the 0 to 255 that Blender's own colour picker shows as hex."""
    linear = min(max(linear, 0.0), 1.0)
    encoded = 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055
    return 255 * encoded


def emission_of(material):
    """What the first node of a material emits, times its strength up to 1; else the colour that the viewport shows."""
    nodes = material.node_tree.nodes if material.use_nodes and material.node_tree else []
    for node in nodes:
        color = node.inputs.get("Emission Color") or node.inputs.get("Emission") or (
            node.inputs.get("Color") if node.type == "EMISSION" else None)
        if color is None:
            continue
        strength = node.inputs.get("Emission Strength") or node.inputs.get("Strength")
        factor = min(max(strength.default_value, 0.0), 1.0) if strength else 1.0
        return [part * factor for part in list(color.default_value)[:3]]
    return list(material.diffuse_color)[:3]


def of_colour(item, graph):
    """`Red`, `Green`, `Blue` of a lamp, with its `energy`, or of what the first material emits; of neither, nothing."""
    def evaluated():
        return item.evaluated_get(graph())

    names = ["Red", "Green", "Blue"]
    if item.type == "LIGHT":
        return [Channels(names, "", lambda: map(byte_of, evaluated().data.color)),
                Channels(["energy"], "W", lambda: [evaluated().data.energy])]
    if item.active_material is None:
        return []
    return [Channels(names, "", lambda: map(byte_of, emission_of(evaluated().active_material)))]


def chosen(scene, names):
    """The requested objects, or all visible ones."""
    if names is None:
        return [item for item in scene.objects if not item.hide_render]
    unknown = [name for name in names if name not in scene.objects]
    if unknown:
        sys.exit(f"error: the scene has no object {', '.join(unknown)}")
    return [scene.objects[name] for name in names]


def robot_name(name):
    """An object's name as it can stand in a column's: `Drone 1/x [m]` is `x` of the robot `Drone 1`."""
    return re.sub(r"[/,*\[\]()\x00-\x1f]", "_", name).strip()


def plain(value, unit):
    """As many digits after the point as single precision knows of a metre, or of a turn in degrees."""
    digits = 7 if unit == "m" else 5
    return f"{round(value, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def write(path, times, columns):
    """A line for each time; columns are robots with their channels."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        headers = [f"{robot}/{name}" for robot, group in columns for name in group.headers()]
        table.writerow(["Time [ms]"] + headers)
        for index, at_ms in enumerate(times):
            table.writerow([at_ms] + [plain(value, group.unit) for _, group in columns for value in group.rows[index]])


def main():
    options = arguments()
    scene = bpy.context.scene
    graph = bpy.context.evaluated_depsgraph_get
    items = chosen(scene, options.objects.split(",") if options.objects else None)
    plan = []
    for item in items:
        groups = of_object(item, graph)
        for bone in item.pose.bones if item.pose else []:
            groups += of_bone(item, bone.name, graph)
        plan.append((item, groups + of_colour(item, graph)))
    times = times_ms(scene, options.rate)
    for at_ms in times:
        go_to(scene, at_ms)
        for _, groups in plan:
            for group in groups:
                group.take()
    columns = []
    for item, groups in plan:
        moving = [group for group in groups if group.moves()]
        if not moving:
            note(f"`{item.name}` does not move: left out")
        elif robot_name(item.name) != item.name:
            note(f"`{item.name}` is the robot `{robot_name(item.name)}`")
        for group in moving:
            if getattr(group, "fast", False):
                note(f"`{item.name}`: {', '.join(group.names)} turn by more than 120 degrees between two lines, "
                     "and may have been in the opposite direction: raise --rate")
            columns.append((robot_name(item.name), group))
    if not columns:
        sys.exit("error: nothing moves")
    if len({robot_name(item.name) for item, _ in plan}) < len(plan):
        sys.exit("error: two objects would be one robot: rename them without / , * and brackets")
    write(options.output, times, columns)
    print(f"wrote {options.output}: {len({robot for robot, _ in columns})} robots, {len(times)} lines")
    coloured = any("Red" in group.names for _, group in columns)
    colours = ' --map "*/lamp=*/Red,*/Green,*/Blue"' if coloured else ""
    print(f'next: downbeat import csv {options.output} --time "Time [ms]" --map "*=*"{colours}')


# Blender continues after an error in a script, and exits with code 0.
try:
    main()
except SystemExit:
    raise
except Exception as error:  # noqa: BLE001 - whatever it is, the command has failed
    sys.exit(f"error: {error!r}")
