"""An edge with a program as its driver, under those limits of its systemd unit that can be set without systemd.

    python3 tests/unit_limits.py PROGRAM UNIT
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

NOBODY = 65534

LAMP = """id: lamp
api_version: '1'
reports: true
devices:
  - id: light
    name: light
    unit: percent
    default_value: 0
    available_control_types:
      position: {min_value: 0, max_value: 100, granularity: 1}
      script: {min_value: 0, max_value: 100, granularity: 1, max_number_of_steps: 8}
"""

DRIVER = """import sys
for line in sys.stdin:
    print("ok", flush=True)
"""


def allowed_by(unit):
    """The system calls of the unit's filter: those in its allow lists without those in its deny lists."""
    allowed, denied = set(), set()
    for line in re.findall(r"^SystemCallFilter=(.*)$", unit.read_text(), re.MULTILINE):
        kind = denied if line.startswith("~") else allowed
        for word in line.lstrip("~").split():
            kind |= expanded(word)
    return allowed - denied


def expanded(word):
    if not word.startswith("@"):
        return {word}
    listed = subprocess.run(["systemd-analyze", "syscall-filter", "--no-pager", word], capture_output=True, text=True, check=True)
    words = [line.strip() for line in listed.stdout.splitlines()[1:] if line.strip() and not line.strip().startswith("#")]
    return set().union(*map(expanded, words))


def granted():
    """How the edge gets its privileges: by the limits of the unit or, if limits cannot be raised on this machine, by two capabilities."""
    user = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", "--no-new-privs"]
    limits = ["prlimit", "--rtprio=50", "--memlock=unlimited"]
    if subprocess.run([*limits, "true"], capture_output=True).returncode == 0:
        return [*limits, *user, "--bounding-set=-all", "--inh-caps=-all"], "the limits of the unit, without a capability"
    needed = "+sys_nice,+ipc_lock"
    return [*user, f"--bounding-set=-all,{needed}", f"--inh-caps=-all,{needed}", f"--ambient-caps=-all,{needed}"], \
        "capabilities, because limits cannot be raised here"


def main():
    program, unit = os.path.abspath(sys.argv[1]), pathlib.Path(sys.argv[2])
    if os.geteuid() != 0:
        print("skipped: only root can take the limits of the unit")
        return
    folder = pathlib.Path(tempfile.mkdtemp(prefix="downbeat-unit-"))
    shutil.copy(program, folder / "downbeat")
    (folder / "lamp.yaml").write_text(LAMP)
    (folder / "driver.py").write_text(DRIVER)
    (folder / "state").mkdir()
    for path in [folder, folder / "state"]:
        os.chown(path, NOBODY, NOBODY)
    limits, means = granted()
    trace = folder / "state" / "trace"
    edge = ["./downbeat", "edge", "--init", "lamp.yaml", "--listen", "127.0.0.1:0", "--driver", "program:python3 driver.py",
            "--realtime", "required", "--log-file", "state/log"]
    command = [*limits, "strace", "-f", "-qq", "-o", str(trace), *edge]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(4)
    # The signal goes to the children of the tracer; the edge is its only child.
    children = pathlib.Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for child in children:
        os.kill(int(child), 15)
    out, told = process.communicate(timeout=60)
    if process.returncode != 0 or "robot lamp listens on" not in out:
        sys.exit(f"the edge ended with {process.returncode} within the limits of its unit:\n{out}{told}")
    if "SCHED_FIFO" not in told or "memory locked" not in told:
        sys.exit(f"within the limits of its unit the edge was not granted what it needs:\n{told}")
    calls = set(re.findall(r"^\d+ +(\w+)\(", trace.read_text(), re.MULTILINE))
    beyond = calls - allowed_by(unit)
    if beyond:
        sys.exit(f"{unit.name} refuses system calls that the edge or its driver make: {', '.join(sorted(beyond))}")
    print(f"an edge and its driver make {len(calls)} system calls, all of which {unit.name} allows")
    print(f"  SCHED_FIFO and locked memory by {means}")
    shutil.rmtree(folder)


main()
