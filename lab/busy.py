#!/usr/bin/env python3
"""Do robots start together while other programs keep every core busy? Plays missions of four robots without faults, each robot in its
own process, while busy loops run:

  lab/busy.py
  lab/busy.py --missions 500 --at-once 4 --loops 4

Prints a table. Exits 1 if a mission started on only some of its robots according to their logs, or if fewer than 99 % of the missions
played. A mission that prepared its act again and then played it counts as played.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from downbeat_lab import fleet, program, reports, shares
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table

MISSION_TIMEOUT_S = 120
PLAYED_MIN = 0.99
ROBOTS = ["a", "b", "c", "d"]
SCENARIO = fleet.scenario("busy", [f"{{at: 0s, robots: all, tracks: {fleet.WAVE}}}"], running="1s", start_tolerance="1s")
BUSY_LOOP = "while True: pass"


class Played:
    """A mission with its own processes: how it ended, whether it prepared its act again, and whether all, some or no robots began it."""

    def __init__(self, downbeat):
        with tempfile.TemporaryDirectory(prefix="busy-") as folder:
            folder = Path(folder)
            with Processes() as processes:
                self.play(downbeat, folder, processes)
            logs = [reports.log_entries((folder / f"{robot}.jsonl").read_text()) for robot in ROBOTS]
        began = [any(entry.get("step") == 0 for entry in reports.values_set(log)) for log in logs]
        self.started = "all" if all(began) else "some" if any(began) else "none"

    def play(self, downbeat, folder, processes):
        (folder / "robot.yaml").write_text(fleet.ROBOT)
        addresses = {}
        for robot in ROBOTS:
            command = [downbeat, "robot", "--init", "robot.yaml", "--id", robot, "--listen", "127.0.0.1:0"]
            _, lines = processes.start_listening(*command, "--log-file", f"{robot}.jsonl", robots=1, cwd=folder)
            addresses[robot] = f"tcp://127.0.0.1:{lines[0].rsplit(':', 1)[1]}"
        (folder / "play.yaml").write_text(SCENARIO)
        (folder / "fleet.yaml").write_text(fleet.fleet(addresses))
        with open(folder / "out", "w") as out, open(folder / "errors", "w") as errors:
            run = processes.start(downbeat, "run", "play.yaml", "--format", "json", cwd=folder, stdout=out, stderr=errors,
                                  env={**os.environ, "DOWNBEAT_STATE": str(folder / "state")})
            run.wait(timeout=MISSION_TIMEOUT_S)
        text = (folder / "out").read_text()
        if not text:
            sys.exit(f"`downbeat run` printed no report: {(folder / 'errors').read_text()}")
        report = json.loads(text)
        self.outcome, self.exit_code = reports.outcome(report), run.returncode
        self.failures = reports.failures(report)
        self.prepared_again = any(act.get("prepared_again") for act in report["acts"])

    def end(self):
        if self.started == "some":
            return "mixed"
        if self.started == "none":
            return "not started"
        if self.outcome != "done":
            return f"started, {self.outcome}"
        return "prepared again, played" if self.prepared_again else "played"


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--missions", type=int, default=100, help="number of missions (default: 100)")
    parser.add_argument("--at-once", type=int, default=1, help="missions that play at the same time (default: 1)")
    parser.add_argument("--loops", type=int, default=4, help="number of busy loops (default: 4)")
    asked = parser.parse_args()
    downbeat = program.find_downbeat(asked.downbeat)
    with Processes() as loops, ThreadPoolExecutor(asked.at_once) as pool:
        for _ in range(asked.loops):
            loops.start(sys.executable, "-c", BUSY_LOOP, stdout=subprocess.DEVNULL)
        missions = list(pool.map(lambda _: Played(downbeat), range(asked.missions)))
    ends = Counter(mission.end() for mission in missions)
    table = Table("ended", "missions", "95 %", widths=[30, 0, 19], left=1)
    for kind, count in ends.most_common():
        low, high = shares.wilson(count, len(missions))
        table.row(kind, count, f"{100 * low:5.1f} .. {100 * high:5.1f} %")
    for mission in missions:
        if "played" not in mission.end():
            print(f"{mission.end()} (exit code {mission.exit_code}): {'; '.join(mission.failures)}")
    played = sum("played" in mission.end() for mission in missions)
    sys.exit(0 if not ends["mixed"] and played >= PLAYED_MIN * len(missions) else 1)


if __name__ == "__main__":
    main()
