#!/usr/bin/env python3
"""Draws a drone show as an SVG picture that moves, as in README.md.

Usage: book/picture.py FOLDER SECONDS > show.svg, where FOLDER was written by `downbeat export drone-csv`.

The picture plays six times as fast as the show, from SECONDS on. A viewer that does not play it shows this instant. Positions are at most half a pixel off, and lamps are drawn a little brighter.
"""
import csv
import math
import pathlib
import sys

SPEED = 6
WIDTH, HEIGHT, MARGIN = 720, 300, 20
TILT = math.radians(18)
"""Angle from which the camera looks down."""
ERROR = 0.5
"""Largest distance of a drone from its drawn path, in pixels."""
NO_LAMP = "#3a4250"


def rows(file):
    for row in csv.DictReader(file):
        t, x, y, z = (float(row[key]) for key in ("Time [msec]", "x [m]", "y [m]", "z [m]"))
        yield t / 1000, x, y, z, tuple(int(row[key]) for key in ("Red", "Green", "Blue"))


def kept(points, begin, end):
    """Indices between two samples that a path of straight pieces needs (Ramer, Douglas and Peucker)."""
    (t0, *a), (t1, *b) = points[begin], points[end]
    distances = [
        math.dist(p, [u + (v - u) * (t - t0) / (t1 - t0) for u, v in zip(a, b)]) for t, *p in points[begin + 1 : end]
    ]
    if not distances or max(distances) <= ERROR:
        return []
    middle = begin + 1 + distances.index(max(distances))
    return [*kept(points, begin, middle), middle, *kept(points, middle, end)]


def animation(attribute, times, values, start, end, mode="linear"):
    keys = ";".join(f"{t / end:.4g}" for t in times)
    return (
        f"<animate attributeName='{attribute}' begin='{-start / SPEED:.3g}s' dur='{end / SPEED:.3g}s' repeatCount='indefinite' "
        f"calcMode='{mode}' keyTimes='{keys}' values='{';'.join(values)}'/>"
    )


def main():
    shows = [list(rows(path.open())) for path in sorted(pathlib.Path(sys.argv[1]).glob("*.csv"))]
    start, end = float(sys.argv[2]), max(row[0] for show in shows for row in show)
    flat = [[(t, x, -(z * math.cos(TILT) + y * math.sin(TILT))) for t, x, y, z, _ in show] for show in shows]
    xs, ys = ([point[axis] for show in flat for point in show] for axis in (1, 2))
    scale = min((WIDTH - 2 * MARGIN) / (max(xs) - min(xs)), (HEIGHT - 2 * MARGIN) / (max(ys) - min(ys)))
    left, top = WIDTH / 2 - scale * (max(xs) + min(xs)) / 2, HEIGHT / 2 - scale * (max(ys) + min(ys)) / 2
    print(f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH} {HEIGHT}' width='{WIDTH}' height='{HEIGHT}'>")
    print(f"<rect width='{WIDTH}' height='{HEIGHT}' rx='8' fill='#10141c'/>")
    for show, points in zip(shows, flat):
        points = [(t, left + scale * x, top + scale * y) for t, x, y in points]
        moving = [points[i] for i in (0, *kept(points, 0, len(points) - 1), len(points) - 1)]
        lamp = [(t, rgb) for (t, *_, rgb), before in zip(show, [None, *show]) if before is None or before[4] != rgb]
        colours = ["#%02x%02x%02x" % tuple(64 + part * 3 // 4 for part in rgb) if any(rgb) else NO_LAMP for _, rgb in lamp]
        times = [t for t, *_ in moving]
        _, x, y = next(point for point in points if point[0] >= start)
        colour = [colour for (t, _), colour in zip(lamp, colours) if t <= start][-1]
        print(
            f"<circle r='4' cx='{x:.1f}' cy='{y:.1f}' fill='{colour}'>",
            animation("cx", times, [f"{x:.1f}" for _, x, _ in moving], start, end),
            animation("cy", times, [f"{y:.1f}" for _, _, y in moving], start, end),
            animation("fill", [t for t, _ in lamp], colours, start, end, "discrete") if len(lamp) > 1 else "",
            "</circle>",
            sep="",
        )
    print("</svg>")


main()
