#!/usr/bin/env python3
"""Do the reports of several schedulers agree with the log of their robots? Each scheduler has its own machine in one Zenoh network: a
network namespace with its own address behind one bridge. Two schedulers play with different robots at the same time; two request the same
robots; one loses its network during a mission. Needs root:

  lab/zenoh_machines.py             builds the program with the feature zenoh
  lab/zenoh_machines.py --downbeat PATH --zenohd PATH

Prints each expectation with the values that it compares, and exits 1 if one of them is wrong.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from downbeat_lab import fleet, program, reports
from downbeat_lab.machines import ip, machines, on
from downbeat_lab.processes import Processes

ROBOTS, STEPS, EVERY_MS = 20, 40, 100
HALVES = {"left": range(ROBOTS // 2), "right": range(ROBOTS // 2, ROBOTS), "all": range(ROBOTS)}
MACHINES = ["downbeat-router", "downbeat-robots", "downbeat-one", "downbeat-two"]
"""The first one has the bridge and the router."""
NETWORK = "10.77.0"
ENDPOINT = f"tcp/{NETWORK}.1:7447"
MISSION_TIMEOUT_S = 90


@contextlib.contextmanager
def network():
    """The machines and their bridge, which exist during a `with` block."""
    router, *others = MACHINES
    with machines(MACHINES):
        ip("-n", router, "link", "add", "bridge", "type", "bridge")
        ip("-n", router, "addr", "add", f"{NETWORK}.1/24", "dev", "bridge")
        ip("-n", router, "link", "set", "bridge", "up")
        for number, machine in enumerate(others, 2):
            ip("-n", machine, "link", "add", "eth0", "type", "veth", "peer", "name", f"port{number}", "netns", router)
            ip("-n", machine, "addr", "add", f"{NETWORK}.{number}/24", "dev", "eth0")
            ip("-n", machine, "link", "set", "eth0", "up")
            ip("-n", router, "link", "set", f"port{number}", "master", "bridge", "up")
        yield


class Ended:
    """A finished mission: the exit code, the errors, and the values of the report that are compared."""

    def __init__(self, process):
        out, self.errors = process.communicate(timeout=MISSION_TIMEOUT_S)
        report = json.loads(out) if out.strip() else {}
        self.code, self.outcome = process.returncode, reports.outcome(report)
        self.steps = {robot["robot"]: robot["steps_done"] for robot in report.get("robots", [])}
        self.unaccounted = {robot["robot"] for robot in report.get("robots", []) if robot["unaccounted"]}
        self.failures = reports.failures(report)

    def is_done(self):
        return (self.code, self.outcome) == (0, "done")

    def is_refused(self):
        return self.code != 0 and self.outcome != "done"


class Trial:
    """The router, the robots, and the running schedulers."""

    def __init__(self, downbeat, zenohd, folder, processes):
        self.downbeat, self.zenohd, self.folder, self.processes = downbeat, zenohd, folder, processes
        self.wrong = []

    def write_project(self):
        (self.folder / "robot.yaml").write_text(fleet.ROBOT)
        addresses = {f"r{i}": f"zenoh:hall/r{i}" for i in range(ROBOTS)}
        groups = {half: [f"r{i}" for i in members] for half, members in HALVES.items()}
        (self.folder / "fleet.yaml").write_text(fleet.fleet(addresses, groups=groups, head="zenoh: client.json5\n"))
        keyframes = ", ".join(f"{{at: {step * EVERY_MS}ms, to: {step + 1}}}" for step in range(STEPS))
        for half in HALVES:
            cue = f"{{at: 0s, robots: {half}, tracks: {{d: [{keyframes}]}}}}"
            (self.folder / f"{half}.yaml").write_text(fleet.scenario(half, [cue], running="1s", start_tolerance="2s"))
        router = f'{{mode: "router", listen: {{endpoints: ["{ENDPOINT}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
        (self.folder / "router.json5").write_text(router)
        (self.folder / "client.json5").write_text(f'{{mode: "client", connect: {{endpoints: ["{ENDPOINT}"]}}}}')

    def start(self):
        self.write_project()
        self.processes.start(*on("downbeat-router"), self.zenohd, "--config", "router.json5", cwd=self.folder, stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL)
        time.sleep(1)
        self.processes.start_listening(*on("downbeat-robots"), self.downbeat, "sim", "fleet.yaml", "--log-file", "robots.jsonl", "--realtime",
                                       "off", robots=ROBOTS, errors=self.folder / "sim-errors", cwd=self.folder)

    def run(self, machine, half):
        environment = {**os.environ, "DOWNBEAT_STATE": str(self.folder / f"state-{machine}")}
        command = [self.downbeat, "run", f"{half}.yaml", "--realtime", "off", "--format", "json"]
        return self.processes.start(*on(f"downbeat-{machine}"), *command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)

    def log(self):
        # The simulation writes its log within 50 ms.
        time.sleep(0.5)
        return reports.values_set(reports.log_entries((self.folder / "robots.jsonl").read_text()))

    def steps_since(self, before):
        """The steps of each robot after the first `before` entries of the log, and their requests."""
        made, requests = dict.fromkeys(names("all"), 0), set()
        for entry in self.log()[before:]:
            if entry.get("step") is not None:
                made[entry["robot"]] += 1
                requests.add(entry["request_id"])
        return made, requests

    def expect(self, expectation, holds, *values):
        print(f"{'correct' if holds else 'WRONG'}: {expectation}{': ' if values else ''}{' '.join(map(str, values))}", flush=True)
        if not holds:
            self.wrong.append(expectation)

    def play_both_at_once(self):
        before = len(self.log())
        first, second = self.run("one", "left"), self.run("two", "right")
        first, second = Ended(first), Ended(second)
        made, _ = self.steps_since(before)
        self.expect("two schedulers play with different robots at the same time", first.is_done() and second.is_done(),
                    first.outcome, second.outcome)
        self.expect("both reports agree with the log of the robots",
                    {**first.steps, **second.steps} == made == dict.fromkeys(made, STEPS), sorted(set(made.values())))

    def request_the_same(self):
        before = len(self.log())
        first = self.run("one", "all")
        while not self.steps_since(before)[1]:
            time.sleep(0.05)
        second = Ended(self.run("two", "left"))
        first = Ended(first)
        made, requests = self.steps_since(before)
        self.expect("the second scheduler is refused", second.is_refused(), second.code, second.outcome,
                    second.failures[:1] or second.errors[-300:])
        self.expect("the first one plays to its end", first.is_done(), first.code, first.outcome)
        self.expect("robots moved for the first one alone",
                    first.steps == made == dict.fromkeys(made, STEPS) and len(requests) == ROBOTS, len(requests), "requests")

    def request_the_same_at_once(self):
        before = len(self.log())
        both = [self.run("one", "all"), self.run("two", "all")]
        both = [Ended(process) for process in both]
        made, requests = self.steps_since(before)
        done = [mission for mission in both if mission.outcome == "done"]
        self.expect("of two that begin at once, at most one plays", len(done) <= 1 and len(requests) == ROBOTS * len(done),
                    *((mission.code, mission.outcome, mission.failures[:1]) for mission in both))
        reported = done[0].steps if done else dict.fromkeys(made, 0)
        self.expect("its report agrees with the log", made == reported, sorted(set(made.values())))

    def lose_the_network(self):
        before, left = len(self.log()), set(names("left"))
        mission = self.run("one", "left")
        while len(moved(self.steps_since(before)[0])) < len(left):
            time.sleep(0.05)
        time.sleep(0.5)
        ip("-n", "downbeat-one", "link", "set", "eth0", "down")
        mission = Ended(mission)
        made, _ = self.steps_since(before)
        ip("-n", "downbeat-one", "link", "set", "eth0", "up")
        played = {made[robot] for robot in left}
        self.expect("robots that lose their scheduler stop by their leases", max(played) < STEPS and moved(made) == left, sorted(played))
        self.expect("the mission is not done", mission.is_refused(), mission.code, mission.outcome, mission.failures[:1])
        self.expect("its report does not exceed the steps that were made", all(mission.steps.get(robot, 0) <= made[robot] for robot in left),
                    sorted(set(mission.steps.values())))
        self.expect("its report lists the other scripts as unaccounted for", mission.unaccounted == left, len(mission.unaccounted), "robots")
        time.sleep(2)
        again = Ended(self.run("two", "left"))
        self.expect("another scheduler plays with them", again.is_done(), again.outcome, again.failures[:1])


def moved(made):
    return {robot for robot, steps in made.items() if steps > 0}


def names(half):
    return [f"r{i}" for i in HALVES[half]]


def main():
    asked = program.arguments(__doc__, zenoh=True).parse_args()
    downbeat = program.find_downbeat(asked.downbeat, zenoh=True, profile="dev")
    zenohd = program.find_zenohd(asked.zenohd)
    with tempfile.TemporaryDirectory(prefix="zenoh-machines-") as folder, network(), Processes() as processes:
        trial = Trial(downbeat, zenohd, Path(folder), processes)
        trial.start()
        for part in (trial.play_both_at_once, trial.request_the_same, trial.request_the_same_at_once, trial.lose_the_network):
            print(f"\n-- {part.__name__.replace('_', ' ')}")
            part()
    sys.exit(1 if trial.wrong else 0)


if __name__ == "__main__":
    main()
