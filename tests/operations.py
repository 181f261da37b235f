"""A mission of three robots, scraped by Prometheus: the values in Prometheus match the report.

    python3 tests/operations.py PROGRAM
"""

import json
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

PATIENCE_S = 60

ARM = """id: arm
api_version: '1'
reports: true
devices:
  - id: shoulder
    name: shoulder servo
    unit: deg
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: 8}
"""

SHOW = """scenario: watched
acts:
  - act: first
    cues:
      - cue: up
        robots: [left, right, near]
        tracks:
          shoulder: [{at: 0s, to: 0}, {at: 500ms, to: 30}, {at: 1s, to: 0}]
  - act: second
    wait: operator
    cues:
      - cue: up again
        robots: [left, right, near]
        tracks:
          shoulder: [{at: 0s, to: 0}, {at: 500ms, to: 30}]
"""


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def get(url):
    """Status and text of a response; the status is None if there is no response."""
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()
    except OSError as error:
        return None, str(error)


def await_that(what, holds):
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        if holds():
            return
        time.sleep(0.2)
    sys.exit(f"not within {PATIENCE_S} s: {what}")


def expect(what, value, expected):
    if value != expected:
        sys.exit(f"{what}: {value}, expected {expected}")
    print(f"  {what}: {value}")


class Prometheus:
    def __init__(self, folder, port, targets):
        self.url = f"http://127.0.0.1:{port}"
        config = folder / "prometheus.yml"
        config.write_text(json.dumps({
            "global": {"scrape_interval": "500ms", "scrape_timeout": "500ms"},
            "scrape_configs": [
                {"job_name": job, "static_configs": [{"targets": [f"127.0.0.1:{target}"]}]} for job, target in targets.items()
            ],
        }))
        log = (folder / "prometheus.log").open("w")
        self.process = subprocess.Popen(
            ["prometheus", f"--config.file={config}", f"--storage.tsdb.path={folder / 'data'}",
             f"--web.listen-address=127.0.0.1:{port}"], stdout=log, stderr=log)
        await_that("Prometheus is ready", lambda: get(f"{self.url}/-/ready")[0] == 200)

    def query(self, query):
        """The values of a query by their labels, without instance and job."""
        _, text = get(f"{self.url}/api/v1/query?" + urllib.parse.urlencode({"query": query}))
        answer = json.loads(text)
        if answer["status"] != "success":
            sys.exit(f"{query}: {answer}")
        rows = answer["data"]["result"]
        key = lambda row: tuple(value for label, value in sorted(row["metric"].items()) if label not in ("instance", "job", "__name__"))
        return {key(row): float(row["value"][1]) for row in rows}


def by_robot(report, key, factor=1):
    return {(robot["robot"],): round(robot[key] * factor, 9) for robot in report["robots"]}


def main():
    program, folder = os.path.abspath(sys.argv[1]), pathlib.Path(tempfile.mkdtemp(prefix="downbeat-operations-"))
    left, right, of_mission, of_robots, of_prometheus = (free_port() for _ in range(5))
    (folder / "arm.yaml").write_text(ARM)
    (folder / "show.yaml").write_text(SHOW)
    (folder / "fleet.yaml").write_text(
        f"robots:\n  left: {{init: arm.yaml, address: 'tcp://127.0.0.1:{left}'}}\n"
        f"  right: {{init: arm.yaml, address: 'tcp://127.0.0.1:{right}'}}\n  near: {{init: arm.yaml, address: sim}}\n")
    environment = {**os.environ, "DOWNBEAT_STATE": str(folder / "state")}
    start = lambda *words, **how: subprocess.Popen([program, *words], cwd=folder, env=environment, text=True, stdin=subprocess.DEVNULL, **how)
    processes = []
    try:
        processes.append(start("sim", "fleet.yaml", "--metrics", str(of_robots), stdout=subprocess.DEVNULL))
        await_that("robots are ready", lambda: get(f"http://127.0.0.1:{of_robots}/readyz")[0] == 200)
        prometheus = Prometheus(folder, of_prometheus, {"missions": of_mission, "robots": of_robots})
        processes.append(prometheus.process)
        # Prometheus starts its jobs one by one, seconds apart. Without this wait, the first mission ends before Prometheus asks the
        # robots.
        await_that("Prometheus asks the robots", lambda: prometheus.query('up{job="robots"}') == {(): 1.0})
        mission = start("run", "show.yaml", "--format", "json", "--metrics", str(of_mission), stdout=subprocess.PIPE)
        processes.append(mission)
        here = f"http://127.0.0.1:{of_mission}"
        await_that("the mission is ready", lambda: get(f"{here}/readyz")[0] == 200)
        expect("health of the mission", get(f"{here}/healthz")[0], 200)
        watch(prometheus, mission, here, environment, program)
        compare(prometheus, mission)
        expect("health of the robots after it", get(f"http://127.0.0.1:{of_robots}/healthz")[0], 200)
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            process.wait(timeout=30)
    shutil.rmtree(folder)


def watch(prometheus, mission, here, environment, program):
    """Checks the metrics while the second act waits for the operator."""
    played = {(): 1.0}
    await_that("Prometheus has the first act", lambda: prometheus.query("downbeat_mission_acts_played_total") == played)
    waits = 'downbeat_mission_acts{stage="waiting"}'
    await_that("the second act waits", lambda: set(prometheus.query(waits).values()) == {1.0})
    expect("phase", prometheus.query('downbeat_mission_phase == 1'), {("performing",): 1.0})
    _, page = get(f"{here}/metrics")
    checked = subprocess.run(["promtool", "check", "metrics"], input=page, text=True, capture_output=True)
    if checked.returncode != 0 or checked.stderr.strip():
        sys.exit(f"promtool check metrics: {checked.stdout}{checked.stderr}")
    print(f"  promtool check metrics: {sum(not line.startswith('#') for line in page.splitlines())} values are sound")
    stopped = subprocess.run([program, "stop"], env=environment, capture_output=True, text=True)
    expect("the stop of the mission", stopped.returncode, 0)


def compare(prometheus, mission):
    """Compares the last values in Prometheus with the report."""
    out, _ = mission.communicate(timeout=PATIENCE_S)
    report = json.loads(out)
    last = lambda metric: prometheus.query(f"last_over_time({metric}[1m])")
    expect("scripts started", last("downbeat_robot_scripts_started_total"), by_robot(report, "started"))
    expect("steps done", last("downbeat_robot_steps_done_total"), by_robot(report, "steps_done"))
    expect("steps late", last("downbeat_robot_steps_late_total"), by_robot(report, "late_steps"))
    expect("requests repeated", last("downbeat_robot_requests_repeated_total"), by_robot(report, "retries"))
    errors = {robot: round(error, 9) for robot, error in last("downbeat_robot_start_error_seconds").items()}
    expect("start errors", errors, by_robot(report, "start_error_ms", 1e-3))
    spread = {key: round(value, 9) for key, value in last("downbeat_mission_start_spread_seconds").items()}
    expect("spread", spread, {(): round(report["spread_ms"] / 1e3, 9)})
    expect("start errors counted", last("downbeat_mission_start_error_seconds_count"), {(): 3.0})
    failures = sum(last("downbeat_mission_failures_total").values())
    expect("failures", failures, float(len(report["failures"])))
    steps = last('downbeat_host_steps_set_total{job="robots"}')
    done = by_robot(report, "steps_done")
    expect("steps set by the robots of `downbeat sim`", steps, {robot: done[robot] for robot in [("left",), ("right",)]})


main()
