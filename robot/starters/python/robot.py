#!/usr/bin/env python3
"""A URRCP robot to copy: put your own description into BLOCK and your own hardware into Arm.

Python 3.9 and its standard library; messages.py goes with it: python3 robot.py --listen 127.0.0.1:7000
"""
import argparse, asyncio, contextlib, itertools, math, time
from messages import IGNORED, NEVER, REQUESTS, Meant, need, parse, refusal, stamp, write

LIMITS = {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25}
SPEEDS = {"min_value": -10, "max_value": 10, "granularity": 0.1}
BLOCK = {"id": "arm-1", "name": "left arm", "type": "Industrial", "api_version": "1", "reports": True, "devices": [
    {"id": "shoulder", "name": "shoulder servo", "unit": "deg", "default_value": 0, "interpolation": "linear",
     "script_queue": 2, "available_control_types": {
         "position": LIMITS, "script": {**LIMITS, "max_number_of_steps": 1000, "control_types": ["position"]}}},
    {"id": "wheel", "name": "wheel motor", "unit": "m/s", "interpolation": "hold", "available_control_types": {
        "speed": SPEEDS, "script": {**SPEEDS, "max_number_of_steps": 1000, "control_types": ["speed"]}}},
    {"id": "camera", "name": "camera temperature", "unit": "degC",
     "available_control_types": {"sensor": {"min_value": -40, "max_value": 125, "max_delay": 20}}}]}

class Arm:
    """Your hardware. Both must return at once; an exception is answered or reported as `internal`."""
    def set(self, device, control_type, value):
        pass                    # value is a number; for a custom_N of several values, their list
    def read(self, device):
        return 42.5

MAX_LINE = 1 << 17              # bytes: room for 1000 steps; a step that falls due meanwhile waits until it is read
MAX_UNREAD = 1 << 16            # bytes: a peer that leaves more is not listened to; at 16 times that it is cut off
MAX_LINKS, KEPT = 32, 1024      # KEPT: last answers of requests that have ended; the protocol asks for 256
SAMPLE, LATE_STEP, LATE_START, SILENCE = 20_000_000, 1_000_000, 50_000_000, 5_000_000_000    # ns, as all times here
SPIN = 0.0015                   # s: so long before it is due, a step is waited for without sleeping

class Device:
    def __init__(self, spec):
        self.id, self.types, self.default = spec["id"], spec["available_control_types"], spec.get("default_value")
        self.queue, self.linear = spec.get("script_queue", 1), spec.get("interpolation") == "linear"
        self.held, self.tails = [], {}           # tails: by control type, ended commands whose lease goes on
        self.primary = next((kind for kind in ("position", "speed", "acceleration") if kind in self.types), "position")
        self.taken_back, self.where = -NEVER, {self.primary: self.default or 0}

class Robot:
    def __init__(self, arm):
        self.arm, self.links, self.open, self.ended = arm, set(), {}, {}
        self.devices = {spec["id"]: Device(spec) for spec in BLOCK["devices"]}
        self.owner, self.owner_heard, self.timer, self.count = None, 0, None, itertools.count()

    def run(self):
        """Does what is due, by time, at one instant leases before steps; returns when the next thing is due."""
        while True:
            now, due = time.time_ns(), (NEVER,)
            shift = now - time.monotonic_ns()    # leases count silence, whatever the clock is set to; never too late
            for device in self.devices.values():
                for c in device.held + list(device.tails.values()):
                    due = min(due, (c.lease_ends(shift), 0, c.start, c.end, c.number, self.run_out, device, c))
                for c in device.held:
                    at = c.start + (c.steps[c.done].offset if c.begun else 0)
                    due = min(due, (at, 1, c.start, c.end, c.number, self.go_on, device, c))
                    if c.begun and c.moves:
                        due = min(due, (c.sampled + SAMPLE, 2, c.start, c.end, c.number, self.sample, device, c))
            if due[0] > now:
                return due[0]
            due[5](*due[6:], now)

    def tick(self):
        wait = (self.run() - time.time_ns()) / 1e9 - SPIN
        if self.timer:
            self.timer.cancel()
        self.timer = asyncio.get_running_loop().call_later(min(max(wait, 0), 0.25), self.tick)

    def run_out(self, device, _, now):
        self.rest(device, "link_lost", "the server was silent for longer than stop_condition", now)

    def go_on(self, device, c, now):
        step = c.steps[c.done]
        if not c.begun and now > c.start + LATE_START:
            self.drop(device, [c], "late", "the robot was held up over the start", now)
        elif not c.begun:
            c.begun, c.sampled, c.origin = True, now, (0, step.kind, device.where.get(step.kind, 0))
            self.tell_started(device, c, now, c.moves and step.offset > 0)
        elif self.set(device, c, step.kind, step.values, now):
            self.tell_started(device, c, now, True)
            c.late += now > c.start + step.offset + LATE_STEP
            c.done, c.origin = c.done + 1, (step.offset, step.kind, step.values[0])
            if c.done == len(c.steps):
                device.held.remove(c)
                left_on = {kind for kind in {each.kind for each in c.steps} - {"position"} if device.where[kind]}
                device.tails.update({kind: c for kind in left_on if c.lease_ends(0) < NEVER})
                self.report(c, "OK", step.values[0], now, steps_done=c.done, late_steps=c.late)

    def tell_started(self, device, c, now, moves):
        if moves and not c.started:
            c.started = True
            device.tails.pop(c.steps[0].kind, None)
            self.report(c, "Started", c.steps[0].values[0], now)

    def sample(self, device, c, now):
        """Where a linear device is between two steps."""
        c.sampled, (since, was, origin), step = now, c.origin, c.steps[c.done]
        if step.kind == was and not was.startswith("custom_") and step.offset > since:
            part = min(max((now - c.start - since) / (step.offset - since), 0), 1)
            self.set(device, c, was, [origin + (step.values[0] - origin) * part], now)

    def set(self, device, c, kind, found, now):
        try:
            device.where[kind] = found[0] if len(found) == 1 else found
            self.arm.set(device.id, kind, device.where[kind])
            if c:
                device.tails.pop(kind, None)
            return True
        except Exception as error:
            self.drop(device, [c] if c else [], "internal", str(error), now)

    def drop(self, device, commands, code, message, now):
        for c in sorted(commands, key=lambda c: (c.start, c.number)):
            if c in device.held:
                device.held.remove(c)
            self.report(c, "Failed", None, now, steps_done=c.done, error={"code": code, "message": message})

    def rest(self, device, code, message, now, hold=False):
        """Ends everything; then the default state, or a stop in place. With an `acceleration`, slow down by it here."""
        for c in [c for c in device.held if c.begun and c.moves]:
            self.sample(device, c, now)
        ended, device.tails = device.held + list(set(device.tails.values()) if code == "link_lost" else []), {}
        for kind in {"speed", "acceleration"} & set(device.types):
            self.set(device, None, kind, [0], now)
        if device.default is not None and not hold:
            self.set(device, None, device.primary, [device.default], now)
        self.drop(device, ended, code, message, now)

    def response(self, c, status, value, keep=None, **more):
        """`keep` is the dictionary in which the answer stays for whoever asks again."""
        body = {"timestamp": stamp(time.time_ns()), "device_id": c.device_id, "status": status, "status_value": value,
                **({} if c.request_id is None else {"request_id": c.request_id}), **more}
        if c.request_id is not None and keep is not None:
            self.open.pop(c.request_id, None)
            keep[c.request_id] = body
            if len(self.ended) > KEPT:
                del self.ended[next(iter(self.ended))]
        return {"control_response": body}

    def report(self, c, status, value, now, **more):
        more["event_timestamp"], keep = stamp(now), self.open if status == "Started" else self.ended
        message = self.response(c, status, value, keep, **more)
        links = [link for link in self.links if c.party in (link, link.session)]
        if links and BLOCK["reports"]:
            max(links, key=lambda link: link.heard).send(message)

    def take(self, link, line, received):
        kind = body = None
        try:
            need(len(line) <= MAX_LINE, "the line is too long")
            message, faults = parse(line)
            need(isinstance(message, dict) and len(message) == 1, "a message is an object with one key")
            (kind, body), = message.items()
            need(not faults, "; ".join(faults[:2]))
            if kind in IGNORED:
                return
            need(kind in REQUESTS, "no such message")
            found = REQUESTS[kind](body, link)
        except ValueError as fault:
            error = {"code": "malformed", "message": str(fault)[:200]}
            try:
                return link.send(self.response(Meant(kind, body), "Failed", None, error=error))
            except ValueError:
                found = {}      # no device can be made out
        else:
            if kind == "control_request":
                return self.control(link, found, time.monotonic_ns(), time.time_ns())   # in this order, see run
            busy = self.hear(link, found.get("session"), True)
            if kind == "initialization_request":
                return link.send({"initialization_block": BLOCK})
            error = {"code": "busy", "message": busy} if busy and found["session"] else None
        answer = {"receive_timestamp": stamp(received), "timestamp": stamp(max(received, time.time_ns()))}
        answer.update({"status": "Failed", "error": error} if error else {"status": "OK"})
        answer.update({"originate_timestamp": body["timestamp"]} if found.get("timestamp") is not None else {})
        link.send({"availability_response": answer})

    def hear(self, link, session, claims):
        """Renews leases and settles whose the robot is; returns why it is not this session's."""
        now, devices = time.monotonic_ns(), self.devices.values()
        if not any(device.held or device.tails for device in devices) and (
                now - self.owner_heard >= SILENCE or all(other.session != self.owner for other in self.links)):
            self.owner = None
        self.owner = self.owner or (session if claims else None)
        if session and session == self.owner:
            link.session = session
        link.heard, parties = now, (link, session or link.session)
        if self.owner in parties:
            self.owner_heard = now
        for c in [c for device in devices for c in device.held + list(device.tails.values()) if c.party in parties]:
            c.heard = now
        if self.owner not in (None, session):
            return f"`{BLOCK['id']}` belongs to session `{self.owner}` until that ends"

    def control(self, link, c, heard, now):
        device, last = self.devices.get(c.device_id), self.open.get(c.request_id) or self.ended.get(c.request_id)
        busy = self.hear(link, c.session, c.kind != "sensor")
        if last:
            return link.send({"control_response": {**last, "timestamp": stamp(now)}})
        if busy and c.kind != "sensor":
            return link.send(self.response(c, "Failed", None, error={"code": "busy", "message": busy}))
        c.start = now if c.start is None else c.start
        c.end, c.heard = c.start + (c.steps[-1].offset if c.steps else 0), heard
        code, message = refusal(c, device, now) or (None, None)
        if code == "unsupported_control_type":
            self.rest(device, "cancelled", "default state after an unsupported control type", now)
        if code:
            link.send(self.response(c, "Failed", None, self.ended, error={"code": code, "message": message}))
        elif c.kind == "sensor":
            try:
                value, status, error = self.arm.read(device.id), "Provide", {}
                need(math.isfinite(value), "no reading")
            except Exception as fault:
                value, status, error = None, "Failed", {"error": {"code": "internal", "message": str(fault)}}
            link.send(self.response(c, status, value, self.ended, **error))
        elif c.steps:
            c.number, c.moves = next(self.count), device.linear and c.kind == "script"
            hashed = {"content_hash": c.content_hash} if c.content_hash else {}
            link.send(self.response(c, "Accepted", c.value, self.open, **hashed))
            device.held.append(c)
            self.tick()
        else:
            why = "cancelled", "cancelled by an empty script", now
            if c.start > now:
                self.drop(device, [other for other in device.held if other.start >= c.start], *why)
            else:
                device.taken_back = max(device.taken_back, -NEVER if c.sent is None else c.sent)
                self.rest(device, *why, hold=c.hold)
            link.send(self.response(c, "OK", None, self.ended))

class Link(asyncio.Protocol):
    """A connection. While lines are left over from one reading, or answers are left unread, no more is read."""
    def __init__(self, robot):
        self.robot, self.session, self.heard = robot, None, 0
        self.buffer, self.searched, self.skipping, self.full = bytearray(), 0, False, False

    def connection_made(self, transport):
        self.transport = transport
        transport.set_write_buffer_limits(MAX_UNREAD)
        if len(self.robot.links) >= MAX_LINKS:
            return transport.abort()
        self.robot.links.add(self)

    def connection_lost(self, _):
        self.robot.links.discard(self)

    def data_received(self, data):
        self.buffer += data
        self.transport.pause_reading()
        self.pump(time.time_ns())

    def pump(self, received):
        for _ in range(50):                      # then it is the turn of the others
            if self.full or self.transport.is_closing():
                return
            end = self.buffer.find(b"\n", self.searched)
            if end < 0:
                break
            line, self.searched = bytes(self.buffer[:end]), 0
            del self.buffer[:end + 1]
            self.robot.run()                     # what was due before the message comes first
            if self.skipping:
                self.skipping = False
            elif line.strip():
                self.robot.take(self, line, received)
        else:
            return asyncio.get_running_loop().call_soon(self.pump, received)
        if len(self.buffer) > MAX_LINE:
            if not self.skipping:
                self.robot.take(self, self.buffer, received)
            self.skipping, self.buffer = True, bytearray()
        self.searched = len(self.buffer)
        self.transport.resume_reading()

    def pause_writing(self):
        self.full = True

    def resume_writing(self):
        self.full = False
        asyncio.get_running_loop().call_soon(self.pump, time.time_ns())

    def send(self, message):
        self.transport.write(write(message).encode() + b"\n")
        if self.transport.get_write_buffer_size() > 16 * MAX_UNREAD:
            self.transport.abort()

async def serve(host, port):
    robot = Robot(Arm())
    server = await asyncio.get_running_loop().create_server(lambda: Link(robot), host, port)
    print("listening on %s:%d" % server.sockets[0].getsockname()[:2], flush=True)
    robot.tick()
    await server.serve_forever()

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="a URRCP robot")
    parser.add_argument("--listen", default="127.0.0.1:0", metavar="HOST:PORT", help="port 0: any that is free")
    host, _, port = parser.parse_args().listen.rpartition(":")
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(host.strip("[]"), int(port)))
