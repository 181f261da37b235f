#!/usr/bin/env python3
"""Which mistakes of implementers does `downbeat conformance` detect? Plants one mistake at a time in the example robot in Python, runs
`downbeat conformance` against it, and prints a row for each mistake:

  lab/mistakes.py
  lab/mistakes.py --all --only stop              # all requirements instead of the expected ones; mistakes with "stop" in their text
  lab/mistakes.py --correct 20 --loops 2         # the robot without a mistake, 20 times while two busy loops run

A mistake is detected if a requirement fails that the robot without the mistake passes. Exits 1 if a mistake is not detected, if none of
the requirements fails that are expected for it, or if a robot without a mistake fails a requirement.
"""

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from downbeat_lab import program
from downbeat_lab.mistakes import BASES, MISTAKES
from downbeat_lab.processes import Processes
from downbeat_lab.tables import Table

ROBOT = Path(__file__).parent.parent / "robot/starters/python/robot.py"
TIMEOUT_S = 900
# These requirements take long, and no mistake below concerns them.
SLOW = {"huge-line", "slow-reader", "silent-peers", "session-silence", "deep-nesting", "reconnect", "many-messages"}


def edited(source, edits):
    """The source with each text replaced, which occurs exactly once."""
    for old, new in edits:
        if source.count(old) != 1:
            raise SystemExit(f"expected this text once in {ROBOT}, found it {source.count(old)} times:\n{old}")
        source = source.replace(old, new)
    return source


def examine(downbeat, edits, device, only, custom=None):
    """The failed requirements, each with its reason, and the exit code."""
    with tempfile.TemporaryDirectory(prefix="mistakes-") as folder, Processes() as processes:
        (Path(folder) / "robot.py").write_text(edited(ROBOT.read_text(), edits))
        robot = processes.start(sys.executable, "robot.py", "--listen", "127.0.0.1:0", cwd=folder, stdout=subprocess.PIPE,
                                stderr=subprocess.DEVNULL)
        address = robot.stdout.readline().strip().rpartition(" ")[2]
        options = ["--tolerance", "100ms", "--format", "json"]
        options += ["--device", device] if device else []
        options += ["--custom", custom] if custom else []
        options += ["--only", ",".join(only)] if only else []
        command = [downbeat, "conformance", f"tcp://{address}", *options]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
    if not done.stdout.startswith("["):
        return {"(no report)": done.stderr.strip() or "nothing"}, done.returncode
    judged = json.loads(done.stdout)
    failed = {each["requirement"]: each["why"] for each in judged if each["verdict"] == "fail"}
    # The robot has no device that can be moved.
    return failed | ({"exit-code-5": ""} if done.returncode == 5 else {}), done.returncode


def known(downbeat):
    listed = json.loads(subprocess.run([downbeat, "conformance", "--list", "--format", "json"], capture_output=True, text=True).stdout)
    # The last requirements need an address with proofs of identity.
    return [each["requirement"] for each in listed if not each["section"].startswith("Proving") and each["requirement"] != "roles"]


def main():
    options = program.arguments(__doc__)
    options.add_argument("--all", action="store_true", help="check all requirements that are not slow, not only the expected ones")
    options.add_argument("--only", default="", metavar="TEXT", help="only mistakes whose class or title contains this text")
    options.add_argument("--at-once", type=int, default=4, metavar="N", help="robots at a time")
    options.add_argument("--correct", type=int, default=0, metavar="N", help="examine the robot without a mistake N times instead")
    options.add_argument("--loops", type=int, default=0, metavar="N", help="busy loops meanwhile")
    options.add_argument("--json", type=Path, help="a file for the failures of each mistake")
    given = options.parse_args()
    downbeat = program.find_downbeat(given.downbeat)
    with Processes() as loops:
        for _ in range(given.loops):
            loops.start(sys.executable, "-c", "while True: pass")
        sys.exit(examine_correct(downbeat, given) if given.correct else examine_mistakes(downbeat, given))


def examine_correct(downbeat, given):
    wrong = 0
    for n in range(given.correct):
        for name, base in BASES.items():
            failed, code = examine(downbeat, base.edits, base.device, None, base.custom)
            wrong += bool(failed or code)
            print(f"{n + 1} {name}: exit code {code}, {'; '.join(f'{key}: {why}' for key, why in failed.items()) or 'no failure'}", flush=True)
    return int(wrong > 0)


def examine_mistakes(downbeat, given):
    requirements = known(downbeat)
    mistakes = [each for each in MISTAKES if given.only.lower() in f"{each.about}: {each.title}".lower()]
    results = {}

    def run(mistake):
        base = BASES[mistake.base]
        only = [name for name in (requirements if given.all else mistake.by) if name in requirements and name not in SLOW - set(mistake.by)]
        if not only:
            return {}
        found, _ = examine(downbeat, [*base.edits, *mistake.edits], mistake.device or base.device, only, base.custom)
        return {name: why for name, why in found.items() if name != "(no report)"} if given.all else found

    with ThreadPoolExecutor(given.at_once) as pool:
        for mistake, failed in zip(mistakes, pool.map(run, mistakes)):
            results[mistake.title] = failed
    if given.json:
        given.json.write_text(json.dumps(results, indent=1))
    table = Table("class", "mistake", "detected", "by", widths=[10, 74, 8, 2], left=4)
    missed = 0
    for mistake in mistakes:
        failed = results[mistake.title]
        right = bool(set(failed) & set(mistake.by))
        missed += not right
        table.row(mistake.about, mistake.title, "yes" if right else "other" if failed else "NO", ", ".join(failed))
    print(f"{len(mistakes) - missed} of {len(mistakes)} mistakes are detected by an expected requirement")
    return int(missed > 0)


if __name__ == "__main__":
    main()
