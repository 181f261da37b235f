#!/usr/bin/env python3
"""When does hardware behind a ready driver receive its values, and does a mission report truthfully that it died? Each driver of
`robot/drivers/python` drives its counterpart: the servers of pymodbus and asyncua, the broker mosquitto, and simulated hardware for the others
(`robot/drivers/python/tests/counterparts.py`). Needs the packages of the drivers in the Python that runs it, and for MQTT the Debian packages
mosquitto and mosquitto-clients. A driver whose package is missing is skipped.

Prints, for each driver, how late the counterpart received held values and how far a ramp was off its plan, by the counterpart's log. Then stops a
mission, and kills the counterpart before and during one. Exits 1 if a value is missing, if the 95th percentile of held values is 3 ms or more, if a
value arrives after the end of a mission, or if a mission is reported as done although the counterpart died.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from downbeat_lab import fleet, program, reports
from downbeat_lab.ports import free_port
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table
from lights import held, quantile

PACKAGE = program.ROOT / "robot" / "drivers" / "python"
STEPS, STEP_S = 40, 0.1
LEVELS = [*range(2, 42, 2), *range(39, 0, -2)]
"""The held values, all different, and each close to its neighbours."""
TOP, HALF_S = 50, 2.0
"""A ramp leads from 0 to TOP and back, each in HALF_S."""
LATE_P95_MS = 3.0
WAIT_S = 20.0
PLAYED = (0, 6)
"""Exit codes of missions that were played to the end; 6 if something was late."""
STOPPED, DONE = 3, (0, 5, 6, 7)
HOST = "127.0.0.9"


@dataclass(frozen=True)
class Setup:
    """A driver with its counterpart. `value` turns a logged value into one of the device."""

    package: str
    target: str
    level: str
    fade: str
    value: callable
    unit: str = "%"
    fade_scale: float = 1.0
    """Of this part of a unit, the logged values of the ramp are multiples."""


SETUPS = {
    "serial_line": Setup("serial", "{port}", "level", "fade", float),
    "maestro": Setup("serial", "{port}", "0", "1", lambda text: (int(text) / 4 - 1000) / 10),
    "pca9685": Setup("downbeat_lab", "1", "0", "1", lambda text: (int(text) * 4.88 - 1000) / 10),
    "dynamixel": Setup("dynamixel_sdk", "{port}", "1", "2", lambda text: (int(text) - 2048) / 4096 * 360, "deg"),
    "modbus": Setup("pymodbus", "127.0.0.1:{number}", "h40", "h41:int16*100", float, fade_scale=0.01),
    "opcua": Setup("asyncua", "opc.tcp://127.0.0.1:{number}/", "'ns=2;s=arm'", "'ns=2;s=lamp'", float),
    "mqtt": Setup("paho", "127.0.0.1:{number}", "stage/level", "stage/fade", float),
    "crazyflie": Setup("cflib", "udp://127.0.0.1:{number}", "x", "z", lambda text: float(text) * 100, "cm"),
    "ur_rtde": Setup("rtde_control", HOST, "base", "wrist_3", lambda text: float(text) * 57.29577951, "deg"),
}
PLACES = {
    "dynamixel": ("1.116", "2.116"), "modbus": ("40", "41"), "opcua": ("arm", "lamp"), "ur_rtde": ("0", "5"),
}
"""The places of both devices in the log, if they differ from those in the address."""

ROBOT = """id: robot
api_version: '1'
reports: true
devices:
  - id: level
    unit: '{unit}'
    default_value: 0
    available_control_types:
      position: {{min_value: 0, max_value: 100, granularity: 1}}
      script: {{max_number_of_steps: 200}}
  - id: fade
    unit: '{unit}'
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {{min_value: 0, max_value: 100, granularity: 0.01}}
      script: {{max_number_of_steps: 200}}
"""


class Stage:
    """A driver and its counterpart in a folder."""

    def __init__(self, name, folder, downbeat, processes):
        self.name, self.setup, self.folder, self.downbeat, self.processes = name, SETUPS[name], folder, downbeat, processes
        self.log = folder / "log"
        self.number = free_port()
        self.port = folder / "port"
        self.places = PLACES.get(name, (self.setup.level, self.setup.fade))
        target = self.setup.target.format(port=self.port, number=self.number)
        command = f"{sys.executable} -m downbeat_driver.{name} {target} level={self.setup.level} fade={self.setup.fade}"
        (folder / "robot.yaml").write_text(ROBOT.format(unit=self.setup.unit))
        (folder / "fleet.yaml").write_text(fleet.fleet({"robot": f"program:{command}"}))
        levels = ", ".join(f"{{at: {step * STEP_S:.1f}s, to: {value}}}" for step, value in enumerate(LEVELS))
        fade = f"{{at: 0s, to: 0}}, {{at: {HALF_S}s, to: {TOP}}}, {{at: {2 * HALF_S}s, to: 0}}"
        self.write("show", f"{{level: [{levels}], fade: [{fade}]}}")
        self.write("long", "{fade: [{at: 0s, to: 0}, {at: 60s, to: 60}, {at: 64s, to: 0}]}")
        self.environment = {**os.environ, "DOWNBEAT_STATE": str(folder / "state"), "I2C_LOG": str(self.log),
                            "PYTHONPATH": f"{PACKAGE}:{PACKAGE / 'tests' / 'fakes'}"}

    def write(self, scenario, tracks):
        text = fleet.scenario(scenario, [f"{{cue: play, robots: robot, tracks: {tracks}}}"], "2s", "1s")
        (self.folder / f"{scenario}.yaml").write_text(text)

    def start_counterpart(self):
        self.log.write_text("")
        (self.folder / "log.disconnected").unlink(missing_ok=True)
        if self.name == "pca9685":
            return
        if self.name == "mqtt":
            mosquitto = shutil.which("mosquitto", path=os.environ["PATH"] + ":/usr/sbin")
            self.counterpart = self.processes.start(mosquitto, "-p", str(self.number), stderr=subprocess.DEVNULL)
            time.sleep(1)
            with open(self.log, "a") as log:
                self.processes.start("mosquitto_sub", "-p", str(self.number), "-t", "stage/#", "-F", "%U %t %p", stdout=log)
            time.sleep(0.5)
            return
        at = HOST if self.name == "ur_rtde" else self.port if "{port}" in self.setup.target else self.number
        command = [sys.executable, PACKAGE / "tests" / "counterparts.py", self.name, at, self.log]
        self.counterpart = self.processes.start(*map(str, command), stdout=subprocess.PIPE)
        if self.counterpart.stdout.readline() != "ready\n":
            sys.exit(f"the counterpart of {self.name} did not start")
        time.sleep(1)

    def kill_counterpart(self):
        if self.name == "pca9685":
            (self.folder / "log.disconnected").touch()
        else:
            self.counterpart.kill()
            self.counterpart.wait()

    def run(self, scenario):
        return subprocess.Popen([self.downbeat, "run", f"{scenario}.yaml", "--format", "json", "--patience", "15s"], cwd=self.folder,
                                env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def received(self):
        """Each received value: its time in seconds, the index of its device, and the value."""
        found = []
        for line in self.log.read_text().splitlines():
            at, place, value = line.split(" ", 2)
            seconds = float(at) / (1 if "." in at else 1e9)
            if place in self.places:
                device = self.places.index(place)
                found.append((seconds, device, self.setup.value(value) * (self.setup.fade_scale if device == 1 else 1.0)))
        return found

    def run_until_motion(self, scenario):
        """Starts a mission, and waits until the ramp has begun."""
        begun, running = time.time(), self.run(scenario)
        while not any(at > begun and value > 1 for at, device, value in self.received() if device == 1):
            if time.time() > begun + WAIT_S or running.poll() is not None:
                break
            time.sleep(0.05)
        return running


def ended(process):
    output, errors = process.communicate(timeout=90)
    try:
        report = json.loads(output)
    except json.JSONDecodeError:
        report = {"failures": [{"robot": "robot", "text": errors.strip()}]}
    return process.returncode, report


def play(stage, late, off, missing):
    """Plays a mission and judges the received values. Returns whether nothing arrived after its end, or `None` if it was not played."""
    before = time.time()
    code, report = ended(stage.run("show"))
    if code not in PLAYED:
        print(f"{stage.name}: a mission was not played: {'; '.join(reports.failures(report))}", file=sys.stderr)
        return None
    end = time.time()
    start = reports.instant(report["acts"][0]["start"])
    time.sleep(0.3)
    received = [each for each in stage.received() if each[0] >= before]
    levels = [(at, round(value)) for at, device, value in received if device == 0]
    planned = [(start + step * STEP_S, value) for step, value in enumerate(LEVELS)]
    found = held(levels, planned, lambda value: value)
    late.extend(found[0])
    missing.extend(found[1])
    rising = [(at, value) for at, device, value in received if device == 1 and 1 < value < TOP - 1 and at < start + HALF_S]
    off.extend(abs(at - start - value / TOP * HALF_S) * 1000 for at, value in rising)
    return max((at for at, *_ in received), default=0) <= end


def stop(stage):
    """Stops a mission in a movement. Returns its exit code, and whether the ramp ended there and nothing arrived afterwards."""
    running = stage.run_until_motion("long")
    subprocess.run([stage.downbeat, "stop"], cwd=stage.folder, env=stage.environment, capture_output=True)
    code, _ = ended(running)
    end = time.time()
    time.sleep(0.5)
    return code, not any(at > end for at, *_ in stage.received())


def kill(stage, before):
    """Kills the counterpart before or during a mission. Returns its exit code and the reported reason."""
    if before:
        stage.kill_counterpart()
        code, report = ended(stage.run("show"))
    else:
        running = stage.run_until_motion("long")
        stage.kill_counterpart()
        code, report = ended(running)
    return code, next(iter(reports.failures(report)), reports.outcome(report))


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--missions", type=int, default=3)
    parser.add_argument("--drivers", nargs="*", default=list(SETUPS), choices=list(SETUPS))
    options = parser.parse_args()
    downbeat = program.find_downbeat(options.downbeat)
    table = Table("driver", "missions", "values", "median ms", "p95 ms", "max ms", "missing", "ramp p95", "silent", "stopped", "killed before", "during",
                  widths=[11] + [9] * 11, left=1)
    failed, reasons = False, []
    for name in options.drivers:
        if importlib.util.find_spec(SETUPS[name].package) is None or name == "mqtt" and shutil.which("mosquitto_sub") is None:
            print(f"{name}: skipped, its package is not installed", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory() as folder, Processes() as processes:
            stage = Stage(name, Path(folder), downbeat, processes)
            stage.start_counterpart()
            late, off, missing = [], [], []
            played = [play(stage, late, off, missing) for _ in range(options.missions)]
            is_silent = False not in played
            stopped, is_over = stop(stage)
            during = kill(stage, before=False)
            stage.start_counterpart()
            before = kill(stage, before=True)
            p95 = quantile(late, 0.95)
            table.row(name, sum(each is not None for each in played), len(late), quantile(late, 0.5), p95, max(late, default=float("nan")), len(missing), quantile(off, 0.95),
                      "yes" if is_silent and is_over else "no", stopped, before[0], during[0])
            reasons += [f"{name}, killed before: {before[1]}", f"{name}, killed during: {during[1]}"]
            failed |= not p95 < LATE_P95_MS or bool(missing) or not is_silent or not is_over or stopped != STOPPED
            failed |= before[0] in DONE or during[0] in DONE
    print(*reasons, sep="\n")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
