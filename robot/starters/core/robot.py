#!/usr/bin/env python3
"""A URRCP robot of the profile Core: values for a start, stops, leases and refusals, without scripts, reports and inquiries.

Needs Python 3.9: python3 robot.py --listen 127.0.0.1:7000. Describe your robot in BLOCK, and put its hardware into `drive`.
"""
import datetime, json, math, re, selectors, socket, sys, time

BLOCK = {"id": "core-1", "api_version": "1", "devices": [
    {"id": "arm", "unit": "deg", "default_value": 0,
     "available_control_types": {"position": {"min_value": 0, "max_value": 90, "granularity": 0.5}}},
    {"id": "wheel", "unit": "m/s",
     "available_control_types": {"speed": {"min_value": -10, "max_value": 10, "granularity": 0.1}}}]}
LINE, LINKS, KEPT = 4096, 8, 8                  # bytes of a line; connections; ended requests whose answers are kept
MS, NEVER = 10**6, 1 << 100                     # all times are nanoseconds
SILENCE, LATE, AHEAD = 5000 * MS, 50 * MS, 250 * MS

def drive(device, value): pass                  # your hardware; it must return at once

class Refused(ValueError): pass                 # the message and the code of the answer
def need(condition, message, code="malformed"):
    if not condition:
        raise Refused(message, code)
def string(value): return isinstance(value, str) and len(value) <= 256 and not re.search("[\ud800-\udfff]", value)
def ident(value): return string(value) and value != ""
def boolean(value): return isinstance(value, bool)
def number(value): return type(value) in (int, float)
def period(value): return number(value) and 0 <= value <= 1e11
def digest(value): return string(value) and re.fullmatch("[0-9a-fA-F]{64}", value)
def timestamp(value): return string(value) and instant(value) is not None
def phases(value): return (value.get("pending"), value.get("running")) if isinstance(value, dict) else (value, value)
def lease(value): return all(each is None or period(each) for each in phases(value))
def ns(milliseconds): return NEVER if milliseconds is None else round(milliseconds * MS)
def stamp(at): return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(at // 10**9)) + f".{at % 10**9:09d}Z"
def instant(text):
    match = re.fullmatch(r"([0-9-]{10}T[0-9:]{8})(?:\.([0-9]{1,9}))?(Z|[+-][0-9]{2}:[0-9]{2})", text)
    need(match, "invalid timestamp, expected RFC 3339")
    at = int(datetime.datetime.fromisoformat(match[1] + match[3].replace("Z", "+00:00")).timestamp())
    need(abs(at) < 9.2e9, "the timestamp is too far away")
    return at * 10**9 + int((match[2] or "").ljust(9, "0"))
def finite(digits):
    need(math.isfinite(float(digits)), "expected a finite number")
    return float(digits)
def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "duplicate key in an object")
    return dict(pairs)
JSON = json.JSONDecoder(parse_int=finite, parse_float=finite, parse_constant=finite, object_pairs_hook=unique)
CLAIM = {"timestamp": timestamp, "session": ident, "seize": boolean}
CONTROL = {"device_id": ident, "control_type": string, "request_id": string, "session": ident, "timestamp": timestamp, "home": boolean,
           "time_offset_to_start": period, "stop_condition": lease, "pending_until": timestamp, "content_hash": digest}
STEP = {"time_offset_to_start": period, "control_type": string, "control_value": number, "stop_condition": lease}
def fields(body, checks, *required):
    need(isinstance(body, dict), "not an object")
    for key, check in checks.items():
        need(key not in required if body.get(key) is None else check(body[key]), f"{key} is missing or wrong")
    further = {key: value for key, value in body.items() if key.startswith("control_value_") and value is not None}
    known = further.keys() == {f"control_value_{n + 2}" for n in range(len(further))} and all(map(number, further.values()))
    need("control_value" not in checks or known and len(further) < 256, "control_value_N is a number, N from 2 without gaps")
    return {key: body.get(key) for key in checks}, further

class Device:
    def __init__(self, spec):
        self.id, self.default = spec["id"], spec.get("default_value")
        (self.kind, self.limits), = spec["available_control_types"].items()
        self.held, self.left_on, self.taken_back = None, None, -NEVER
    def rest(self, code, home=False):
        """Ends what the device does: a position stays, a speed goes to zero; with `home` it goes to its default value."""
        if self.held:
            self.held["end"] = code
        self.held = self.left_on = None
        target = self.default if home else None if self.kind == "position" else 0
        if target is not None:
            drive(self.id, target)

class Robot:
    def __init__(self):
        self.devices, self.answers, self.links = {spec["id"]: Device(spec) for spec in BLOCK["devices"]}, {}, []
        self.owner, self.owner_heard, self.clock = None, -NEVER, 0
    def run(self):
        """Does all that is due, and returns the nanoseconds until the next action."""
        now, due = time.time_ns(), NEVER
        shift = now - time.monotonic_ns()       # leases measure silence, independent of changes of the clock
        for device in self.devices.values():
            for c in [each for each in (device.held, device.left_on) if each]:
                heard = shift + (self.owner_heard if c["session"] else c["link"].heard)
                pending, running = (heard + ns(each) for each in phases(c["stop_condition"]))
                waits = c is device.held
                ends = min(pending, c["until"], max(running, c["start"])) if waits else running
                if ends <= now and (not waits or ends <= c["start"]):
                    c["end"] = "link_lost"
                    if waits:
                        device.held = None
                    else:
                        device.rest("link_lost")
                elif waits and c["start"] <= now:
                    device.held, c["end"] = None, "late" if now - c["start"] > LATE else None
                    if not c["end"]:
                        drive(device.id, c["value"])
                        device.left_on = c if device.kind != "position" and c["value"] and running < NEVER else None
                    due = now
                else:
                    due = min(due, ends, c["start"] if waits else NEVER)
        return max(due - time.time_ns(), 0)
    def hear(self, link, session, claims=True):
        """Renews leases and determines the owner. Returns whether the robot does not belong to this session."""
        now, idle = time.monotonic_ns(), not any(device.held or device.left_on for device in self.devices.values())
        if idle and (now - self.owner_heard >= SILENCE or all(other.session != self.owner for other in self.links)):
            self.owner = None
        if self.owner is None and session and claims:
            self.owner = session
            for device in self.devices.values():
                device.taken_back = min(device.taken_back, time.time_ns())
        link.heard, link.session = now, session or link.session
        self.owner_heard = now if link.session == self.owner else self.owner_heard
        return self.owner not in (None, session)
    def take(self, link, line, received):
        """The answer to a line."""
        name, body, result = None, None, {"status": "OK"}
        try:
            need(len(line) <= LINE, "the line is too long")
            message = JSON.decode(line.decode())
            need(isinstance(message, dict) and len(message) == 1, "a message is an object with one key")
            (name, body), = message.items()
            if name in ("availability_response", "initialization_block", "control_response", "inquiry_response"):
                return None
            if name == "control_request":
                return self.control(link, body)
            need(name in ("availability_request", "initialization_request"), "no such message")
            asked, _ = fields(body, CLAIM if name == "availability_request" else {"timestamp": timestamp})
            need(not asked.get("seize") or asked["session"], "`seize` requires a `session`")
            need(not asked.get("seize"), "nothing is proven on this connection", "forbidden")
            busy = self.hear(link, asked.get("session"))
            if name == "initialization_request":
                return {"initialization_block": BLOCK}
            result.update({"originate_timestamp": asked["timestamp"]} if asked["timestamp"] else {})
            need(not busy or asked["session"] is None, "the robot belongs to another session", "busy")
        except (ValueError, RecursionError) as fault:
            message, code = fault.args if isinstance(fault, Refused) else (str(fault), "malformed")
            result.update(status="Failed", error={"code": code, "message": message})
            if name == "control_request" and isinstance(body, dict) and ident(body.get("device_id")):
                return answer(body["device_id"], body.get("request_id") if string(body.get("request_id")) else None, code, message)
        return {"availability_response": {"receive_timestamp": stamp(received), "timestamp": stamp(time.time_ns()), **result}}
    def control(self, link, body):
        c, further = fields(body, CONTROL, "device_id", "control_type")
        kind, value, script = c["control_type"], body.get("control_value"), c["control_type"] == "script"
        need(not script or isinstance(value, list) and not further, "a script's value is one list")
        for step in value if script else [{**body, "time_offset_to_start": 0}] if re.fullmatch("position|speed|acceleration|custom_[0-9]+", kind) else []:
            _, further = fields(step, STEP, "time_offset_to_start", "control_type", "control_value")
            need(step["control_type"] not in ("script", "sensor"), "no control type for a step")
        offsets = [step["time_offset_to_start"] for step in value] if script else []
        need(offsets == sorted(offsets), "a step lies before the one ahead of it")
        busy, now, id = self.hear(link, c["session"]), time.time_ns(), c["request_id"]
        if id in self.answers:
            return answer(self.answers[id]["device_id"], id, self.answers[id]["end"], "as before", self.answers[id]["value"])
        sent = instant(c["timestamp"]) if c["timestamp"] else None
        start = sent + ns(c["time_offset_to_start"]) if sent is not None and c["time_offset_to_start"] is not None else now
        c.update(value=value, start=start, link=link, end=None, until=instant(c["pending_until"]) if c["pending_until"] else NEVER)
        device = self.devices.get(c["device_id"])
        try:
            need(not busy, "the robot belongs to another session", "busy")
            need(device, "no such device", "unknown_device")
            if script and not value:
                c["value"] = None
                if start > now:                 # a stop of what starts then or later
                    if device.held and device.held["start"] >= start:
                        device.held["end"], device.held = "cancelled", None
                else:
                    device.taken_back = max(device.taken_back, min(sent or -NEVER, now + AHEAD))
                    device.rest("cancelled", c["home"])
                return self.keep(c) or answer(device.id, id, None, None)
            need(kind == device.kind, "not the control type of the device", "unsupported_control_type")
            need(not further, "one value is enough")
            need(device.limits["min_value"] <= value <= device.limits["max_value"], "beyond its limits", "out_of_range")
            n = value / device.limits["granularity"]
            need(abs(n - round(n)) <= 1e-6, "no multiple of its granularity", "off_granularity")
            need(start >= now and c["until"] > now, "the start has passed", "late")
            need(sent is None or sent > device.taken_back, "cancelled by a stop that arrived before it", "cancelled")
            need(not device.held, "the device holds a command", "busy")
        except Refused as fault:
            c["end"] = fault.args[1]
            if c["end"] == "unsupported_control_type":
                device.rest("cancelled", home=True)
            if not (busy and c["end"] == "busy"):
                self.keep(c)
            return answer(c["device_id"], id, c["end"], fault.args[0])
        device.held = c
        return self.keep(c) or answer(device.id, id, None, None, value)
    def keep(self, c):
        if c["request_id"] is not None:
            self.answers[c["request_id"]] = c
        over = [key for key, each in self.answers.items() if all(each is not device.held for device in self.devices.values())]
        for key in over[:-KEPT]:
            del self.answers[key]

def answer(device, id, code, message, value=None):
    status = "Failed" if code else "OK" if value is None else "Accepted"
    body = {"timestamp": stamp(time.time_ns()), "device_id": device, "status": status, "status_value": None if code else value}
    body.update({"request_id": id} if id is not None else {}, **{"error": {"code": code, "message": message}} if code else {})
    return {"control_response": body}

class Link:
    def __init__(self, socket):
        self.socket, self.heard, self.session, self.read, self.skips, self.unsent = socket, time.monotonic_ns(), None, b"", False, b""

def main():
    host, _, port = sys.argv[sys.argv.index("--listen") + 1].rpartition(":")
    robot, poll, server = Robot(), selectors.DefaultSelector(), socket.create_server((host, int(port)))
    poll.register(server, selectors.EVENT_READ)
    print("listening on %s:%d" % server.getsockname()[:2], flush=True)
    def close(link):
        robot.links.remove(link)
        poll.unregister(link.socket)
        link.socket.close()
    while True:
        for key, _ in poll.select(min(robot.run() / 1e9, 0.25)):
            if key.fileobj is server:
                if len(robot.links) >= LINKS:   # a new connection replaces the one that has been silent for longest
                    close(min(robot.links, key=lambda link: link.heard))
                robot.links.append(Link(server.accept()[0]))
                robot.links[-1].socket.setblocking(False)
                robot.links[-1].socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                poll.register(robot.links[-1].socket, selectors.EVENT_READ, robot.links[-1])
                continue
            link = key.data
            if link not in robot.links:
                continue
            try:
                received, data = time.time_ns(), link.socket.recv(LINE)
                link.read += data
                while b"\n" in link.read or len(link.read) > LINE:
                    line, _, rest = link.read.partition(b"\n")
                    ended, link.read, skips = b"\n" in link.read, rest, link.skips
                    link.skips = not ended
                    if line.strip() and not skips:
                        robot.run()
                        reply = robot.take(link, line, received)
                        if reply:
                            link.socket.sendall(json.dumps(reply, separators=(",", ":")).encode() + b"\n")
                        robot.run()
            except OSError:                     # also a peer that does not read: its answers do not fit
                data = b""
            if not data:
                close(link)

if __name__ == "__main__":
    main()
