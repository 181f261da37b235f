"""Builds an animated scene in Blender and saves it: `blender -b --factory-startup --python scene.py -- FILE.blend`."""

import math
import os
import sys

import bpy


def key(target, path, index, frames, interpolation="BEZIER"):
    """Sets the keyframes of one channel. The handles of Bezier curves overshoot a little."""
    for frame, value in frames:
        vector = getattr(target, path)
        if index is None:
            setattr(target, path, value)
        else:
            vector[index] = value
        target.keyframe_insert(path, index=-1 if index is None else index, frame=frame)
    curve = target.id_data.animation_data.action.fcurves[-1]
    for number, point in enumerate(curve.keyframe_points):
        point.interpolation = interpolation
        point.handle_left_type = point.handle_right_type = "FREE"
        point.handle_left = (point.co.x - 7 - number, point.co.y - 0.1)
        point.handle_right = (point.co.x + 9 - number, point.co.y + 0.2)


def drone(name, shift):
    bpy.ops.mesh.primitive_cube_add(size=0.2)
    item = bpy.context.active_object
    item.name = name
    key(item, "location", 0, [(1, shift), (40, shift + 2), (90, shift - 1), (150, shift)])
    key(item, "location", 1, [(1, 0), (60, 3), (150, 0)])
    key(item, "location", 2, [(1, 0), (30, 1.5), (120, 1.5), (150, 0)], "SINE")
    # More than three turns.
    key(item, "rotation_euler", 2, [(1, 0), (100, math.radians(1100)), (150, math.radians(720))])


def arm():
    bpy.ops.object.armature_add()
    item = bpy.context.active_object
    item.name = "Arm"
    bone = item.pose.bones[0]
    bone.name = "upper"
    bone.rotation_mode = "XYZ"
    key(bone, "rotation_euler", 0, [(1, 0), (50, math.radians(75)), (100, math.radians(-30)), (150, 0)])
    key(bone, "rotation_euler", 1, [(1, 0), (150, math.radians(400))], "LINEAR")


def turntable():
    """An object that rides on another turns with it: its angles come from a matrix and are unwrapped."""
    # Below the drones, which the import compares with it.
    bpy.ops.object.empty_add(location=(0, 0, -1))
    table = bpy.context.active_object
    table.name = "Table"
    key(table, "rotation_euler", 2, [(1, 0), (150, math.radians(900))], "LINEAR")
    bpy.ops.object.empty_add(location=(1, 0, 0))
    rider = bpy.context.active_object
    rider.name = "Rider"
    rider.parent = table


def lamp():
    data = bpy.data.lights.new("Lamp", "POINT")
    item = bpy.data.objects.new("Lamp", data)
    bpy.context.collection.objects.link(item)
    for part, frames in enumerate([[(1, 0), (75, 1)], [(1, 1), (150, 0.2)], [(1, 0.5), (150, 0.5)]]):
        key(data, "color", part, frames, "LINEAR")


bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()
scene = bpy.context.scene
scene.frame_start, scene.frame_end = 1, 150
# 30000/1001 frames per second, so that no frame falls on a whole millisecond.
scene.render.fps, scene.render.fps_base = 30, 1.001
drone("Drone 1", 0)
drone("Drone 2", 1)
arm()
turntable()
lamp()
bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(sys.argv[sys.argv.index("--") + 1]))
