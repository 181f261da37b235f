"""Checks whether and when both robots moved, from the logs of their simulators: `moved.py REPORT UR5E_CSV G1_CSV`.

REPORT is the output of `downbeat run examples/mujoco/greeting.yaml --format json`; only the start of the act is read from it.
"""

import json
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "examples"))
from motion import onset, read_csv, start_ms  # noqa: E402

# The joint that moves first, by how many degrees, and the longest allowed delay of its onset on a busy machine.
JOINTS = {"ur5e": ("elbow", -30), "g1": ("r_elbow_pitch", 30)}
LATENCY_MS_MAX = 250


def main() -> None:
    report = json.loads(pathlib.Path(sys.argv[1]).read_text())
    if report["outcome"] != "done":
        raise SystemExit(f"the mission is {report['outcome']}")
    start = start_ms(report)
    for path, (robot, (joint, way)) in zip(sys.argv[2:], JOINTS.items()):
        log = read_csv(pathlib.Path(path), joint)
        began = onset(log, start, visible=0.1)
        if began is None or not 0 <= began - start <= LATENCY_MS_MAX:
            raise SystemExit(f"{robot}: `{joint}` did not begin to move within {LATENCY_MS_MAX} ms of the start")
        at = {second: degrees for second in (0, 3) for time, degrees in zip(*log) if time <= start + 1000 * second}
        if abs(at[3] - at[0] - way) > 1:
            raise SystemExit(f"{robot}: `{joint}` went by {at[3] - at[0]:.2f} degrees, expected {way}")
        print(f"{robot}: `{joint}` began to move {began - start:.1f} ms after the start, and went by {at[3] - at[0]:.2f} degrees")


if __name__ == "__main__":
    main()
