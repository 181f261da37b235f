"""How old the joint positions are when they arrive from the daemon: `sensor_delay.py LOG`, while `daemon.py LOG --sim ...` runs.

An antenna swings for ten seconds. Each value from the daemon is compared with the simulator's own log. The result is the delay with the
best agreement.
"""

import bisect
import csv
import math
import statistics
import sys
import threading
import time

from reachy_mini import ReachyMini

SWINGS, SETTLES = 10, 2
"""In seconds."""
DELAYS_MS = [tenth / 10 for tenth in range(300)]

reachy = ReachyMini(connection_mode="localhost_only", media_backend="no_media", automatic_body_yaw=False)
began, ended, told = time.monotonic(), threading.Event(), []


def swing() -> None:
    while not ended.wait(0.004):
        angle = -30 + 20 * math.sin(math.pi * (time.monotonic() - began))
        reachy.set_target(antennas=[math.radians(angle), 0.0])


mover = threading.Thread(target=swing)
mover.start()
fresh = reachy.client.joint_position_received
while time.monotonic() < began + SETTLES + SWINGS:
    fresh.clear()
    if fresh.wait(0.5) and time.monotonic() > began + SETTLES:
        _, (right, _) = reachy.get_current_joint_positions()
        told.append((time.time_ns() / 1e6, math.degrees(right)))
ended.set()
mover.join()
reachy.client.disconnect()

with open(sys.argv[1], newline="") as lines:
    rows = csv.reader(lines)
    column = next(rows).index("right_antenna")
    # The last line may be incomplete. The simulator's joint turns in the opposite direction.
    log = [(int(row[0]) / 1e6, -float(row[column])) for row in rows if len(row) > column + 1]
times = [at for at, _ in log]


def logged(at: float) -> float:
    i = min(max(bisect.bisect_left(times, at), 1), len(log) - 1)
    (before, low), (after, high) = log[i - 1], log[i]
    return low + (high - low) * (at - before) / (after - before)


def error(delay: float) -> float:
    return statistics.fmean((value - logged(at - delay)) ** 2 for at, value in told)


delay = min(DELAYS_MS, key=error)
print(f"{delay} ms old, from {len(told)} values; with this delay they differ from the log by {math.sqrt(error(delay)):.3f} degrees")
