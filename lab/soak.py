#!/usr/bin/env python3
"""Does memory stay constant over consecutive missions with random faults, and does each robot start? Real processes and TCP over
loopback:

  lab/soak.py                              1000 robots, 30 minutes
  lab/soak.py --minutes 5 --robots 200     --seed 7 draws other faults

Most robots share one `downbeat sim`. Twenty of them are reached through relays that cut or stall links, and twenty others are processes
that are suspended, or killed and restarted. A mission has 40 acts; a robot that fails is left out, and takes part in the next act or
mission. Prints a row for each mission, and exits 1 unless
  - every mission ends `done`, or `done_without` robots that had a fault;
  - every robot without a fault starts in every act of every mission;
  - after warm-up, the memory of both processes stays within 5 %: for the simulation, from the mission in which each robot reaches its
    highest number of answers (the seventh mission of 40 acts); for the scheduler, within each mission from act 25 on (it keeps the
    reports of earlier acts), and its peak from mission to mission, both until it writes the report.
"""

import asyncio
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

from downbeat_lab import fleet, ports, program, reports, sampling
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table

# After this act the scheduler keeps no further reports: 20000 rows.
WARM_ACTS = 25
# Number of answers that each robot keeps, `ENDED_KEPT` in robot/src/answers.rs.
ANSWERS_KEPT = 256
FLAT = 1.05
# Shortly before its end a mission writes its report, which takes half a second and additional memory.
REPORT_S = 1.0
RELAYED = OWN = 20
# Mean seconds between two faults, and the duration of a stall.
FAULTS_EVERY = 3.0
STALLS_FOR = (0.05, 1.5)
SAMPLE_EVERY_S = 0.5
ERRORS_SHOWN = 500


class Crowd:
    """The robots: their names, their addresses, and the files of their missions."""

    def __init__(self, robots, port, acts):
        self.all = [f"r{robot}" for robot in range(robots)]
        self.relayed, self.own = self.all[:RELAYED], self.all[RELAYED:RELAYED + OWN]
        self.port, self.acts = port, acts

    def host(self, robot, network=0):
        return ports.loopback(int(robot[1:]), network)

    def address(self, robot, network=0):
        return f"tcp://{self.host(robot, network)}:{self.port}"

    def write(self, folder):
        (folder / "robot.yaml").write_text(fleet.ROBOT)
        (folder / "sim.yaml").write_text(fleet.fleet({robot: self.address(robot) for robot in self.all if robot not in self.own}))
        # The mission reaches some robots through relays.
        addresses = {robot: self.address(robot, int(robot in self.relayed)) for robot in self.all}
        (folder / "fleet.yaml").write_text(fleet.fleet(addresses))
        cue = f"{{at: 0s, robots: all, tracks: {fleet.WAVE}}}"
        acts = "".join(f"  - act: a{act}\n    cues: [{cue}]\n" for act in range(self.acts))
        (folder / "show.yaml").write_text("scenario: soak\nstart_tolerance: 2s\nstop_condition: {running: 5s}\non_failure: without\n"
                                          f"acts:\n{acts}")


class Relay:
    """Forwards bytes to a robot, and can cut or stall the links."""

    def __init__(self, robot, crowd):
        self.robot, self.crowd, self.links = robot, crowd, set()
        self.open = asyncio.Event()
        self.open.set()

    async def start(self):
        await asyncio.start_server(self.forward, self.crowd.host(self.robot, 1), self.crowd.port)

    async def forward(self, reader, writer):
        try:
            robot_reader, robot_writer = await asyncio.open_connection(self.crowd.host(self.robot), self.crowd.port)
        except OSError:
            return writer.close()
        link = (writer, robot_writer)
        self.links.add(link)
        await asyncio.gather(self.one_way(reader, robot_writer), self.one_way(robot_reader, writer))
        self.links.discard(link)

    async def one_way(self, reader, writer):
        try:
            while data := await reader.read(65536):
                await self.open.wait()
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        writer.close()

    def cut(self):
        for link in list(self.links):
            for end in link:
                end.transport.abort()

    async def stall(self, seconds):
        self.open.clear()
        await asyncio.sleep(seconds)
        self.open.set()


class Robot:
    """A robot with its own process."""

    def __init__(self, robot, crowd, downbeat, folder, processes):
        self.robot, self.folder, self.processes, self.process = robot, folder, processes, None
        self.command = [downbeat, "robot", "--init", "robot.yaml", "--id", robot, "--listen", f"{crowd.host(robot)}:{crowd.port}",
                        "--realtime", "off"]

    async def start(self):
        self.process, _ = await asyncio.to_thread(self.processes.start_listening, *self.command, robots=1, cwd=self.folder)

    async def suspend(self, seconds):
        self.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)

    async def die(self):
        self.process.kill()
        await asyncio.to_thread(self.process.wait)
        await self.start()


class Faults:
    """Random faults, one after another, and the robots that had one."""

    def __init__(self, seed, relays, robots):
        self.rng = random.Random(seed)
        self.relays, self.robots, self.count, self.struck = relays, robots, {}, set()

    async def strike(self):
        while True:
            await asyncio.sleep(self.rng.expovariate(1 / FAULTS_EVERY))
            fault = self.rng.choice(["cut", "stalled", "suspended", "died"])
            victim = self.rng.choice(self.relays if fault in ("cut", "stalled") else self.robots)
            seconds = self.rng.uniform(*STALLS_FOR)
            self.count[fault] = self.count.get(fault, 0) + 1
            self.struck.add(victim.robot)
            if fault == "cut":
                victim.cut()
            elif fault == "stalled":
                await victim.stall(seconds)
            elif fault == "suspended":
                await victim.suspend(seconds)
            else:
                await victim.die()


async def play(downbeat, folder, processes, wrong):
    """The report of a mission, samples of the scheduler's memory, and the duration in seconds. `None` without a report."""
    command = [downbeat, "run", "show.yaml", "--realtime", "off", "--patience", "20s", "--join", "next_act", "--format", "json"]
    began = time.time()
    with open(folder / "report.json", "w") as out, open(folder / "errors", "w") as errors:
        run = processes.start(*command, cwd=folder, stdout=out, stderr=errors,
                              env={**os.environ, "DOWNBEAT_STATE": str(folder / "state")})
    ended, samples = asyncio.create_task(asyncio.to_thread(run.wait)), []
    while not ended.done():
        await asyncio.wait([ended], timeout=SAMPLE_EVERY_S)
        memory_mb = sampling.memory_mb(run.pid)
        samples += [(time.time() - began, memory_mb)] if memory_mb else []
    text = (folder / "report.json").read_text()
    if not text:
        wrong.append(f"a mission without a report: {(folder / 'errors').read_text()[:ERRORS_SHOWN]}")
        return None
    return json.loads(text), samples, time.time() - began


def judge(report, struck, acts, wrong):
    """The outcome, the number of played acts, and the number of starts. Adds each error to `wrong`."""
    outcome = reports.outcome(report)
    if outcome not in ("done", "done_without"):
        wrong.append(f"{outcome}: {report.get('because')}, {json.dumps(report['failures'][:3])}")
    played = sum(act["played"] for act in report["course"])
    if played != acts and outcome.startswith("done"):
        wrong.append(f"{played} of {acts} acts were played")
    starts = 0
    for robot in report["robots"]:
        starts += robot["started"]
        if robot["robot"] not in struck and (robot["standing"] != "in" or robot["started"] != played):
            reasons = reports.failures(report, robot["robot"])[:2]
            wrong.append(f"{robot['robot']} had no fault, is {robot['standing']} and started {robot['started']} of {played} times: {reasons}")
    return outcome, played, starts


def flat(subject, values_mb, wrong):
    """A line about the range of the values. Adds it to `wrong` if they differ too much."""
    if not values_mb:
        return f"{subject} not measured"
    low, high = min(values_mb), max(values_mb)
    if high > FLAT * low:
        wrong.append(f"{subject}: {low:.1f} to {high:.1f} MB")
    return f"{subject} {low:.1f} to {high:.1f} MB ({100 * (high / low - 1):.1f} %)"


async def soak(asked, downbeat, folder):
    """Plays the missions and prints the results. Returns the errors, and whether memory can be judged."""
    crowd = Crowd(asked.robots, asked.port or ports.free_port(), asked.acts)
    crowd.write(folder)
    # Number of missions until each robot keeps its highest number of answers.
    warm_missions = -(-ANSWERS_KEPT // asked.acts)
    wrong, sim_mb, peaks_mb, within, missions, all_starts = [], [], [], [], 0, 0
    table = Table("mission", "outcome", "acts", "took s", "starts", "robots with faults", "scheduler MB", "simulation MB",
                  widths=[7, 12, 4, 6, 8, 0, 0, 0])
    with Processes() as processes:
        sim, _ = processes.start_listening(downbeat, "sim", "sim.yaml", "--realtime", "off", robots=asked.robots - OWN, cwd=folder)
        relays = [Relay(robot, crowd) for robot in crowd.relayed]
        robots = [Robot(robot, crowd, downbeat, folder, processes) for robot in crowd.own]
        for each in [*relays, *robots]:
            await each.start()
        faults = Faults(asked.seed, relays, robots)
        striking = asyncio.create_task(faults.strike())
        try:
            until = time.time() + asked.minutes * 60
            while time.time() < until:
                faults.struck.clear()
                played = await play(downbeat, folder, processes, wrong)
                missions += 1
                if played is None:
                    continue
                report, samples, took_s = played
                outcome, acts, starts = judge(report, faults.struck, asked.acts, wrong)
                all_starts += starts
                warm = [megabytes for at, megabytes in samples if took_s * WARM_ACTS / asked.acts < at < took_s - REPORT_S]
                sim_mb.append(sampling.memory_mb(sim.pid))
                peaks_mb.append(max((megabytes for at, megabytes in samples if at < took_s - REPORT_S), default=0.0))
                if warm and outcome.startswith("done"):
                    within.append(max(warm) / min(warm) - 1)
                    flat("the scheduler within a mission", warm, wrong)
                table.row(missions, outcome, acts, took_s, starts, len(faults.struck), peaks_mb[-1], sim_mb[-1])
                await asyncio.to_thread(shutil.rmtree, folder / "state")
            # The peak over all ended processes, of which schedulers are the largest: the simulation still runs.
            with_report_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        finally:
            striking.cancel()
    print(f"{missions} missions, {all_starts} starts, faults: " + ", ".join(f"{count} {fault}" for fault, count in faults.count.items()))
    print(flat(f"simulation from mission {warm_missions} on", sim_mb[warm_missions - 1:], wrong))
    print(flat("peaks of the scheduler until its report", peaks_mb, wrong))
    print(f"a scheduler that writes its report {with_report_mb:.1f} MB at most")
    print(f"scheduler within a mission from act {WARM_ACTS} on: at most {100 * max(within, default=0):.1f} %")
    # Memory cannot be judged from a few missions, or from missions of few acts.
    return wrong, len(sim_mb) > warm_missions and bool(within)


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--robots", type=int, default=1000, help="robots (default: 1000)")
    parser.add_argument("--minutes", type=float, default=30, help="minutes after which no further mission begins (default: 30)")
    parser.add_argument("--acts", type=int, default=40, help="acts of a mission (default: 40)")
    parser.add_argument("--seed", default="0", help="seed of the faults (default: 0)")
    parser.add_argument("--port", type=int, help="port of the robots (default: a free one)")
    asked = parser.parse_args()
    if asked.robots < RELAYED + OWN:
        parser.error(f"--robots is at least {RELAYED + OWN}: {RELAYED} behind relays, {OWN} with a process each")
    downbeat = program.find_downbeat(asked.downbeat)
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        wrong, judged = asyncio.run(soak(asked, downbeat, Path(folder)))
    if wrong:
        sys.exit("\n".join(["WRONG:", *wrong]))
    print("no missed start, " + ("memory flat" if judged else "too short to judge memory"))


if __name__ == "__main__":
    main()
