#!/usr/bin/env python3
"""How large can a fleet be? Plays one mission for each number of simulated robots, with `downbeat sim` and `downbeat run` as processes
that communicate over loopback:

  lab/large.py                                        1000, 2000, 5000 and 10000 robots, on TCP and on TLS
  lab/large.py --robots 1000 4000 --links tcp         other numbers, one kind of link: tcp, tls or zenoh
  lab/large.py --links zenoh --zenohd PATH            three routers of Zenoh: the scheduler at the first, half of the robots at the
                                                      second, half at the third; the program needs the feature zenoh

On Zenoh, or if one process may not open as many files as the fleet needs, several processes of `downbeat sim` share the fleet; figures
of the simulation are their sum. Prints a row for each mission: times, processor time and memory. Exits 1 if a mission fails, or if
processor time or memory grows faster than the fleet. 10000 robots need 30000 open files in the simulation and 20000 in the scheduler;
docs/large-fleets.md has the limits.
"""

import json
import math
import os
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

from downbeat_lab import fleet, ports, program, reports, sampling, shares
from downbeat_lab.processes import Processes, wait_with_usage
from downbeat_lab.tables import Table

# Highest accepted growth with the fleet, as the exponent of the number of robots: 1 is linear, and a busy machine adds a little.
GROWTH_MAX = 1.3
ROUTERS = "abc"
# Most robots of one `downbeat sim`: each needs three open files.
ROBOTS_PER_PROCESS = (resource.getrlimit(resource.RLIMIT_NOFILE)[1] - 200) // 3
# Number of arguments of one `downbeat keys robot`.
KEYS_PER_COMMAND = 2000
# The robots begin one after another: if a process moves ten thousand robots at one instant, the last one is more than 50 ms late and does
# not start.
SCENARIO = fleet.scenario("crowd", [f"{{at: 0s, robots: all, canon: 0.5ms, tracks: {fleet.WAVE}}}"], running="10s", start_tolerance="2s")
GROWING = ["run CPU s", "sim CPU s", "run MB", "sim MB"]
"""Columns whose growth is limited."""


class Place:
    """The link, the addresses of the robots and the ports of the routers."""

    def __init__(self, link, port, room, folder):
        self.link, self.room, self.folder = link, room, folder
        self.port = port or ports.free_port()
        self.router_ports = [port + index for index in range(len(ROUTERS))] if port else ports.free_ports(len(ROUTERS))

    def address(self, robot):
        """On TCP, each robot has its own loopback address, and all have the same port."""
        if self.link == "zenoh":
            return f"zenoh:hall/{robot // self.room}/r{robot}"
        return f"{self.link}://{ports.loopback(robot)}:{self.port}"

    def head(self, router):
        """The lines of the fleet file that state how to reach the robots."""
        return {"tcp": "", "tls": "identity: keys/operators/large.pem\n", "zenoh": f"zenoh: {ROUTERS[router]}.json5\n"}[self.link]

    def parts(self, robots):
        """The robots of each simulation process."""
        processes = 2 if self.link == "zenoh" else math.ceil(robots / ROBOTS_PER_PROCESS)
        return [range(robots * part // processes, robots * (part + 1) // processes) for part in range(processes)]

    def write(self, robots):
        (self.folder / "robot.yaml").write_text(fleet.ROBOT)
        (self.folder / "show.yaml").write_text(SCENARIO)
        init = "robot.yaml"
        if self.link == "tls":
            # The certificate of a robot contains its id.
            init = "robots/{}.yaml"
            (self.folder / "robots").mkdir(exist_ok=True)
            for robot in range(robots):
                (self.folder / f"robots/r{robot}.yaml").write_text(fleet.robot_with_id(f"r{robot}"))
        addresses = {f"r{robot}": self.address(robot) for robot in range(robots)}
        (self.folder / "fleet.yaml").write_text(fleet.fleet(addresses, init, head=self.head(0)))
        for part, members in enumerate(self.parts(robots)):
            own = {f"r{robot}": self.address(robot) for robot in members}
            (self.folder / f"part-{part}.yaml").write_text(fleet.fleet(own, init, groups={}, head=self.head(1 + part % 2)))

    def start_routers(self, zenohd, processes):
        """Starts the routers. The second and third router connect to the first."""
        routers = []
        for index, (name, port) in enumerate(zip(ROUTERS, self.router_ports)):
            endpoint, log = f"tcp/127.0.0.1:{port}", self.folder / f"router-{name}"
            (self.folder / f"{name}.json5").write_text(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
            connect = ["--connect", f"tcp/127.0.0.1:{self.router_ports[0]}"] if index else []
            with open(log, "w") as file:
                router = processes.start(zenohd, "--no-multicast-scouting", "--listen", endpoint, *connect, stdout=file, stderr=file)
            if not ports.wait_until_open(port, lambda: router.poll() is None):
                sys.exit(f"{zenohd}: {log.read_text()}")
            routers.append(router)
        return routers

    def start_robots(self, downbeat, robots, processes):
        keys = ["--keys", "keys"] if self.link == "tls" else []
        return [processes.start_listening(downbeat, "sim", f"part-{part}.yaml", "--realtime", "off", *keys, robots=len(members),
                                          errors=self.folder / f"sim-{part}", cwd=self.folder)[0]
                for part, members in enumerate(self.parts(robots))]


def make_keys(downbeat, folder, robots):
    keys = lambda *arguments: program.run(downbeat, "keys", *arguments, "--keys", "keys", folder=folder)
    keys("init")
    keys("operator", "large", "--role", "observe,drive,stop")
    for first in range(0, robots, KEYS_PER_COMMAND):
        names = [f"r{robot}" for robot in range(first, min(first + KEYS_PER_COMMAND, robots))]
        keys("robot", *names)


def sum_of(figure, processes, *arguments):
    return sum(figure(process.pid, *arguments) for process in processes)


def play(downbeat, zenohd, place, robots):
    """The row of one mission, and the errors that the scheduler printed."""
    place.write(robots)
    with Processes() as processes:
        routers = place.start_routers(zenohd, processes) if place.link == "zenoh" else []
        sims = place.start_robots(downbeat, robots, processes)
        idle_mb = sum_of(sampling.memory_mb, sims)
        cpu_before, routers_cpu_before = sum_of(sampling.processor_s, sims), sum_of(sampling.processor_s, routers)
        state, began = place.folder / "state", time.time()
        command = [downbeat, "run", "show.yaml", "--patience", "60s", "--realtime", "off", "--format", "json"]
        with open(place.folder / "report.json", "w") as out, open(place.folder / "errors", "w") as errors:
            run = processes.start(*command, cwd=place.folder, stdout=out, stderr=errors, env={**os.environ, "DOWNBEAT_STATE": str(state)})
        watch = sampling.Watch(run.pid, *(sim.pid for sim in sims))
        usage = wait_with_usage(run)
        whole_s = time.time() - began
        watch.end()
        printed = (place.folder / "errors").read_text()
        act = act_of(place, robots, printed)
        sent, start = reports.instant(act["timestamp"]), reports.instant(act["start"])
        row = {
            "robots": robots, "link": place.link,
            "greet s": sent - began,
            "decide s": act["lead"]["prepare_ms"] / 1000 - act["margin_left_ms"] / 1000,
            "lead s": start - sent, "window ms": act["window_ms"] or math.nan, "doubt ms": act["doubt_ms"],
            "spread ms": act["spread_ms"], "whole s": whole_s,
            "run CPU s": usage.ru_utime + usage.ru_stime, "sim CPU s": sum_of(sampling.processor_s, sims) - cpu_before,
            "run MB": usage.ru_maxrss / 1024, "sims": len(sims), "sim MB": sum_of(sampling.memory_mb, sims, "VmHWM"),
            "sim idle MB": idle_mb,
        }
        if routers:
            row["routers CPU s"] = sum_of(sampling.processor_s, routers) - routers_cpu_before
            row["routers MB"] = sum_of(sampling.memory_mb, routers, "VmHWM")
        row |= {
            "run files": watch.files_max[0], "sim files": max(watch.files_max[1:]),
            "journal MB": sum(path.stat().st_size for path in state.glob("*/journal")) / 2**20,
            "report MB": (place.folder / "report.json").stat().st_size / 2**20,
        }
    shutil.rmtree(state)
    return row, printed


def act_of(place, robots, printed):
    """The act in the report of a mission. Exits if the mission is not done."""
    report = json.loads((place.folder / "report.json").read_text() or "{}")
    if report.get("outcome") != "done":
        first = json.dumps(report.get("failures", [])[:2])
        sys.exit(f"{robots} robots, {place.link}: {json.dumps(report.get('outcome', 'no report'))}; {first}; {printed[:2000]}")
    return report["acts"][0]


def print_growth(link, rows):
    """Prints how each figure grows, and returns those that grow faster than the fleet."""
    first, last = rows[0], rows[-1]
    keys = [*GROWING, "window ms", *(["routers CPU s", "routers MB"] if link == "zenoh" else [])]
    grown = {key: shares.exponent(first[key], last[key], first["robots"], last["robots"]) for key in keys}
    print(f"{link}, growth from {first['robots']} to {last['robots']} robots: "
          + ", ".join(f"{key} N^{exponent:.2f}" for key, exponent in grown.items()))
    each = {key: (last[key] - first[key]) / (last["robots"] - first["robots"]) for key in keys}
    print(f"{link}, a robot: {each['run MB'] * 1024:.1f} KB and {each['run CPU s'] * 1e6:.0f} us of the scheduler, "
          f"{each['sim MB'] * 1024:.1f} KB and {each['sim CPU s'] * 1e6:.0f} us of the simulation")
    return [f"{link} {key}" for key in GROWING if grown[key] > GROWTH_MAX]


def main():
    parser = program.arguments(__doc__, zenoh=True)
    parser.add_argument("--robots", type=int, nargs="+", default=[1000, 2000, 5000, 10000], metavar="N")
    parser.add_argument("--links", nargs="+", choices=["tcp", "tls", "zenoh"], default=["tcp", "tls"])
    parser.add_argument("--port", type=int, help="port of the robots, and the first port of the routers (default: free ones)")
    parser.add_argument("--room", type=int, default=100, help="robots whose Zenoh keys have the same first words (default: 100)")
    asked = parser.parse_args()
    with_zenoh = "zenoh" in asked.links
    downbeat = program.find_downbeat(asked.downbeat, zenoh=with_zenoh)
    zenohd = program.find_zenohd(asked.zenohd) if with_zenoh else None
    too_fast = []
    with tempfile.TemporaryDirectory(prefix="large-") as folder:
        folder = Path(folder)
        if "tls" in asked.links:
            make_keys(downbeat, folder, max(asked.robots))
        for link in asked.links:
            place, rows, table = Place(link, asked.port, asked.room, folder), [], None
            for robots in asked.robots:
                row, printed = play(downbeat, zenohd, place, robots)
                rows.append(row)
                table = table or Table(*row)
                table.row(*row.values())
                for line in printed.splitlines():
                    print(f"    {line}")
            if len(rows) > 1:
                too_fast += print_growth(link, rows)
    if too_fast:
        sys.exit(f"grows faster than the fleet: {', '.join(too_fast)}")


if __name__ == "__main__":
    main()
