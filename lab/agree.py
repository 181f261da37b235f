#!/usr/bin/env python3
"""Do dry runs end like real missions? Plays missions with real processes under random faults, and dry runs in a world with the same
faults, and compares their outcomes:

  lab/agree.py
  lab/agree.py --missions 20 --at-once 1 --seed 7

Prints a table. Exits 1 if the shares of missions that finish differ by the two-proportion z-test at 95 %. One run in twenty fails this
test although the shares are equal: repeat it with another seed.
"""

import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from downbeat_lab import fleet, program, reports, shares
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table

# The faults: robot b is suspended, robot c dies. Seconds from the beginning of the mission.
FAULT_UNTIL = 2.5
STALL_MIN, STALL_MAX = 0.001, 1.5
STALL_PROBABILITY = 0.8
DEATH_PROBABILITY = 0.2
# Dry runs with the faults of one real mission: only delays and clocks differ between them.
TWINS = 9
DRY_RUN_TIMEOUT_S = 300
MISSION_TIMEOUT_S = 60

ROBOTS = ["a", "b", "c"]
SCENARIO = fleet.scenario("wave", [f"{{at: 0s, robots: all, tracks: {fleet.WAVE}}}"], running="600ms", start_tolerance="20ms")
INCIDENTS = f"""incidents:
  - {{robot: b, what: stalls, at: {{from: 0s, to: {FAULT_UNTIL}s}}, lasts: {{from: {STALL_MIN}s, to: {STALL_MAX}s}}, probability: {STALL_PROBABILITY}}}
  - {{robot: c, what: dies, at: {{from: 0s, to: {FAULT_UNTIL}s}}, probability: {DEATH_PROBABILITY}}}
"""


class Faults:
    """The faults of one mission; none without a generator of random numbers."""

    def __init__(self, rng=None):
        draw = rng.random if rng else lambda: 1.0
        # Also draws the values of a fault that does not happen, as the dry run does.
        stalls, at, lasts = draw() < STALL_PROBABILITY, draw() * FAULT_UNTIL, STALL_MIN + draw() * (STALL_MAX - STALL_MIN)
        dies, dies_at = draw() < DEATH_PROBABILITY, draw() * FAULT_UNTIL
        self.stall = (at, lasts) if stalls else None
        self.death = dies_at if dies else None

    def signals(self):
        """Instants, robots and signals, in order."""
        signals = []
        if self.stall:
            at, lasts = self.stall
            signals += [(at, "b", signal.SIGSTOP), (at + lasts, "b", signal.SIGCONT)]
        if self.death is not None:
            signals.append((self.death, "c", signal.SIGKILL))
        return sorted(signals)

    def incidents(self):
        """The same faults as part of a world file."""
        lines = []
        if self.stall:
            at, lasts = self.stall
            lines.append(f"  - {{robot: b, what: stalls, at: {at * 1000:.3f}ms, lasts: {lasts * 1000:.3f}ms}}\n")
        if self.death is not None:
            lines.append(f"  - {{robot: c, what: dies, at: {self.death * 1000:.3f}ms}}\n")
        return "incidents:\n" + "".join(lines) if lines else ""

    def __str__(self):
        parts = []
        if self.stall:
            parts.append(f"b stalls at {self.stall[0]:.3f} s for {self.stall[1]:.3f} s")
        if self.death is not None:
            parts.append(f"c dies at {self.death:.3f} s")
        return ", ".join(parts) or "no fault"


def end(outcome, started):
    """How a mission ended. `started` is `all`, `some` or `none` of its robots."""
    if started == "none":
        return "none started"
    if started == "some":
        return "some started, others not"
    return {"done": "done", "failed": "all started, then failed"}.get(outcome, f"all started, {outcome}")


def write_project(folder, addresses):
    (folder / "robot.yaml").write_text(fleet.ROBOT)
    (folder / "play.yaml").write_text(SCENARIO)
    (folder / "fleet.yaml").write_text(fleet.fleet(addresses))


class Played:
    """A mission with its own processes."""

    def __init__(self, downbeat, faults, record=None):
        self.downbeat, self.faults = downbeat, faults
        self.signal_delays_s = []
        with tempfile.TemporaryDirectory(prefix="agree-") as folder:
            folder = Path(folder)
            with Processes() as processes:
                self.play(folder, processes, record)
            logs = [reports.log_entries((folder / f"{robot}.jsonl").read_text()) for robot in ROBOTS]
        began = [any(entry.get("step") == 0 for entry in reports.values_set(log)) for log in logs]
        self.end = end(self.outcome, "all" if all(began) else "some" if any(began) else "none")

    def play(self, folder, processes, record):
        (folder / "robot.yaml").write_text(fleet.ROBOT)
        robots, addresses = {}, {}
        for robot in ROBOTS:
            command = [self.downbeat, "robot", "--init", "robot.yaml", "--id", robot, "--listen", "127.0.0.1:0"]
            robots[robot], lines = processes.start_listening(*command, "--log-file", f"{robot}.jsonl", robots=1, cwd=folder)
            addresses[robot] = f"tcp://127.0.0.1:{lines[0].rsplit(':', 1)[1]}"
        write_project(folder, addresses)
        state = folder / "state"
        command = [self.downbeat, "run", "play.yaml", "--format", "json", *(["--record", record] if record else [])]
        with open(folder / "out", "w") as out:
            run = processes.start(*command, cwd=folder, stdout=out, stderr=subprocess.DEVNULL,
                                  env={**os.environ, "DOWNBEAT_STATE": str(state)})
        began = mission_began(run, state)
        for at, robot, number in self.faults.signals():
            time.sleep(max(began + at - time.time(), 0))
            robots[robot].send_signal(number)
            self.signal_delays_s.append(time.time() - began - at)
        run.wait(timeout=MISSION_TIMEOUT_S)
        # If a robot was suspended until the end, it gets time to finish.
        time.sleep(0.2)
        report = json.loads((folder / "out").read_text())
        self.outcome = reports.outcome(report)
        self.reasons = "".join(f"; {failure['robot']}: {failure['text']}" for failure in report["failures"])
        self.sent_ms = self.start_ms = None
        if report["acts"]:
            act = report["acts"][0]
            self.sent_ms, self.start_ms = ((reports.instant(act[key]) - began) * 1000 for key in ["timestamp", "start"])


def mission_began(run, state):
    """The beginning of the mission, as soon as its folder exists."""
    while run.poll() is None:
        for name in os.listdir(state) if state.exists() else []:
            if name.startswith("wave@"):
                return reports.session_instant(name)
        time.sleep(0.0005)
    sys.exit(f"a mission ended with exit code {run.returncode} before it began")


class DryRuns:
    """Dry runs in the world measured from a real mission."""

    def __init__(self, downbeat, folder, world):
        self.downbeat, self.folder, self.world = downbeat, folder, world

    def report(self, incidents, *arguments):
        (self.folder / "world.yaml").write_text(self.world + incidents)
        command = [self.downbeat, "dry-run", "play.yaml", "--world", "world.yaml", "--format", "json", *arguments]
        return json.loads(program.run(*command, folder=self.folder, timeout=DRY_RUN_TIMEOUT_S))

    def ends(self, incidents, trials):
        return [end(trial["outcome"], trial["started"]) for trial in self.report(incidents, "--trials", str(trials))["each"]]


def print_ends(real, dry):
    ends, ends_dry = Counter(mission.end for mission in real), Counter(dry)
    table = Table("ended", f"{len(real)} real missions", "95 %", f"{len(dry)} dry runs", "95 %", "z", widths=[30, 0, 19, 0, 19, 6], left=1)
    for kind in sorted({*ends, *ends_dry}, key=lambda kind: -ends_dry[kind]):
        z = shares.z_of_two(ends[kind], len(real), ends_dry[kind], len(dry))
        table.row(kind, ends[kind], interval(ends[kind], len(real)), ends_dry[kind], interval(ends_dry[kind], len(dry)), z)


def interval(count, total):
    low, high = shares.wilson(count, total)
    return f"{100 * low:5.1f} .. {100 * high:5.1f} %"


def print_times(real, calm):
    """`calm` is the report of a dry run without faults."""
    delays = [delay * 1000 for mission in real for delay in mission.signal_delays_s]
    sent = [mission.sent_ms for mission in real if mission.sent_ms is not None]
    start = [mission.start_ms for mission in real if mission.start_ms is not None]
    if delays:
        print(f"delay of the signals: median {statistics.median(delays):.1f} ms, most {max(delays):.1f} ms")
    if sent:
        print(f"from the beginning to the sending of the act {statistics.median(sent):.0f} ms (median; {min(sent):.0f} to "
              f"{max(sent):.0f}), to its start {statistics.median(start):.0f} ms; "
              f"a dry run: {calm['acts'][0]['timestamp'][17:26]} s, {calm['acts'][0]['start'][17:26]} s")


def print_twins(real, twins):
    """`twins` are the ends of the dry runs with the faults of each real mission."""
    same = sum(twin.most_common(1)[0][0] == mission.end for mission, twin in zip(real, twins))
    print(f"missions that end as most of {TWINS} dry runs with the same faults: {same} of {len(real)}")
    for mission, twin in zip(real, twins):
        if twin.most_common(1)[0][0] != mission.end:
            ends = ", ".join(f"{kind} ({count})" for kind, count in twin.most_common())
            act = "no act"
            if mission.sent_ms is not None:
                act = f"act sent at {mission.sent_ms / 1000:.3f} s for {mission.start_ms / 1000:.3f} s"
            print(f"  {mission.faults}: mission {mission.end} ({act}{mission.reasons}); dry runs {ends}")


def judge(real, dry):
    """Prints and returns whether the shares of missions that finish agree."""
    done = sum(mission.end == "done" for mission in real)
    z = shares.z_of_two(done, len(real), dry.count("done"), len(dry))
    print(f"shares of missions that finish: z = {z:.2f}, {'THEY DIFFER' if shares.differ(z) else 'no difference'} at 95 %")
    return not shares.differ(z)


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--missions", type=int, default=100, help="real missions (default: 100)")
    parser.add_argument("--trials", type=int, default=1000, help="dry runs (default: 1000)")
    parser.add_argument("--at-once", type=int, default=2, help="real missions that play at the same time (default: 2)")
    parser.add_argument("--seed", default="0", help="seed of the faults (default: 0)")
    asked = parser.parse_args()
    downbeat = program.find_downbeat(asked.downbeat)
    with tempfile.TemporaryDirectory(prefix="agree-") as folder:
        folder = Path(folder)
        write_project(folder, dict.fromkeys(ROBOTS, "sim"))
        with ThreadPoolExecutor(asked.at_once) as pool:
            # Measures links and clocks in missions without faults, under the same load as the later ones.
            tapes = [str(folder / f"{index}.mcap") for index in range(asked.at_once)]
            list(pool.map(lambda tape: Played(downbeat, Faults(), tape), tapes))
            dry_runs = DryRuns(downbeat, folder, program.run(downbeat, "world", tapes[0], folder=folder))
            drawn = [Faults(random.Random(f"{asked.seed}/{mission}")) for mission in range(asked.missions)]
            real = list(pool.map(lambda faults: Played(downbeat, faults), drawn))
        calm = dry_runs.report("", "--trial", "0")
        dry = dry_runs.ends(INCIDENTS, asked.trials)
        twins = [Counter(dry_runs.ends(faults.incidents(), TWINS)) for faults in drawn]
    print_ends(real, dry)
    print_times(real, calm)
    print_twins(real, twins)
    sys.exit(0 if judge(real, dry) else 1)


if __name__ == "__main__":
    main()
