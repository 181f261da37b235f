#!/usr/bin/env python3
"""When do lights and programs receive their values, and do fixtures of one universe disturb each other? Missions play two fixtures on one
sACN universe, one on an Art-Net universe, and a receiver of Open Sound Control. Receivers are Open Lighting Architecture (`olad`) and
`oscdump` in a network namespace of their own. Needs root and the Debian packages ola, ola-python and liblo-tools.

Prints, for each receiver, how late it received held values and how far a fade was off its plan, by the receiver's clock, which is that of the
scheduler. Exits 1 if a value is missing or a channel has another value than planned, or if the 95th percentile of held values is 3 ms or more.
"""

import array
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from downbeat_lab import fleet, program, reports
from downbeat_lab.machines import ip, machines, on
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table

LIGHTS, DESK = MACHINES = ["downbeat-lights", "downbeat-desk"]
LIGHTS_ADDRESS, DESK_ADDRESS = "192.168.78.1", "192.168.78.2"
SYSTEM_PYTHON = "/usr/bin/python3"
"""The interpreter for which Debian installs the module `ola`."""
OSC_PORT = 7770
SACN, ARTNET = 1, 2
"""Universes of olad. It receives Art-Net universes by the same numbers."""
STEPS, STEP_S = 40, 0.1
FADE_S = 3.0
LATE_P95_MS = 3.0
PLAYED = (0, 6)
"""Exit codes of missions that were played to the end; 6 if something was late."""

FIXTURE = """id: {}
api_version: '1'
reports: true
devices:
  - id: level
    channel: 1
    available_control_types:
      position: {{min_value: 0, max_value: 255, granularity: 1}}
      script: {{max_number_of_steps: 200}}
  - id: fade
    channel: [2, 3]
    interpolation: linear
    available_control_types:
      position: {{min_value: 0, max_value: 65535, granularity: 1}}
      script: {{max_number_of_steps: 200}}
"""
FIXTURES = {"spot-1": (f"sacn:{SACN}/1", SACN, 0), "spot-2": (f"sacn:{SACN}/11", SACN, 10), "par": (f"artnet:{ARTNET}/5@{LIGHTS_ADDRESS}", ARTNET, 4)}
"""Each fixture with its address, the universe of olad, and the index of its first channel."""
CUES = "cues"
"""The robot that receives OSC."""


def values(robot):
    """The planned values of the device `level`, all different from 0 and from their neighbours."""
    first = 20 * (1 + list([*FIXTURES, CUES]).index(robot))
    return [first + step * 3 for step in range(STEPS)]


def log_universes(*universes):
    """Prints the time in nanoseconds, the universe and the channels of each frame that olad receives. Runs until it is killed."""
    from ola.ClientWrapper import ClientWrapper  # only for the system's interpreter

    wrapper = ClientWrapper()

    def logs(universe):
        return lambda data: print(time.time_ns(), universe, array.array("B", data[:16]).tobytes().hex(), flush=True)

    for universe in universes:
        wrapper.Client().RegisterUniverse(universe, wrapper.Client().REGISTER, logs(universe))
    print("ready", flush=True)
    wrapper.Run()


def network():
    """Connects the machines, and lets multicasts of the desk reach the lights."""
    ip("-n", DESK, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", LIGHTS)
    for machine, address in ((LIGHTS, LIGHTS_ADDRESS), (DESK, DESK_ADDRESS)):
        ip("-n", machine, "addr", "add", f"{address}/24", "brd", "+", "dev", "eth0")
        ip("-n", machine, "link", "set", "eth0", "up")
        ip("-n", machine, "route", "add", "239.0.0.0/8", "dev", "eth0")


def start_olad(folder, processes):
    """Starts olad with sACN and Art-Net alone, and assigns their first inputs to the two universes."""
    names = "dummy espnet ftdidmx gpio karate kinet milinst opendmx openpixelcontrol osc pathport renard sandnet shownet spi stageprofi uartdmx usbdmx usbserial"
    for name in names.split():
        (folder / f"ola-{name}.conf").write_text("enabled = false\n")
    for path in [folder, *folder.iterdir()]:
        os.chown(path, 65534, 65534)
    # olad does not run as root.
    nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
    processes.start(*on(LIGHTS, *nobody), "olad", "-c", folder, "--no-http", "-l", "0", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    devices = {}
    for _ in range(100):
        listed = subprocess.run(on(LIGHTS, "ola_dev_info"), capture_output=True, text=True).stdout
        devices = {name: number for number, name in re.findall(r"Device (\d+): (ArtNet|E1\.31)", listed)}
        if len(devices) == 2:
            break
        time.sleep(0.1)
    else:
        sys.exit("olad does not offer sACN and Art-Net within 10 s")
    for name, universe in (("E1.31", SACN), ("ArtNet", ARTNET)):
        subprocess.run(on(LIGHTS, "ola_patch", "-d", devices[name], "-i", "-p", "0", "-u", str(universe)), check=True)


def collect(process, lines):
    """Reads the lines of a process, each with its time in nanoseconds, in a thread."""

    def read():
        for line in process.stdout:
            lines.append((time.time_ns(), line.split()))

    threading.Thread(target=read, daemon=True).start()


def write_show(folder):
    robots = {robot: address for robot, (address, _, _) in FIXTURES.items()} | {CUES: f"osc:{LIGHTS_ADDRESS}:{OSC_PORT}/stage"}
    for robot in robots:
        (folder / f"{robot}.yaml").write_text(FIXTURE.format(robot))
    (folder / "fleet.yaml").write_text(fleet.fleet(robots, init="{}.yaml"))
    cues = []
    for robot in robots:
        steps = ", ".join(f"{{at: {step * STEP_S:.1f}s, to: {value}}}" for step, value in enumerate(values(robot)))
        fade = f"{{at: 0s, to: 0}}, {{at: {FADE_S}s, to: 65535}}"
        cues.append(f"{{cue: {robot}, robots: {robot}, tracks: {{level: [{steps}], fade: [{fade}]}}}}")
    (folder / "show.yaml").write_text(fleet.scenario("lights", cues, "2s", "10ms"))


def held(frames, planned, level):
    """How late each planned value was received first, in ms. `frames` are times in s with data, of which `level` returns the value.

    Also returns the values that were missing, and those that were never planned.
    """
    late, missing, begun = [], [], [(at, value) for at, data in frames if (value := level(data)) is not None]
    for at, value in planned:
        received = next((time for time, found in begun if found == value and time >= at - 0.005), None)
        if received is None:
            missing.append(value)
        else:
            late.append((received - at) * 1000)
    known = {value for _, value in planned} | {0}
    return late, missing, sorted({value for _, value in begun} - known)


def faded(frames, start, level):
    """How far the fade was off its plan in each frame, in ms: positive if it was behind."""
    moving = [(at, value) for at, data in frames if (value := level(data)) is not None and 0 < value < 65535]
    return [(at - start - value / 65535 * FADE_S) * 1000 for at, value in moving]


def quantile(numbers, share):
    return sorted(numbers)[min(len(numbers) - 1, int(len(numbers) * share))] if numbers else float("nan")


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--missions", type=int, default=5)
    options = parser.parse_args()
    downbeat = program.find_downbeat(options.downbeat)
    results = {robot: ([], [], [], []) for robot in [*FIXTURES, CUES]}
    with tempfile.TemporaryDirectory() as folder, machines(MACHINES), Processes() as processes:
        folder = Path(folder)
        (folder / "olad").mkdir()
        os.chmod(folder, 0o755)
        network()
        start_olad(folder / "olad", processes)
        universes = processes.start(*on(LIGHTS, SYSTEM_PYTHON), __file__, "--log", str(SACN), str(ARTNET), stdout=subprocess.PIPE)
        if universes.stdout.readline().strip() != "ready":
            sys.exit("the module ola cannot be used; install the Debian package ola-python")
        dump = processes.start(*on(LIGHTS, "oscdump", "-L", str(OSC_PORT)), stdout=subprocess.PIPE)
        frames, messages = [], []
        collect(universes, frames)
        collect(dump, messages)
        write_show(folder)
        environment = {**os.environ, "DOWNBEAT_STATE": str(folder / "state")}
        for mission in range(options.missions):
            frames.clear()
            messages.clear()
            command = on(DESK, downbeat, "run", "show.yaml", "--format", "json")
            ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
            time.sleep(0.5)
            report = json.loads(ended.stdout)
            if ended.returncode not in PLAYED:
                print(f"mission {mission} was not played: {reports.outcome(report)} {'; '.join(reports.failures(report))}", file=sys.stderr)
                continue
            start = reports.instant(report["acts"][0]["start"])
            judge(results, start, frames, messages)
    show(results)


def judge(results, start, frames, messages):
    for robot, (late, missing, wrong, off) in results.items():
        if robot == CUES:
            own = [(at / 1e9, words[1:]) for at, words in messages]
            level = lambda words: int(words[-1]) if words[0] == "/stage/level" else None
            fade = lambda words: int(words[-1]) if words[0] == "/stage/fade" else None
        else:
            _, universe, first = FIXTURES[robot]
            own = [(int(words[0]) / 1e9, bytes.fromhex(words[2])) for _, words in frames if words[1] == str(universe)]
            level = lambda data, first=first: data[first] if len(data) > first else None
            fade = lambda data, first=first: int.from_bytes(data[first + 1 : first + 3], "big") if len(data) > first + 2 else None
        own = [(at, data) for at, data in own if at > start - 0.2]
        planned = [(start + step * STEP_S, value) for step, value in enumerate(values(robot))]
        found = held(own, planned, level)
        late.extend(found[0])
        missing.extend(found[1])
        # A mission begins with the last values of the one before.
        wrong.extend(value for value in found[2] if value != values(robot)[-1])
        off.extend(faded(own, start, fade))


def show(results):
    table = Table("receiver", "values", "median ms", "p95 ms", "max ms", "missing", "wrong", "fade p50", "p95", widths=[8] + [9] * 8, left=1)
    failed = False
    for robot, (late, missing, wrong, off) in results.items():
        p95 = quantile(late, 0.95)
        table.row(robot, len(late), quantile(late, 0.5), p95, max(late, default=float("nan")), len(missing), len(wrong),
                  quantile(off, 0.5), quantile([abs(ms) for ms in off], 0.95))
        failed |= not late or bool(missing or wrong) or not p95 < LATE_P95_MS
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--log"]:
        log_universes(*map(int, sys.argv[2:]))
    else:
        main()
