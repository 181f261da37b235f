#!/usr/bin/env python3
"""A URRCP robot to copy: describe your robot in BLOCK and put its hardware into Arm; the rest is the protocol.

Needs Python 3.9 and its standard library: python3 robot.py --listen 127.0.0.1:7000 [--identity arm-1.pem [--revoked revoked.pem]]
Each device is a sensor, or is driven by one control type and scripts of it, and holds a value until the next is set.
"""
import argparse, asyncio, base64, contextlib, datetime, hashlib, json, math, os, re, ssl, sys, tempfile, time, types, urllib.parse

ANGLES = {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25}
SPEEDS = {"min_value": -10, "max_value": 10, "granularity": 0.1}
BLOCK = {"id": "arm-1", "name": "left arm", "type": "Industrial", "api_version": "1", "reports": True,
         "inquiry": True, "pending_until": True, "devices": [
    {"id": "shoulder", "name": "shoulder servo", "unit": "deg", "default_value": 0, "script_queue": 2,
     "available_control_types": {"position": ANGLES, "script": {**ANGLES, "max_number_of_steps": 1000}}},
    {"id": "wheel", "name": "wheel motor", "unit": "m/s", "script_queue": 1,
     "available_control_types": {"speed": SPEEDS, "script": {**SPEEDS, "max_number_of_steps": 1000}}},
    {"id": "camera", "name": "camera temperature", "unit": "degC",
     "available_control_types": {"sensor": {"min_value": -40, "max_value": 125, "max_delay": 20}}}]}

class Arm:
    """Your hardware. All methods must return at once; an exception is reported to the server as `internal`."""
    def set(self, device, value): pass
    def rest(self, device, value): pass         # a stop or the default state: go to the value; None: keep the position
    def read(self, device): return 42.5

MAX_LINE, MAX_UNREAD = 1 << 18, 1 << 20         # bytes, room for 1000 steps; a peer that exceeds either is disconnected
MAX_NAMES, KEPT = 1000, 512                     # names in an inquiry; last answers, the protocol requires 256
MAX_LINKS, STRANGERS = 32, 16                   # connections, and those of them whose session does not own the robot
MS, NEVER = 1_000_000, 1 << 100                 # all times are nanoseconds
LATE_STEP, LATE_START, SILENCE, FUTURE = 1 * MS, 50 * MS, 5000 * MS, 5000 * MS
FIRST, BEGUN = 5000 * MS, 10000 * MS            # for the first message, and for a stranger to complete a message
SPIN = 1.5 * MS                                 # busy-waits for this long before a step is due

class Refused(ValueError):
    """The arguments are the message and the code of the answer."""
    def __str__(self): return self.args[0]
def need(condition, message, code="malformed"):
    if not condition:
        raise Refused(message, code)

# Checks of the values in messages. Keys that are not in these tables are ignored.
def string(value): return isinstance(value, str) and len(value) <= 256 and not re.search("[\ud800-\udfff]", value)
def ident(value): return string(value) and value != ""
def digest(value): return string(value) and re.fullmatch("[0-9a-fA-F]{64}", value)
def timestamp(value): return string(value) and instant(value) is not None
def boolean(value): return isinstance(value, bool)
def number(value): return type(value) in (int, float)
def period(value): return number(value) and 0 <= value <= 1e11
def names(check): return lambda value: isinstance(value, list) and len(value) <= MAX_NAMES and all(map(check, value))
def lease(value): return all(each is None or period(each) for each in phases(value))
def ns(milliseconds): return NEVER if milliseconds is None else round(milliseconds * MS)
def stamp(at): return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(at // 10**9)) + f".{at % 10**9:09d}Z"
def phases(value): return [value.get("pending"), value.get("running")] if isinstance(value, dict) else [value, value]

STEP = {"time_offset_to_start": period, "control_type": string, "control_value": number, "stop_condition": lease}
CONTROL = {"time_offset_to_start": period, "control_type": string, "stop_condition": lease, "timestamp": timestamp, "home": boolean,
           "device_id": ident, "request_id": string, "content_hash": digest, "session": ident, "pending_until": timestamp}
REQUESTS = {"availability_request": {"timestamp": timestamp, "session": ident, "seize": boolean}, "control_request": CONTROL,
            "initialization_request": {"timestamp": timestamp},
            "inquiry": {"timestamp": timestamp, "session": ident, "pending_lease": period,
                        "pending_until": timestamp, "requests": names(string), "devices": names(ident)}}
OF_ROBOTS = ["availability_response", "initialization_block", "control_response", "inquiry_response"]    # sent by robots

def instant(value):
    match = re.fullmatch(r"([0-9-]{10}T[0-9:]{8})(?:\.([0-9]{1,9}))?(Z|[+-][0-9]{2}:[0-9]{2})", value.upper())
    need(match, "invalid timestamp, expected RFC 3339")
    at = datetime.datetime.fromisoformat(match[1] + match[3].replace("Z", "+00:00")).timestamp()
    need(abs(at) < 9.2e9, "a timestamp lies too far away")
    return int(at) * 10**9 + int((match[2] or "").ljust(9, "0"))

def finite(digits):
    value = float(digits)
    need(math.isfinite(value), "expected a finite number")
    return int(value) if value.is_integer() and abs(value) < 1e16 else value
def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "duplicate key in an object")
    return dict(pairs)
JSON = json.JSONDecoder(parse_int=finite, parse_float=finite, parse_constant=finite, object_pairs_hook=unique)

class Fields:
    """The known keys of an object as attributes; None if they are missing."""
    def __init__(self, body, checks, *required):
        need(isinstance(body, dict), "not an object")
        for key, check in checks.items():
            setattr(self, key, body.get(key))
            need(key not in required if body.get(key) is None else check(body[key]), f"{key} is missing or wrong")
        further = {key: body[key] for key in body if key.startswith("control_value_") and body[key] is not None}
        known = further.keys() == {f"control_value_{n + 2}" for n in range(len(further))} and all(map(number, further.values()))
        need("control_value" not in checks or known and len(further) < 256, "control_value_N is a number, N from 2 to 256 without gaps")
        self.further = further

class Command(Fields):
    """A control request; after its acceptance, a command that is held until it ends."""
    def __init__(self, body, line, link):
        super().__init__(body, CONTROL, "device_id", "control_type")
        self.link, self.sensor, self.script = link, self.control_type == "sensor", self.control_type == "script"
        self.value, self.passed, self.done, self.late, self.latest = body.get("control_value"), 0, 0, 0, 0
        self.until = instant(self.pending_until) if self.pending_until else NEVER
        need(not self.script or isinstance(self.value, list) and not self.further, "a script's value is one list")
        valued = re.fullmatch("position|speed|acceleration|custom_[0-9]+", self.control_type)
        steps = self.value if self.script else [{**body, "time_offset_to_start": 0}] if valued else []
        self.steps = [Fields(step, STEP, "time_offset_to_start", "control_type", "control_value") for step in steps]
        need(all(step.control_type not in ("script", "sensor") for step in self.steps), "no control type for a step")
        self.offsets = [ns(step.time_offset_to_start) for step in self.steps]
        need(self.offsets == sorted(self.offsets), "a step lies before the one ahead of it")
        leases = [self.stop_condition if step.stop_condition is None else step.stop_condition for step in self.steps]
        self.leases = phases(self.stop_condition) + [phases(each)[1] for each in leases]    # pending, running, then after each step
        self.hash = self.content_hash.lower() if self.content_hash and (valued or self.script) else None
        if self.hash:                           # over the received control_value, which then has the canonical form
            key = re.search(r'"control_value"\s*:\s*', line)
            found, end = JSON.raw_decode(line, key.end()) if key else (None, 0)
            self.right = found == self.value and self.hash == hashlib.sha256(line[key.end():end].encode()).hexdigest()
    def lease_ends(self, heard):
        """Also ends where the lease after the next step would already be over: that step is not done."""
        if self.passed == len(self.times):
            return heard + ns(self.leases[-1])
        following = 2 if self.passed == 0 == self.offsets[0] else self.passed + 1
        now, then = heard + ns(self.leases[self.passed]), heard + ns(self.leases[following])
        return min(now, NEVER if self.passed else self.until, max(self.times[self.passed], then))

class Device:
    def __init__(self, spec):
        self.id, self.types, self.default = spec["id"], spec["available_control_types"], spec.get("default_value")
        self.drive = next((kind for kind in self.types if kind not in ("script", "sensor")), None)
        self.still = None if self.drive in (None, "position") else 0
        self.position = {}                      # the last one that the hardware has accepted
        self.queue, self.held, self.taken_back = spec.get("script_queue", 1), [], -NEVER
        self.left_on = []                       # the ended command whose lease covers a speed that continues

def check(c, device, now):
    """All reasons to refuse a request, in the order of the protocol."""
    need(device, "the robot has no such device", "unknown_device")
    need(not c.hash or c.right, "content_hash is not that of control_value")
    need(c.control_type in device.types or c.script and not c.steps, "not one of its types", "unsupported_control_type")
    if not c.steps:
        return
    kinds = device.types[c.control_type], device.types[device.drive]
    need(len(c.steps) <= kinds[0].get("max_number_of_steps", 1), "the script is too long", "too_many_steps")
    for step in c.steps:
        need(step.control_type == device.drive, "not in scripts of this device", "unsupported_control_type")
        need(not step.further, "one value is enough")
        value = step.control_value
        need(all(its["min_value"] <= value <= its["max_value"] for its in kinds), "beyond its limits", "out_of_range")
        for n in [value / its["granularity"] for its in kinds]:
            need(abs(n - round(n)) < 1e-6, "no multiple of its granularity", "off_granularity")
    need(c.times[0] >= now, "the start has passed", "late")
    need(c.until > now, "pending_until has passed", "late")
    need(c.timestamp is None or c.sent > device.taken_back, "cancelled by a stop that arrived before it", "cancelled")
    for other in device.held:
        need(c.times[0] >= other.times[-1] or other.times[0] >= c.times[-1], "it is not free all that time", "overlap")
    need(len(device.held) < device.queue, "the device holds as many commands as it can", "busy")

class Robot:
    def __init__(self, arm, keys=None):
        self.arm, self.links, self.owner, self.owner_heard = arm, [], None, 0
        self.keys, self.key = keys, None        # None without TLS; the key with which the owner last proved its identity
        self.seized = None, None                # from which session, and by whom
        self.answers, self.facts = {}, {}       # by request_id: the last answer, and further data for inquiries
        self.devices = {spec["id"]: Device(spec) for spec in BLOCK["devices"]}
        self.timer = asyncio.get_running_loop().call_soon(self.run)
        self.watching = asyncio.gather(self.watch(), *[self.watch_keys()] if keys else [])
    def run(self):
        """Runs the due actions in order of time; at the same instant, leases before steps. Then waits for the next action. An ended lease
        of a running command comes first: a delayed robot would otherwise do steps that were due before."""
        while True:
            now, due = time.time_ns(), [(NEVER, 0, [], None)]
            shift = now - time.monotonic_ns()   # leases measure silence, independent of clock changes
            for device in self.devices.values():
                for c in device.held + device.left_on:
                    ends = c.lease_ends(shift + (self.owner_heard if c.session else c.link.heard))
                    over = c.passed > 0 and ends <= now
                    due.append((0 if over else ends, int(c.passed == 0), c.times, self.lose, device, c))
                due += [(c.times[c.passed], 2, c.times, self.go_on, device, c) for c in device.held]
            at, _, _, act, *what = min(due, key=lambda each: each[:3])
            if at > now:
                break
            act(*what, now)
        self.timer.cancel()
        self.timer = asyncio.get_running_loop().call_later(min(max(at - now - SPIN, 0), 250 * MS) / 1e9, self.run)
    def go_on(self, device, c, now):
        """Starts a command, or does its next step."""
        late, c.passed = now - c.times[c.passed], c.passed + 1
        if c.passed == 1 and late > LATE_START:
            return self.drop(device, [c], "late", "the robot was delayed at the start", now)
        if c.passed == 1:
            return None                         # it starts with its first value, which may come later
        value = c.steps[c.done].control_value
        try:
            self.arm.set(device.id, value)
            device.position = {"position": value} if device.drive == "position" else {}
        except Exception as fault:
            device.position = {}
            return self.rest(device, "internal", str(fault), now)
        c.done, c.late, c.latest, device.left_on = c.done + 1, c.late + (late > LATE_STEP), max(c.latest, late), []
        if c.done == 1:
            self.facts.get(c.request_id, {}).update(event_timestamp=stamp(now))
            self.respond(c, "Started", value, now)
        if c.done == len(c.steps):
            device.held.remove(c)
            device.left_on = [c] if device.still not in (None, value) and c.leases[-1] is not None else []
            latest = {"late_ms_max": c.latest / MS} if c.late else {}
            self.respond(c, "OK", value, now, steps_done=c.done, late_steps=c.late, **latest)
    def lose(self, device, c, now):
        """A lease has ended. If it was of a running command, all end; if it was pending, those that start then or later."""
        why = "link_lost", f"the {'running' if c.passed else 'pending'} lease ended", now
        if c.passed:
            return self.rest(device, *why)
        self.drop(device, [other for other in device.held if not other.passed and other.times[0] >= c.times[0]], *why)
    def rest(self, device, code, message, now, home=False):
        """Ends everything: a speed goes to zero, a position stays; with `home` the device goes to its default state."""
        ended = device.held + (device.left_on if code == "link_lost" else [])
        device.left_on = []
        with contextlib.suppress(Exception):
            goes_home = home and device.default is not None
            self.arm.rest(device.id, device.default if goes_home else device.still)
            device.position = {"position": device.default} if goes_home and device.drive == "position" else device.position
        self.drop(device, ended, code, message, now)
    def drop(self, device, commands, code, message, now):
        device.held = [c for c in device.held if c not in commands]
        for c in sorted(commands, key=lambda c: c.times):
            self.respond(c, "Failed", None, now, steps_done=c.done, error={"code": code, "message": message})
    def respond(self, c, status, value=None, event=None, **more):
        """Sends a report of an event, or returns an answer; both are kept for repeated requests."""
        body = {"timestamp": stamp(time.time_ns()), "device_id": c.device_id, "status": status, "status_value": value,
                **more, **({"event_timestamp": stamp(event)} if event else {})}
        if c.request_id is not None:
            body["request_id"] = c.request_id
        if c.request_id is not None and status != "Provide":
            self.answers.pop(c.request_id, None)
            self.answers[c.request_id] = body
            self.facts.setdefault(c.request_id, {key: more[key] for key in ("content_hash",) if key in more})
            ended = [key for key, old in self.answers.items() if old["status"] not in ("Accepted", "Started")]
            for key in ended[:-KEPT]:
                del self.answers[key], self.facts[key]
        links = [link for link in self.links if (link.session == c.session if c.session else link is c.link)]
        if event and links:
            send(max(links, key=lambda link: link.heard), {"control_response": body})
        return {"control_response": body}
    def hear(self, link, session, claims=True):
        """Renews leases and determines the owner. Returns why the robot does not belong to this session, or None."""
        now, devices = time.monotonic_ns(), self.devices.values()
        gone = now - self.owner_heard >= SILENCE or all(other.session != self.owner for other in self.links)
        if gone and not any(device.held or device.left_on for device in devices):
            self.owner = None
        if self.owner is None and session and claims:
            self.owner = session
            for device in devices:      # strangers may have stopped a free robot with a future timestamp
                device.taken_back = min(device.taken_back, time.time_ns())
        link.heard, link.spoken, link.session = now, True, session or link.session
        if link.session == self.owner:
            self.owner_heard, self.key = now, link.key
        if self.owner not in (None, session) and session and self.seized[0] == session:
            return f"`{BLOCK['id']}` was taken over by {self.seized[1]}"
        if self.owner not in (None, session):
            return f"`{BLOCK['id']}` belongs to another session until that session ends"    # whose name is a secret
    def seize(self, link, session):
        """Takes the robot from another session: all commands of others end and come to rest, then this session owns it."""
        devices = self.devices.values()
        others = any(c.session != session for device in devices for c in device.held + device.left_on)
        if self.hear(link, session) or others:
            self.seized = self.owner if self.owner != session else None, link.who
            for device in devices:
                self.rest(device, "cancelled", f"taken by {link.who}", time.time_ns())
            self.owner = None
    def take(self, link, line, received):
        """The answer to a line."""
        def permit(*roles):                     # for a peer with a proven identity; before anything is renewed or claimed
            need(not (why := self.invalid(link.key)), why, "forbidden")
            told = f"the role{'s' * (len(link.roles) > 1)} {', '.join(sorted(link.roles))}" if link.roles else "no role"
            need(link.roles is None or link.roles & set(roles), f"{link.who} has {told}, but this requires the role {' or '.join(roles)}", "forbidden")
        name, body, result, kind = None, None, {"status": "OK"}, "availability_response"
        try:
            message = JSON.decode(line := line.decode())
            need(isinstance(message, dict) and len(message) == 1, "a message is an object with one key")
            (name, body), = message.items()
            if name in OF_ROBOTS:
                return None
            need(name in REQUESTS, "no such message")
            if name == "control_request":
                c = Command(body, line, link)
                stops = not c.sensor and not c.steps and not c.home and (not c.timestamp or c.time_offset_to_start is None)
                permit(*["observe", "drive"] if c.sensor else ["stop", "drive"] if stops else ["drive"])
                return self.control(link, c, stops and not c.session and "stop" in (link.roles or ()))
            request = Fields(body, REQUESTS[name])
            asks = name == "initialization_request" or request.session is None
            permit(*["drive"] if not asks else ["observe", "drive"] if name == "inquiry" else ["observe", "drive", "stop"])
            if name == "availability_request" and request.seize:
                need(request.session, "`seize` requires a `session`")
                need(link.roles is not None, "the robot can be seized only by an operator with the role seize; this connection has not proven any role", "forbidden")
                permit("seize")
            if name != "initialization_request":
                request.session = own(link, request.session)
            if name == "availability_request" and request.seize:
                self.seize(link, request.session)
            result.update({"originate_timestamp": request.timestamp} if request.timestamp else {})
            busy = self.hear(link, getattr(request, "session", None), name != "inquiry")
            if name == "initialization_request":
                return {"initialization_block": BLOCK}
            kind = "inquiry_response" if name == "inquiry" else kind
            need(not busy or name != "inquiry" and request.session is None, busy, "busy")
            result.update(self.inquire(link, request) if name == "inquiry" else {})
        except (ValueError, RecursionError) as fault:
            message, code = fault.args if isinstance(fault, Refused) else (str(fault), "malformed")
            result.update({"status": "Failed", "error": {"code": code, "message": message}})
            meant = body if name == "control_request" and isinstance(body, dict) else {}
            if ident(meant.get("device_id")):
                ids = {key: meant[key] for key in ("device_id", "request_id") if string(meant.get(key))}
                return {"control_response": {"timestamp": stamp(time.time_ns()), "status_value": None, **ids, **result}}
        times = {"receive_timestamp": stamp(received), "timestamp": stamp(max(received, time.time_ns()))}
        return {kind: {**times, **result}}
    def inquire(self, link, asked):
        """The state of requests, and how many more commands devices can hold. Changes only leases."""
        held = {c.request_id: c for device in self.devices.values() for c in device.held}
        found = [self.devices[key] for key in asked.devices or [] if key in self.devices]
        told = {"requests": [self.tell(key, held.get(key)) for key in asked.requests or []],
                "devices": [{"device_id": device.id, "room": device.queue - len(device.held), **device.position} for device in found]}
        for c in [held[key] for key in asked.requests or [] if key in held]:
            if not c.passed and (c.session == asked.session if c.session else c.link is link):
                limits = [each for each in (asked.pending_lease, c.leases[0]) if each is not None]
                c.leases[0] = min(limits, default=None)
                c.until = instant(asked.pending_until) if asked.pending_until else c.until
        return told
    def tell(self, key, c):
        told = {"request_id": key, "state": "ended" if key in self.answers else "unknown", **self.facts.get(key, {})}
        last = {"steps_done": c.done} if c and c.passed else {} if c else self.answers.get(key, {})
        told.update({fact: last[fact] for fact in ("steps_done", "late_steps", "late_ms_max", "error") if fact in last})
        if c:
            told.update(state="running" if c.passed else "held", start_timestamp=stamp(c.times[0]))
        return told
    def control(self, link, c, stops_others):
        c.session = own(link, c.session)
        device = self.devices.get(c.device_id)
        reads = c.sensor and device and "sensor" in device.types    # any server may, without claiming the robot
        busy, now = self.hear(link, c.session, not reads), time.time_ns()       # so that a lease of 0 ends in time
        busy = None if stops_others else busy
        if c.request_id in self.answers:
            return {"control_response": {**self.answers[c.request_id], "timestamp": stamp(now)}}
        need(not busy or reads, busy, "busy")
        c.sent = instant(c.timestamp) if c.timestamp else -NEVER
        start = c.sent + ns(c.time_offset_to_start) if c.timestamp and c.time_offset_to_start is not None else now
        c.times = [start] + [start + offset for offset in c.offsets]
        try:
            check(c, device, now)
            if c.sensor:
                return self.respond(c, "Provide", finite(self.arm.read(device.id)))
        except Exception as fault:              # anything but a refusal comes from the hardware
            message, code = fault.args if isinstance(fault, Refused) else (str(fault), "internal")
            if code == "unsupported_control_type":
                self.rest(device, "cancelled", "default state after an unsupported control type", now, home=True)
            return self.respond(c, "Failed", error={"code": code, "message": message})
        why = "cancelled", f"stopped by {link.who}" if link.who else "cancelled by an empty script", now
        if c.steps:
            device.held.append(c)
            value = [{key: step[key] for key in STEP if key in step} for step in c.value] if c.script else c.value
            return self.respond(c, "Accepted", value, **({"content_hash": c.hash} if c.hash else {}))
        if c.times[0] > now:
            self.drop(device, [other for other in device.held if other.times[0] >= c.times[0]], *why)
        else:
            device.taken_back = max(device.taken_back, min(c.sent, now + FUTURE))
            self.rest(device, *why, home=c.home)
        return self.respond(c, "OK")
    def owns(self, link): return self.owner is not None and link.session == self.owner
    def let_in(self, link):
        """Disconnects a stranger for a new one: one that has sent no message, or else the one that has been silent for longest."""
        strangers = [other for other in self.links if not self.owns(other)]
        if len(strangers) >= STRANGERS:
            self.let_go(min(strangers, key=lambda other: (other.spoken, other.heard)))
        self.links += [link] if len(self.links) < MAX_LINKS else []
        return link in self.links
    def let_go(self, link):
        self.links = [other for other in self.links if other is not link]
        link.writer.transport.abort()
    async def watch(self):
        """Disconnects peers that take too long for their first message or, as strangers, to complete one."""
        while True:
            now = time.monotonic_ns()
            for link in list(self.links):
                if now - link.heard > FIRST if not link.spoken else not self.owns(link) and now - link.begun > BEGUN:
                    self.let_go(link)
            await asyncio.sleep(0.25)
    def invalid(self, key): return key and self.keys.invalid(*key)
    def end_invalid(self):
        """Ends what the robot holds for keys that are no longer valid, also if their connections have broken; then closes these."""
        now, owners = time.time_ns(), self.owner and self.invalid(self.key)
        for device in self.devices.values():
            others = [self.invalid(c.link.key) for c in device.held + device.left_on if not c.session]
            why = next(filter(None, [owners, *others]), None)
            if why:
                self.rest(device, "forbidden", why, now)
        if owners:
            self.owner = None
        for link in [link for link in self.links if self.invalid(link.key)]:
            log(f"the connection of {link.who} is closed: {self.invalid(link.key)}")
            self.let_go(link)
    async def watch_keys(self):
        while True:
            await asyncio.sleep(1)
            await asyncio.to_thread(self.keys.refresh)      # a slow disk must not delay steps
            self.end_invalid()
    async def converse(self, reader, writer):
        link = types.SimpleNamespace(writer=writer, session=None, heard=time.monotonic_ns(), spoken=False, begun=NEVER)
        link.who, link.roles, link.key = proven(writer.get_extra_info("peercert"))
        if not self.let_in(link):
            return writer.transport.abort()
        with contextlib.closing(writer), contextlib.suppress(OSError, EOFError, asyncio.LimitOverrunError):
            while link in self.links and not writer.is_closing():
                link.begun = NEVER
                line = await reader.readexactly(1)
                link.begun = time.monotonic_ns()
                line += await reader.readuntil(b"\n") if line != b"\n" else b""
                self.run()                      # handles actions that were due before the message
                if line.strip() and link in self.links:
                    send(link, self.take(link, line, time.time_ns()))
                self.run()                      # then actions that the message made due
                await asyncio.sleep(0)          # lets other tasks run
        self.links = [other for other in self.links if other is not link]

def own(link, session):
    """A session belongs to the peer that used its name with a proven identity; other peers' sessions of this name are different."""
    return session and (link.who, session)

def proven(certificate):
    """The peer's identity, roles and key, from its certificate; None without TLS."""
    if certificate is None:
        return None, None, None
    uris = [uri.split(":", 2)[1:] for kind, uri in certificate.get("subjectAltName", ()) if kind == "URI" and uri.count(":") > 1]
    names = [f"{kind} {urllib.parse.unquote(name)}" for kind, name in uris if kind in ("operator", "robot")]
    key = int(certificate["serialNumber"], 16), ssl.cert_time_to_seconds(certificate["notAfter"])
    return "".join(names) or "nobody", {role for kind, role in uris if kind == "role"}, key

class Keys:
    """TLS 1.3 for operators of the authorities in the identity file: a key, its certificate, and those of one or two authorities. A list
    of revoked certificates, if it has a path, is read again when it changes."""
    def __init__(self, identity, path):
        with open(identity) as file:
            self.authority = file.read().partition("-----END CERTIFICATE-----\n")[2]
        self.tls, self.path = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), path
        self.tls.minimum_version, self.tls.verify_mode, self.tls.num_tickets = ssl.TLSVersion.TLSv1_3, ssl.CERT_REQUIRED, 0
        self.tls.load_cert_chain(identity)
        self.tls.load_verify_locations(cadata=self.authority)
        self.seen, (self.number, self.revoked) = self.stamp(), self.read() if path else (0, set())
        if path:
            self.follow_authorities()
    def follow_authorities(self):
        """Trusts an authority that the file introduces, and no longer trusts one that has ended."""
        listed = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        listed.load_verify_locations(self.path)
        signed = [found for found in listed.get_ca_certs() if found["subject"] != found["issuer"]]
        if len(signed) < listed.cert_store_stats()["x509"]:     # it would be trusted without a signature
            raise SystemExit(f"{self.path}: no other authority signed a certificate in it; expected the file that `downbeat keys` wrote")
        if listed.cert_store_stats()["crl"] > 1:
            self.tls.verify_flags |= ssl.VERIFY_CRL_CHECK_CHAIN     # the whole chain: a list ends its own authority by containing it
            self.tls.load_verify_locations(self.path)
    def invalid(self, serial, expires):
        """Why a key is not valid, or None."""
        expired = "the operator's key has expired" if expires < time.time() else None
        return "the operator's key was revoked" if serial in self.revoked else expired
    def stamp(self):
        with contextlib.suppress(OSError):
            at = os.stat(self.path or "")
            return at.st_ino, at.st_size, at.st_mtime_ns, at.st_ctime_ns
    def refresh(self):
        """Uses a new list, unless it is older than the list in use, or damaged, or of another authority."""
        if self.seen == (stamp := self.stamp()):
            return
        self.seen = stamp
        try:
            number, revoked = self.read()
            need(number >= self.number, f"{self.path}: its number {number} is smaller than {self.number}, that of the list in use")
            self.number, self.revoked = number, revoked
        except Exception as fault:
            log(f"{fault}; the previous list remains in use")
    def read(self):
        """The number of the list, and the serial numbers in it (RFC 5280, section 5)."""
        with open(self.path) as file:
            lists = re.finditer("-----BEGIN X509 CRL-----([^-]*)-----END X509 CRL-----\n", file.read(1 << 23))
        pem = next((each for each in lists if self.has_signed(each[0])), None)
        need(pem, f"{self.path}: expected a list that `downbeat keys` wrote and the robot's authority signed")
        fields = der(der(der(base64.b64decode(pem[1]))[0][1])[0][1])
        entries = [content for tag, content in fields if tag == 0x30][2:]     # after the algorithm and the issuer
        extensions = [der(each) for tag, content in fields if tag == 0xA0 for _, each in der(der(content)[0][1])]
        numbers = [der(each[-1][1])[0][1] for each in extensions if each[0][1] == b"U\x1d\x14"]
        integer = lambda content: int.from_bytes(content, "big")
        return integer(b"".join(numbers)), {integer(der(each)[0][1]) for content in entries for _, each in der(content)}
    def has_signed(self, pem):
        """OpenSSL checks the signature of a list if it looks up a certificate in it: here the robot's own, in a handshake in memory."""
        judge, sent, answered = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), ssl.MemoryBIO(), ssl.MemoryBIO()
        judge.check_hostname = False
        judge.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF | 0x200000    # X509_V_FLAG_NO_CHECK_TIME: an overdue list remains in use
        with tempfile.NamedTemporaryFile("w") as file:
            file.write(self.authority + pem)
            file.flush()
            judge.load_verify_locations(file.name)
        client = judge.wrap_bio(answered, sent)
        for side in client, self.tls.wrap_bio(sent, answered, server_side=True), client:
            try:
                side.do_handshake()
                return True
            except ssl.SSLWantReadError:
                pass
            except ssl.SSLCertVerificationError as fault:
                return fault.verify_code == 23  # X509_V_ERR_CERT_REVOKED: the robot's own is on the list

def der(data, at=0):
    """The tag and the content of each element."""
    found = []
    while at < len(data):
        tag, size, at = data[at], data[at + 1], at + 2
        if size > 128:                          # then it is the size of the actual size
            size, at = int.from_bytes(data[at:at + size - 128], "big"), at + size - 128
        found.append((tag, data[at:at + size]))
        at += size
    return found

def log(text): print(text, file=sys.stderr, flush=True)

def send(link, message):
    if message and not link.writer.is_closing():
        link.writer.write(json.dumps(message, separators=(",", ":")).encode() + b"\n")
        if link.writer.transport.get_write_buffer_size() > MAX_UNREAD:
            link.writer.transport.abort()

async def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--listen", default="127.0.0.1:0", help="HOST:PORT; port 0 is any that is free")
    arguments.add_argument("--identity", help="the file that `downbeat keys robot` made; without it anyone can move the robot")
    arguments.add_argument("--revoked", help="the list that `downbeat keys revoke` wrote; read again when it changes")
    given = arguments.parse_args()
    host, _, port = given.listen.rpartition(":")
    try:
        keys = Keys(given.identity, given.revoked) if given.identity else None
    except (OSError, ValueError) as fault:
        sys.exit(str(fault))
    server = await asyncio.start_server(Robot(Arm(), keys).converse, host.strip("[]"), int(port), limit=MAX_LINE,
                                        **{"ssl": keys.tls, "ssl_handshake_timeout": FIRST / 1e9} if keys else {})
    print("listening on %s:%d" % server.sockets[0].getsockname()[:2], flush=True)
    await server.serve_forever()

if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main())
