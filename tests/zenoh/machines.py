"""Called by .ci/zenoh-machines, which has made the machines: what several schedulers report, next to what their robots did."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

DOWNBEAT, ZENOHD, FOLDER = os.environ["DOWNBEAT"], os.environ["ZENOHD"], Path(os.environ["FOLDER"])
ROBOTS, STEPS, EVERY_MS = 20, 40, 100
HALVES = {"left": range(ROBOTS // 2), "right": range(ROBOTS // 2, ROBOTS), "all": range(ROBOTS)}

ROBOT = """id: robot
api_version: '1'
reports: true
devices:
  - id: d
    name: d
    available_control_types:
      position: {min_value: 0, max_value: 200, granularity: 1}
      script: {min_value: 0, max_value: 200, granularity: 1, max_number_of_steps: 200}
"""

processes = []
wrong = []


def on(machine, *command, **more):
    process = subprocess.Popen(["ip", "netns", "exec", f"downbeat-{machine}", *command], cwd=FOLDER, text=True, **more)
    processes.append(process)
    return process


def write():
    (FOLDER / "robot.yaml").write_text(ROBOT)
    rows = "".join(f"  r{i}: {{init: robot.yaml, address: 'zenoh:hall/r{i}'}}\n" for i in range(ROBOTS))
    groups = "".join(f"  {name}: [{', '.join(f'r{i}' for i in of)}]\n" for name, of in HALVES.items())
    (FOLDER / "fleet.yaml").write_text(f"zenoh: client.json5\nrobots:\n{rows}groups:\n{groups}")
    keyframes = ", ".join(f"{{at: {step * EVERY_MS}ms, to: {step + 1}}}" for step in range(STEPS))
    for name in HALVES:
        cue = f"  - {{at: 0s, robots: {name}, tracks: {{d: [{keyframes}]}}}}\n"
        head = f"scenario: {name}\nstart_tolerance: 2s\nstop_condition: {{running: 1s}}\n"
        (FOLDER / f"{name}.yaml").write_text(f"{head}cues:\n{cue}")
    router = '{mode: "router", listen: {endpoints: ["tcp/10.77.0.1:7447"]}, scouting: {multicast: {enabled: false}}}'
    (FOLDER / "router.json5").write_text(router)
    (FOLDER / "client.json5").write_text('{mode: "client", connect: {endpoints: ["tcp/10.77.0.1:7447"]}}')


def run(machine, scenario):
    environment = {**os.environ, "DOWNBEAT_STATE": str(FOLDER / f"state-{machine}")}
    arguments = [DOWNBEAT, "run", f"{scenario}.yaml", "--realtime", "off", "--format", "json"]
    return on(machine, *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)


def ended(process):
    out, errors = process.communicate(timeout=90)
    report = json.loads(out) if out.strip() else {}
    outcome = report.get("outcome", "no report")
    outcome = outcome if isinstance(outcome, str) else next(iter(outcome))
    said = {robot["robot"]: robot["steps_done"] for robot in report.get("robots", [])}
    unknown = {robot["robot"] for robot in report.get("robots", []) if robot["unaccounted"]}
    told = [failure["text"] for failure in report.get("failures", [])]
    return process.returncode, outcome, said, told, errors, unknown


def read_log():
    # Logs are written within 50 ms.
    time.sleep(0.5)
    lines = [json.loads(line) for line in (FOLDER / "robots.jsonl").read_text().splitlines()]
    return [line for line in lines if line.get("motion") == "set"]


def steps_since(before):
    """How many steps each robot has made since the log had so many lines, and the requests of which they were."""
    made, requests = dict.fromkeys((f"r{i}" for i in range(ROBOTS)), 0), set()
    for line in read_log()[before:]:
        if line.get("step") is not None:
            made[line["robot"]] += 1
            requests.add(line["request_id"])
    return made, requests


def expect(what, holds, *shown):
    print(f"{'as it should be' if holds else 'WRONG'}: {what}{': ' if shown else ''}{' '.join(str(each) for each in shown)}")
    if not holds:
        wrong.append(what)


def moved(made):
    return {robot for robot, steps in made.items() if steps > 0}


def names(half):
    return {f"r{i}" for i in HALVES[half]}


def play_both_at_once():
    before = len(read_log())
    first, second = run("one", "left"), run("two", "right")
    first, second = ended(first), ended(second)
    made, _ = steps_since(before)
    expect("two schedulers play with other robots at the same time", (first[:2], second[:2]) == ((0, "done"), (0, "done")), first[:2], second[:2])
    expect("both reports agree with the robots' log", {**first[2], **second[2]} == made == dict.fromkeys(made, STEPS), sorted(set(made.values())))


def want_the_same():
    before = len(read_log())
    first = run("one", "all")
    while not steps_since(before)[1]:
        time.sleep(0.05)
    second = ended(run("two", "left"))
    first = ended(first)
    made, requests = steps_since(before)
    expect("who comes second is refused", second[0] != 0 and second[1] != "done", second[0], second[1], second[3][:1] or second[4][-300:])
    expect("the first one plays to its end", first[:2] == (0, "done"), first[:2])
    expect("robots moved for the first one alone", first[2] == made == dict.fromkeys(made, STEPS) and len(requests) == ROBOTS, len(requests), "requests")


def want_the_same_at_once():
    before = len(read_log())
    both = [run("one", "all"), run("two", "all")]
    both = [ended(process) for process in both]
    made, requests = steps_since(before)
    done = [mission for mission in both if mission[1] == "done"]
    shown = [(mission[0], mission[1], mission[3][:1]) for mission in both]
    expect("of two that begin at once, one plays at most", len(done) <= 1 and len(requests) == ROBOTS * len(done), *shown)
    reported = done[0][2] if done else dict.fromkeys(made, 0)
    expect("and its report agrees with the log", made == reported, sorted(set(made.values())))


def lose_the_network():
    before = len(read_log())
    mission = run("one", "left")
    while len(moved(steps_since(before)[0])) < ROBOTS // 2:
        time.sleep(0.05)
    time.sleep(0.5)
    subprocess.run(["ip", "-n", "downbeat-one", "link", "set", "eth0", "down"], check=True)
    mission = ended(mission)
    made, _ = steps_since(before)
    subprocess.run(["ip", "-n", "downbeat-one", "link", "set", "eth0", "up"], check=True)
    played = {made[robot] for robot in names("left")}
    expect("robots that hear no more of their scheduler stop by their leases", max(played) < STEPS and moved(made) == names("left"), sorted(played))
    expect("the mission is not done", mission[0] != 0 and mission[1] != "done", mission[0], mission[1], mission[3][:1])
    expect("its report says no more than was so", all(mission[2].get(robot, 0) <= made[robot] for robot in names("left")), sorted(set(mission[2].values())))
    expect("and that it does not know the rest", mission[5] == names("left"), len(mission[5]), "robots with scripts unaccounted for")
    time.sleep(2)
    again = ended(run("two", "left"))
    expect("and another scheduler plays with them", again[:2] == (0, "done"), again[:2], again[3][:1])


def main():
    write()
    on("router", ZENOHD, "--config", "router.json5", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(1)
    arguments = ["sim", "fleet.yaml", "--log-file", "robots.jsonl", "--realtime", "off"]
    robots = on("robots", DOWNBEAT, *arguments, stdout=subprocess.PIPE)
    listening = 0
    while listening < ROBOTS:
        line = robots.stdout.readline()
        if not line:
            sys.exit("the robots did not start")
        listening += "listens on zenoh:" in line
    for trial in (play_both_at_once, want_the_same, want_the_same_at_once, lose_the_network):
        print(f"\n-- {trial.__name__.replace('_', ' ')}")
        trial()


try:
    main()
finally:
    for process in processes:
        process.kill()
sys.exit(1 if wrong else 0)
