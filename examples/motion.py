"""How far apart the robots of `together.yaml` began to move, only from the logs of their simulators: `motion.py FOLDER`.

FOLDER has a folder for each mission, with `run.json`, the report of `downbeat run --format json`, and the logs of the robots that run for
one mission; logs of robots that run longer are next to FOLDER. Only the time of the act's start is read from Downbeat's report, to find
the place in the logs. `--write FILE` writes the median latencies to a file, in the format of a fleet file.
"""

from __future__ import annotations

import argparse
import bisect
import csv
import datetime
import json
import pathlib
import statistics
from typing import Optional

# The log of each robot, and the joint that moves.
ROBOTS = {
    "ur5e": ("ur5e.csv", "elbow"),
    "g1": ("g1.csv", "r_elbow_pitch"),
    "reachy": ("reachy.csv", "right_antenna"),
    "simulated": ("simulated.jsonl", "elbow"),
}
DEVICES = {robot: joint for robot, (_, joint) in ROBOTS.items()}
"""The device that moves. Each device is named like its joint."""
STARTS_MS = (1000, 3000, 5000, 7000)
"""When the cues begin, relative to the act's start."""
BEFORE_MS, AFTER_MS = 40, 500
"""The search for a motion begins this long before the cue and ends this long after it."""
RESTED_MS = 80
"""The rest position of a joint is its mean over this time before."""
VISIBLE_DEG = 0.1
"""A joint that has turned by this much from its rest position has begun to move."""

Log = tuple[list[float], list[float]]
"""Milliseconds of the host's clock since 1970, and degrees."""


def read_csv(path: pathlib.Path, joint: str) -> Log:
    """The log of a simulator, with one line for each of its steps."""
    times, degrees = [], []
    with open(path, newline="") as lines:
        rows = csv.reader(lines)
        header = next(rows)
        column = header.index(joint)
        for row in rows:
            if len(row) == len(header):  # The last line may be incomplete.
                times.append(int(row[0]) / 1e6)
                degrees.append(float(row[column]))
    return times, degrees


def read_jsonl(path: pathlib.Path, device: str) -> Log:
    """The log of `downbeat robot`, which contains the start and end of linear movements; sampled every millisecond."""
    times, degrees = [], []
    begun = None
    for line in path.read_text().splitlines():
        entry = json.loads(line)
        at, value = entry["true_ns"] / 1e6, entry["value"]
        if entry["device"] != device or entry["motion"] not in ("set", "ramp"):
            continue
        if entry["motion"] == "ramp":
            begun = at
            continue
        rest = degrees[-1] if degrees else value
        since = at if begun is None else begun
        for millisecond in range(int(at - since)):
            times.append(since + millisecond)
            degrees.append(rest + (value - rest) * millisecond / (at - since))
        begun = None
        times.append(at)
        degrees.append(value)
    return times, degrees


def onset(log: Log, cue_ms: float, visible: float) -> Optional[float]:
    """When the motion near this time became visible; `None` if there was none."""
    times, degrees = log
    first = bisect.bisect_left(times, cue_ms - BEFORE_MS)
    last = bisect.bisect_right(times, cue_ms + AFTER_MS)
    # A log that contains only changes has no lines while the joint rests.
    rested = bisect.bisect_left(times, cue_ms - BEFORE_MS - RESTED_MS, hi=first)
    rest = statistics.fmean(degrees[rested:first] or degrees[max(first - 1, 0) : max(first, 1)])
    before = 0.0
    for i in range(first, last):
        moved = abs(degrees[i] - rest)
        if moved > visible:
            share = (visible - before) / (moved - before)
            return times[i - 1] + share * (times[i] - times[i - 1]) if i > first else times[i]
        before = moved
    return None


def start_ms(report: dict) -> float:
    """The act's start, in milliseconds since 1970."""
    whole, _, fraction = report["start"].rstrip("Z").partition(".")
    seconds = datetime.datetime.fromisoformat(whole + "+00:00").timestamp()
    return seconds * 1e3 + float("0." + (fraction or "0")) * 1e3


def p95(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, -(-len(ordered) * 95 // 100) - 1)]


def read(folder: pathlib.Path) -> list[tuple[float, dict[str, Log]]]:
    """The start of each played mission, and the logs of its robots."""
    lasting = {}
    for robot, (name, joint) in ROBOTS.items():
        path = folder.parent / name
        if path.exists():
            lasting[robot] = read_csv(path, joint) if name.endswith(".csv") else read_jsonl(path, joint)
    missions = []
    for mission in sorted(path.parent for path in folder.glob("*/run.json")):
        text = (mission / "run.json").read_text()
        report = json.loads(text) if text else {"outcome": "not reported"}
        if report["outcome"] != "done":
            print(f"{mission.name}: {report['outcome']}, left out")
            continue
        own = {robot: read_csv(mission / name, joint) for robot, (name, joint) in ROBOTS.items() if (mission / name).exists()}
        logs = {**lasting, **own}
        if missing := ROBOTS.keys() - logs.keys():
            raise SystemExit(f"{mission.name}: no log of {', '.join(sorted(missing))}")
        missions.append((start_ms(report), logs))
    return missions


def picture(latencies: dict[str, list[float]]) -> str:
    """An SVG with a row for each robot and a mark for each of its motions."""
    least = min(0.0, *(min(values) for values in latencies.values())) // 10 * 10
    most = max(max(values) for values in latencies.values()) // 10 * 10 + 10
    left, width, high = 90, 560, 24

    def x(at: float) -> float:
        return round(left + (at - least) / (most - least) * width, 1)

    bottom = 20 + high * len(latencies)
    parts = [f'<rect width="{left + width + 20}" height="{bottom + 40}" fill="white"/>']
    every = 10 if most - least <= 120 else 50
    for at in range(int(least), int(most) + 1, every):
        parts.append(f'<path d="M{x(at)} 20V{bottom}" stroke="{"#888" if at == 0 else "#ddd"}"/>')
        parts.append(f'<text x="{x(at)}" y="{bottom + 14}" text-anchor="middle">{at}</text>')
    for row, (robot, values) in enumerate(latencies.items()):
        middle = 20 + high * row + high / 2
        parts.append(f'<text x="8" y="{middle + 4}">{robot}</text>')
        marks = "".join(f"M{x(at)} {middle - 8}v16" for at in sorted(values))
        parts.append(f'<path d="{marks}" stroke="#0b63a5" stroke-opacity="0.5"/>')
    parts.append(f'<text x="{left}" y="{bottom + 32}">milliseconds from the cue to the motion, a mark for each</text>')
    size = f'width="{left + width + 20}" height="{bottom + 40}"'
    body = "\n".join(parts)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="11">\n{body}\n</svg>\n'


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=pathlib.Path)
    arguments.add_argument("--write", type=pathlib.Path)
    arguments.add_argument("--picture", type=pathlib.Path, help="an SVG of when each motion began")
    arguments.add_argument("--visible", type=float, default=VISIBLE_DEG, help="degrees; %(default)s by default")
    given = arguments.parse_args()

    missions = read(given.folder)
    latencies: dict[str, list[float]] = {robot: [] for robot in ROBOTS}
    of_missions, of_starts = [], []
    for start, logs in missions:
        spreads = []
        for cue in STARTS_MS:
            began = {robot: onset(log, start + cue, given.visible) for robot, log in logs.items()}
            for robot, at in began.items():
                if at is None:
                    raise SystemExit(f"{robot} did not move within {AFTER_MS} ms of its cue at {cue} ms")
                latencies[robot].append(at - start - cue)
            spreads.append(max(began.values()) - min(began.values()))
        of_missions.append(max(spreads))
        of_starts.extend(spreads)
    if not of_missions:
        raise SystemExit("no mission was played")

    print(f"{len(missions)} missions, {len(of_starts)} starts; a joint that has turned by {given.visible} degrees has begun to move")
    print("robot       began after its cue: median, least to most [ms]")
    for robot, values in latencies.items():
        print(f"{robot:10}  {statistics.median(values):6.1f}   {min(values):6.1f} to {max(values):6.1f}")
    for what, values in (("a start", of_starts), ("a mission (the worst of its starts)", of_missions)):
        print(f"motion spread of {what}: median {statistics.median(values):.1f} ms, p95 {p95(values):.1f} ms, most {max(values):.1f} ms")
    if given.picture:
        given.picture.write_text(picture(latencies))
    if given.write:
        lines = ["latency:\n"]
        for robot, values in latencies.items():
            device = DEVICES[robot]
            lines.append(f"  {robot}: {{{device}: {{median: {max(0.0, statistics.median(values)):.1f}ms}}}}\n")
        given.write.write_text("".join(lines))


if __name__ == "__main__":
    main()
