"""A mission with --traces, and an independent collector: the received spans are decoded with the Python package opentelemetry-proto and
compared with the report of the mission. `.ci/traces` runs it: traces.py PROGRAM"""

import collections
import http.server
import json
import os
import shutil
import socket
import socketserver
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import (
    ExportTraceServiceRequest,
    ExportTraceServiceResponse,
)

PROGRAM = Path(sys.argv[1]).resolve()
ERROR = 2


class Collector(http.server.BaseHTTPRequestHandler):
    """Keeps the spans that it receives."""

    spans: list = []
    resources: list = []

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        assert self.path == "/v1/traces", self.path
        assert self.headers["Content-Type"] == "application/x-protobuf"
        request = ExportTraceServiceRequest.FromString(body)
        for of_resource in request.resource_spans:
            self.resources.append({a.key: a.value.string_value for a in of_resource.resource.attributes})
            for of_scope in of_resource.scope_spans:
                self.spans.extend(of_scope.spans)
        answer = ExportTraceServiceResponse().SerializeToString()
        self.send_response(200)
        self.send_header("Content-Type", "application/x-protobuf")
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, *_):
        pass


class Server(socketserver.ThreadingMixIn, http.server.HTTPServer):
    daemon_threads = True


def attributes(of):
    def value(any_value):
        return getattr(any_value, any_value.WhichOneof("value"))

    return {a.key: value(a.value) for a in of.attributes}


def run(arguments, expected):
    command = [PROGRAM, "run", *arguments, "--format", "json"]
    env = {**os.environ, "OTEL_RESOURCE_ATTRIBUTES": "deployment.environment=stage"}
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, env=env)
    assert ran.returncode == expected, (ran.returncode, ran.stdout[-2000:], ran.stderr[-2000:])
    return json.loads(ran.stdout), ran.stderr


def check_played(url):
    report, _ = run(["scripts/examples/meeting.yaml", "--traces", url], 0)
    spans = Collector.spans
    names = collections.Counter(span.name for span in spans)
    by_id = {span.span_id: span for span in spans}
    assert len({span.trace_id for span in spans}) == 1
    assert all(span.start_time_unix_nano <= span.end_time_unix_nano for span in spans)
    (mission,) = [span for span in spans if span.name == "mission"]
    told = attributes(mission)
    assert not mission.parent_span_id and mission.status.code != ERROR
    assert told["downbeat.outcome"] == report["outcome"], told
    assert told["downbeat.robots"] == len(report["robots"]), told
    acts = report["acts"]
    assert names["mission"] == names["greet"] == 1
    for part in ("prepare", "commit", "play"):
        assert names[part] == len(acts), (part, names)
    errors = []
    for act in acts:
        found = [span for span in spans if span.name == f"act {act['act']}"]
        assert len(found) == 1 and found[0].parent_span_id == mission.span_id, act["act"]
        (span,) = found
        told = attributes(span)
        lead = act["lead"]
        assert abs(told["downbeat.lead_ms"] - sum(lead[part] for part in ("prepare_ms", "lease_ms", "margin_ms"))) < 0.01, told
        parts = [other for other in spans if other.parent_span_id == span.span_id]
        robots = [other for other in parts if other.name.startswith("robot ")]
        assert robots, act["act"]
        assert all(span.start_time_unix_nano <= part.start_time_unix_nano for part in parts)
        assert all(part.end_time_unix_nano <= span.end_time_unix_nano for part in parts)
        for robot in robots:
            events = [event.name for event in robot.events]
            assert events[0] == "accepted" and events.count("started") >= 1, (robot.name, events)
            started = [attributes(event) for event in robot.events if event.name == "started"]
            errors += [event["downbeat.start_error_ms"] for event in started]
    largest = max(abs(robot["start_error_ms"]) for robot in report["robots"] if robot.get("start_error_ms") is not None)
    assert abs(max(map(abs, errors)) - largest) < 1e-6, (errors, largest)
    assert all(span.parent_span_id in by_id for span in spans if span is not mission)
    resource = Collector.resources[0]
    assert resource["service.name"] == "downbeat" and resource["deployment.environment"] == "stage", resource
    print(f"{len(spans)} spans of {len(acts)} acts agree with the report")


def check_not_started(url, folder):
    """If a robot is unreachable, the mission fails, and its trace reports that."""
    Collector.spans.clear()
    fleet = folder / "fleet.yaml"
    shutil.copy("scripts/examples/robots/ur5e.yaml", folder)
    there = "{init: ur5e.yaml, address: sim}"
    gone = "{init: ur5e.yaml, address: 'tcp://127.0.0.1:9'}"
    fleet.write_text(f"robots:\n  a: {gone}\n  b: {there}\n")
    show = folder / "show.yaml"
    show.write_text("scenario: two\ncues:\n  - {at: 0s, robots: [a, b], tracks: {shoulder_pan: [{at: 0s, to: 0}, {at: 1s, to: 10}]}}\n")
    report, _ = run([show, "--fleet", fleet, "--traces", url], 1)
    (mission,) = [span for span in Collector.spans if span.name == "mission"]
    assert mission.status.code == ERROR and attributes(mission)["downbeat.outcome"] == report["outcome"]
    failed = [attributes(event) for event in mission.events if event.name == "failed"]
    assert [event["downbeat.robot"] for event in failed] == ["a"], failed
    assert not [span for span in Collector.spans if span.name.startswith("act ")]
    print(f"a mission that did not start says so: {failed[0]['downbeat.failure']}")


def check_no_collector():
    """Without a collector the mission plays normally, and the operator gets a warning."""
    report, said = run(["scripts/examples/swap.yaml", "--traces", "http://127.0.0.1:9"], 0)
    assert report["outcome"] == "done" and "the trace is incomplete: " in said, said
    print("without a collector the mission is done, and a warning says that the trace was not sent")


class Refusing(http.server.BaseHTTPRequestHandler):
    """Rejects every request."""

    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        self.send_error(503)

    def log_message(self, *_):
        pass


def check_bad_collector(kind, url):
    """A faulty collector does not delay the mission; it delays only the end of the program, by seconds."""
    begin = time.monotonic()
    report, said = run(["scripts/examples/swap.yaml"], 0)
    without = time.monotonic() - begin
    begin = time.monotonic()
    report, said = run(["scripts/examples/swap.yaml", "--traces", url], 0)
    took = time.monotonic() - begin - without
    assert report["outcome"] == "done" and "the trace is incomplete: " in said, said
    warning = next(line for line in said.splitlines() if "the trace is incomplete: " in line)
    print(f"a collector that {kind}: done, {took:.1f} s later, with the warning: {warning.strip()}")


def check_bad_collectors():
    hanging = socket.create_server(("127.0.0.1", 0))
    check_bad_collector("answers nothing", f"http://127.0.0.1:{hanging.getsockname()[1]}")
    hanging.close()
    refusing = Server(("127.0.0.1", 0), Refusing)
    threading.Thread(target=refusing.serve_forever, daemon=True).start()
    check_bad_collector("refuses all", f"http://127.0.0.1:{refusing.server_address[1]}")


def main():
    server = Server(("127.0.0.1", 0), Collector)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_address[1]}"
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DOWNBEAT_STATE"] = f"{folder}/state"
        check_played(url)
        check_not_started(url, Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DOWNBEAT_STATE"] = f"{folder}/state"
        check_no_collector()
        check_bad_collectors()


main()
