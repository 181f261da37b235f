"""Mistakes that implementers of a robot make, as edits of `robot/starters/python/robot.py`. Each edit replaces a text that occurs once.

A mistake names the requirements of `downbeat conformance` of which at least one has to fail. `BASES` are correct robots: the example robot, and
variants of it that declare something else.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Base:
    """A correct robot: edits of the example robot, and options of `downbeat conformance`."""
    edits: tuple = ()
    device: str | None = None
    custom: str | None = None


@dataclass(frozen=True)
class Mistake:
    about: str
    title: str
    by: tuple
    edits: tuple
    base: str = "arm"
    device: str | None = None


NARROW = ('"script": {**ANGLES, "max_number_of_steps": 1000}',
          '"script": {**ANGLES, "min_value": 10, "max_value": 80, "granularity": 5, "max_number_of_steps": 1000}')
# The arm accepts custom_1 with one value, from 0 to 1, in place of positions.
CUSTOM = (('"default_value": 0, "script_queue": 2,\n     "available_control_types": {"position": ANGLES, "script": {**ANGLES, "max_number_of_steps": 1000}}}',
           '"script_queue": 2,\n     "available_control_types": {"custom_1": {"min_value": 0, "max_value": 1, "granularity": 0.25}}}'),
          ('    {"id": "wheel", "name": "wheel motor", "unit": "m/s", "script_queue": 1,\n     "available_control_types": {"speed": SPEEDS, "script": {**SPEEDS, "max_number_of_steps": 1000}}},\n', ""))

BASES = {
    "arm": Base(),
    "wheel": Base(device="wheel"),
    "narrow": Base(edits=(NARROW,)),
    "custom": Base(edits=CUSTOM, custom="0.5"),
}

# Places of the example robot that several mistakes edit.
ALL_DEVICES = ("        self.id, self.types, self.default = spec", "        ALL.append(self)\n        self.id, self.types, self.default = spec")
LIST_OF_ALL = ("class Device:\n", "ALL = []\nclass Device:\n")
REST = "            self.rest(device, *why, home=c.home)\n"
ECHO = '            body["request_id"] = c.request_id\n'
STRING = 'def string(value): return isinstance(value, str) and len(value) <= 256 and not re.search("[\\ud800-\\udfff]", value)'
FRACTION = '    return int(at) * 10**9 + int((match[2] or "").ljust(9, "0"))'
PATTERN = r"""r"([0-9-]{10}T[0-9:]{8})(?:\.([0-9]{1,9}))?(Z|[+-][0-9]{2}:[0-9]{2})", value.upper())"""
START = "        start = c.sent + ns(c.time_offset_to_start) if c.timestamp and c.time_offset_to_start is not None else now\n"
NS = "def ns(milliseconds): return NEVER if milliseconds is None else round(milliseconds * MS)"
KINDS = "    kinds = device.types[c.control_type], device.types[device.drive]\n"
HEARD = "        link.heard, link.spoken, link.session = now, True, session or link.session\n"
LEASES = '        self.leases = phases(self.stop_condition) + [phases(each)[1] for each in leases]    # pending, running, then after each step\n'
LEASE_OF = "                    ends = c.lease_ends(shift + (self.owner_heard if c.session else c.link.heard))\n"
BODY = '                **more, **({"event_timestamp": stamp(event)} if event else {})}\n'
ROOM = '"room": device.queue - len(device.held)'
TAKEN = "            device.taken_back = max(device.taken_back, min(c.sent, now + FUTURE))\n"
BACK = '    need(c.timestamp is None or c.sent > device.taken_back,'
DROP_FROM = "            self.drop(device, [other for other in device.held if other.times[0] >= c.times[0]], *why)\n        else:"
LOSE = "        if c.passed:\n            return self.rest(device, *why)\n"
LOSE_PENDING = "        self.drop(device, [other for other in device.held if not other.passed and other.times[0] >= c.times[0]], *why)\n"
DECODE = "message = JSON.decode(line := line.decode())"
LINE = "                if line.strip() and link in self.links:\n"
NO_TYPES = '    need(c.control_type in device.types or c.script and not c.steps, "not one of its types", "unsupported_control_type")\n    if not c.steps:\n        return\n'
API = '"api_version": "1", "reports": True,'
CLOSED = "        self.links = [other for other in self.links if other is not link]\n\ndef own"
OK_ENDS = '            self.respond(c, "OK", value, now, steps_done=c.done, late_steps=c.late, **latest)'
IGNORED = "            if name in OF_ROBOTS:\n                return None\n"
IN_LINE = "                line = await reader.readexactly(1)\n"


def m(about, title, by, *edits, **more):
    return Mistake(about, title, tuple(by.split()), edits, **more)


MISTAKES = [
    # Two devices at once.
    m("devices", "a stop ends the commands of all devices", "devices-stop", (REST, "            for device in self.devices.values():\n                self.rest(device, *why, home=c.home)\n")),
    m("devices", "a stop drops the waiting commands of all devices", "devices-stop", (REST, REST + "            for other in self.devices.values():\n                self.drop(other, [each for each in other.held if not each.passed], *why)\n")),
    m("devices", "a stop with a start cancels on all devices", "devices-stop", (DROP_FROM, "            for device in self.devices.values():\n                self.drop(device, [other for other in device.held if other.times[0] >= c.times[0]], *why)\n        else:")),
    m("devices", "the end of a running lease ends all devices", "devices-lease", (LOSE, "        if c.passed:\n            for each in self.devices.values():\n                self.rest(each, *why)\n            return\n")),
    m("devices", "the end of a pending lease drops the waiting commands of all devices", "devices-lease", (LOSE_PENDING, "        for device in self.devices.values():\n            self.drop(device, [other for other in device.held if not other.passed and other.times[0] >= c.times[0]], *why)\n")),
    m("devices", "an unsupported control type sends all devices to their default state", "devices-unsupported", ('                self.rest(device, "cancelled", "default state', '                for device in self.devices.values(): self.rest(device, "cancelled", "default state')),
    m("devices", "commands of two devices overlap", "devices-at-once", LIST_OF_ALL, ALL_DEVICES, ("    for other in device.held:\n", "    for other in [each for one in ALL for each in one.held]:\n")),
    m("devices", "the queue is that of the robot", "devices-at-once", LIST_OF_ALL, ALL_DEVICES, ("    need(len(device.held) < device.queue,", "    need(sum(len(one.held) for one in ALL) < device.queue,")),
    m("devices", "only one device may run at a time", "devices-at-once", LIST_OF_ALL, ALL_DEVICES, ("    need(len(device.held) < device.queue,", "    need(not any(one.held for one in ALL if one is not device) and len(device.held) < device.queue,")),
    m("devices", "a stop takes back requests for all devices", "devices-take-back", (TAKEN, "            for each in self.devices.values():\n                each.taken_back = max(each.taken_back, min(c.sent, now + FUTURE))\n")),
    m("devices", "request ids are kept for each device", "devices-request-id", ("        if c.request_id in self.answers:\n", '        if c.request_id in self.answers and self.answers[c.request_id]["device_id"] == c.device_id:\n')),
    m("devices", "the room is that of the robot", "devices-at-once", (ROOM, '"room": device.queue - sum(len(one.held) for one in self.devices.values())')),
    m("devices", "home sends all devices home", "devices-stop", (REST, "            for one in self.devices.values() if c.home else [device]:\n                self.rest(one, *why, home=c.home)\n")),
    m("devices", "request ids are kept for each connection", "repeated-elsewhere", ("        if c.request_id in self.answers:\n", "        if c.request_id in self.answers and link.__dict__.setdefault('asked', set()) & {c.request_id} or link.__dict__.setdefault('asked', set()).add(c.request_id):\n")),
    # Ids and strings.
    m("strings", "request ids are answered in small letters", "odd-ids", (ECHO, '            body["request_id"] = c.request_id.lower()\n')),
    m("strings", "request ids are answered without spaces at their ends", "odd-ids", (ECHO, '            body["request_id"] = c.request_id.strip()\n')),
    m("strings", "request ids are answered in composed form", "odd-ids", (ECHO, '            import unicodedata\n            body["request_id"] = unicodedata.normalize("NFC", c.request_id)\n')),
    m("strings", "request ids lose letters beyond 16 bits", "odd-ids", (ECHO, '            body["request_id"] = "".join(each if ord(each) < 65536 else "\\ufffd" for each in c.request_id)\n')),
    m("strings", "request ids end at the first NUL", "odd-ids", (ECHO, '            body["request_id"] = c.request_id.split("\\0")[0]\n')),
    m("strings", "backslashes in request ids are lost", "odd-ids", (ECHO, '            body["request_id"] = c.request_id.replace("\\\\", "")\n')),
    m("strings", "an empty request id is not answered", "odd-ids", ("        if c.request_id is not None:\n", "        if c.request_id:\n")),
    m("strings", "request ids that differ in case are the same", "similar-ids", ("        self.link, self.sensor, self.script = link,", "        self.request_id = self.request_id and self.request_id.lower()\n        self.link, self.sensor, self.script = link,"), (ECHO, '            body["request_id"] = body.get("request_id", c.request_id)\n')),
    m("strings", "request ids that differ in composition are the same", "similar-ids", ("        self.link, self.sensor, self.script = link,", "        import unicodedata\n        self.request_id = self.request_id and unicodedata.normalize('NFC', self.request_id)\n        self.link, self.sensor, self.script = link,")),
    m("strings", "request ids count up to 32 characters", "similar-ids", ("        if c.request_id in self.answers:\n", "        c.request_id = c.request_id and next((key for key in self.answers if key[:32] == c.request_id[:32]), c.request_id)\n        if c.request_id in self.answers:\n")),
    m("strings", "256 bytes instead of characters", "long-strings request-id", (STRING, STRING.replace("len(value)", "len(value.encode('utf-8', 'replace'))"))),
    m("strings", "256 units of UTF-16 instead of characters", "long-strings", (STRING, STRING.replace("len(value)", "len(value.encode('utf-16-le', 'surrogatepass')) // 2"))),
    m("strings", "256 characters in composed form", "long-strings", (STRING, "import unicodedata\n" + STRING.replace("len(value)", "len(unicodedata.normalize('NFC', value))"))),
    m("strings", "at most 255 characters", "long-strings", (STRING, STRING.replace("<= 256", "< 256"))),
    m("strings", "at most 64 characters", "long-strings request-id", (STRING, STRING.replace("<= 256", "<= 64"))),
    m("strings", "strings of any length", "long-strings", (STRING, STRING.replace("len(value) <= 256", "True"))),
    m("strings", "half a surrogate pair is a string", "vectors", (STRING, "def string(value): return isinstance(value, str) and len(value) <= 256")),
    m("strings", "device ids in any case", "similar-devices", ("        device = self.devices.get(c.device_id)\n", "        device = next((each for each in self.devices.values() if each.id.lower() == c.device_id.lower()), None)\n")),
    m("strings", "device ids with spaces at their ends", "similar-devices", ("        device = self.devices.get(c.device_id)\n", "        device = self.devices.get(c.device_id.strip())\n")),
    m("strings", "the beginning of a device id is enough", "similar-devices", ("        device = self.devices.get(c.device_id)\n", "        device = next((each for each in self.devices.values() if each.id.startswith(c.device_id) or c.device_id.startswith(each.id)), None)\n")),
    m("strings", "session names in any case are the same", "similar-sessions", ("def own(link, session):\n", "def own(link, session):\n    session = session and session.lower()\n")),
    m("strings", "session names with spaces at their ends are the same", "similar-sessions", ("def own(link, session):\n", "def own(link, session):\n    session = session and session.strip()\n")),
    m("strings", "an empty session is a session", "vectors", ("def ident(value): return string(value) and value != \"\"", "def ident(value): return string(value)")),
    # Lines.
    m("lines", "\\r\\n does not end a line", "line-endings", (DECODE, 'need(not line.endswith(b"\\r\\n"), "stray carriage return")\n            ' + DECODE)),
    m("lines", "a line of \\r\\n is malformed", "line-endings empty-lines", (LINE, '                if line.strip(b" \\n") and link in self.links:\n')),
    m("lines", "a line of spaces is malformed", "line-endings empty-lines", (LINE, '                if line.strip(b"\\r\\n") and link in self.links:\n')),
    m("lines", "spaces around a message are malformed", "line-endings", (DECODE, 'need(line.startswith(b"{") and line.rstrip(b"\\r\\n").endswith(b"}"), "no message")\n            ' + DECODE)),
    m("lines", "escapes of characters are kept as they are", "odd-ids", (DECODE, 'line = line.replace(b"\\\\u", b"\\\\\\\\u")\n            ' + DECODE)),
    m("lines", "a byte order mark is skipped", "vectors", (DECODE, 'message = JSON.decode(line := line.decode("utf-8-sig"))')),
    m("lines", "bytes that are not UTF-8 are replaced", "not-utf8 vectors", (DECODE, 'message = JSON.decode(line := line.decode("utf-8", "replace"))')),
    m("lines", "the last of two equal keys wins", "duplicate-keys vectors", ('    need(len(dict(pairs)) == len(pairs), "duplicate key in an object")\n', "")),
    m("lines", "two equal keys of a step are accepted", "vectors", ('    need(len(dict(pairs)) == len(pairs), "duplicate key in an object")\n', '    need(len(dict(pairs)) == len(pairs) or "device_id" not in dict(pairs), "duplicate key in an object")\n')),
    m("lines", "an object with two messages is accepted", "vectors", ('            need(isinstance(message, dict) and len(message) == 1, "a message is an object with one key")\n            (name, body), = message.items()\n', '            need(isinstance(message, dict) and message, "a message is an object with one key")\n            (name, body), *_ = message.items()\n')),
    m("lines", "an unknown message ends the connection", "unknown-message", ('            need(name in REQUESTS, "no such message")\n', '            if name not in REQUESTS:\n                link.writer.transport.abort()\n            need(name in REQUESTS, "no such message")\n')),
    m("lines", "null in an optional key is malformed", "null-keys", ('            need(key not in required if body.get(key) is None else check(body[key])', '            need(key not in required if key not in body else body[key] is not None and check(body[key])')),
    m("lines", "numbers in quotes are numbers", "vectors wrong-type", ("def number(value): return type(value) in (int, float)", "def number(value): return type(value) in (int, float) or isinstance(value, str) and re.fullmatch('[0-9.]+', value)"), ("        value = step.control_value\n", "        value = float(step.control_value)\n"), ("        value = c.steps[c.done].control_value\n", "        value = float(c.steps[c.done].control_value)\n")),
    m("lines", "true is a number", "vectors wrong-type", ("def number(value): return type(value) in (int, float)", "def number(value): return isinstance(value, (int, float))")),
    m("lines", "only whole milliseconds", "fractions", ("def period(value): return number(value) and 0 <= value <= 1e11", "def period(value): return type(value) is int and 0 <= value <= 1e11")),
    m("lines", "numbers with an exponent are malformed", "number-forms", ("def finite(digits):\n", "def finite(digits):\n    need('e' not in str(digits).lower(), 'no number')\n")),
    m("lines", "1.0 is not the number 1", "number-forms", ("    return int(value) if value.is_integer() and abs(value) < 1e16 else value\n", "    return value if isinstance(digits, str) and '.' in digits else int(value)\n"), ("def period(value): return number(value) and 0 <= value <= 1e11", "def period(value): return number(value) and 0 <= value <= 1e11 and (type(value) is int or not value.is_integer())")),
    m("lines", "a second value of a position is ignored", "two-values", ('        need(not step.further, "one value is enough")\n', "")),
    m("lines", "control_value_2 of a script is ignored", "two-values vectors", ('isinstance(self.value, list) and not self.further, "a script', 'isinstance(self.value, list), "a script')),
    m("lines", "keys in another order are malformed", "number-forms", ("        need(isinstance(body, dict), \"not an object\")\n", "        need(isinstance(body, dict), \"not an object\")\n        need('control_type' not in body or 'control_value' not in body or list(body).index('control_type') < list(body).index('control_value'), 'order')\n")),
    m("lines", "a line in three parts is three lines", "half-line", (IN_LINE, IN_LINE + "                await asyncio.sleep(0.02)\n                if b'\\n' not in bytes(reader._buffer):\n                    line, _ = b'x\\n', reader._buffer.clear()\n                    send(link, self.take(link, line, time.time_ns()))\n                    continue\n")),
    # Time.
    m("time", ".9 is nine nanoseconds", "timestamp-forms", (FRACTION, '    return int(at) * 10**9 + int(match[2] or 0)')),
    m("time", "a timestamp needs nine digits", "timestamp-forms", (PATTERN, PATTERN.replace("{1,9}))?", "{9}))"))),
    m("time", "a timestamp without fraction is malformed", "timestamp-forms", (PATTERN, PATTERN.replace("{1,9}))?", "{1,9}))"))),
    m("time", "more than six digits are malformed", "timestamp-forms availability", (PATTERN, PATTERN.replace("{1,9}", "{1,6}"))),
    m("time", "times are cut to milliseconds", "inquiry-held", (FRACTION, FRACTION + " // 10**6 * 10**6")),
    m("time", "the offset from UTC is ignored", "timestamp-forms", ('match[3].replace("Z", "+00:00")', '"+00:00"')),
    m("time", "the offset from UTC has the wrong sign", "timestamp-forms", ('match[3].replace("Z", "+00:00")', 'match[3].replace("Z", "+00:00").translate({43: "-", 45: "+"})')),
    m("time", "the lease counts from the timestamp", "old-timestamp", (LEASE_OF, "                    ends = c.lease_ends(min(c.sent if c.timestamp else NEVER, shift + (self.owner_heard if c.session else c.link.heard)))\n")),
    m("time", "an old timestamp is late", "old-timestamp", ('    need(c.times[0] >= now, "the start has passed", "late")\n', '    need(c.times[0] >= now and (not c.timestamp or c.sent > now - 1000 * MS), "the start has passed", "late")\n')),
    m("time", "the delay counts from receipt", "deferred-start old-timestamp", (START, "        start = now + ns(c.time_offset_to_start) if c.timestamp and c.time_offset_to_start is not None else now\n")),
    m("time", "offsets have 31 bits", "large-offsets", (START, START.replace("ns(c.time_offset_to_start)", "ns((int(c.time_offset_to_start) + 2**31) % 2**32 - 2**31)"))),
    m("time", "offsets have 32 bits", "large-offsets", (START, START.replace("ns(c.time_offset_to_start)", "ns(c.time_offset_to_start % 2**32)"))),
    m("time", "offsets end at a day", "large-offsets", (START, START.replace("ns(c.time_offset_to_start)", "ns(min(c.time_offset_to_start, 86_400_000))"))),
    m("time", "offsets are floats of 32 bits", "large-offsets", (START, "        import struct\n" + START.replace("ns(c.time_offset_to_start)", "ns(struct.unpack('f', struct.pack('f', c.time_offset_to_start))[0])"))),
    m("time", "an offset above a day is malformed", "large-offsets", ("def period(value): return number(value) and 0 <= value <= 1e11", "def period(value): return number(value) and 0 <= value <= 86_400_000")),
    m("time", "leases have 31 bits", "large-lease", (LEASES, LEASES + "        self.leases = [each and (int(each) + 2**31) % 2**32 - 2**31 for each in self.leases]\n")),
    m("time", "leases have 32 bits", "large-lease", (LEASES, LEASES + "        self.leases = [each and each % 2**32 for each in self.leases]\n")),
    m("time", "leases have 16 bits", "large-lease", (LEASES, LEASES + "        self.leases = [each and each % 2**16 for each in self.leases]\n")),
    m("time", "steps count from the previous step", "script-timing", ("        c.times = [start] + [start + offset for offset in c.offsets]\n", "        c.times = [start] + [start + sum(c.offsets[:n + 1]) for n in range(len(c.offsets))]\n")),
    m("time", "the first step is due at the start", "script-start", ("        self.offsets = [ns(step.time_offset_to_start) for step in self.steps]\n", "        self.offsets = [ns(step.time_offset_to_start) for step in self.steps]\n        self.offsets[:1] = [0] * len(self.offsets[:1])\n")),
    m("time", "a late script starts with its remaining steps", "late-by-little", ('    need(c.times[0] >= now, "the start has passed", "late")\n', '    need(c.times[-1] >= now, "the start has passed", "late")\n')),
    m("time", "two steps at one instant are malformed", "steps-at-once", ("        need(self.offsets == sorted(self.offsets),", "        need(self.offsets == sorted(set(self.offsets)),")),
    m("time", "the robot's own clock is not in UTC", "clock", ("def stamp(at): return", "def stamp(at): at += 7200 * 10**9; return")),
    # Limits of scripts.
    m("limits", "a script has the limits of its control type", "script-narrower", (KINDS, "    kinds = device.types[device.drive], device.types[device.drive]\n"), ('kinds[0].get("max_number_of_steps", 1)', 'device.types[c.control_type].get("max_number_of_steps", 1)'), base="narrow"),
    m("limits", "a single value has the limits of scripts", "range", (KINDS, KINDS + '    kinds = *kinds, device.types.get("script", kinds[0])\n'), base="narrow"),
    m("limits", "only the first step is compared with the limits", "script-range", ("    for step in c.steps:\n        need(step.control_type", "    for step in c.steps[:1]:\n        need(step.control_type")),
    m("limits", "only the granularity of the control type applies", "script-narrower", ("        for n in [value / its[\"granularity\"] for its in kinds]:\n", "        for n in [value / its[\"granularity\"] for its in kinds[1:]]:\n"), base="narrow"),
    m("limits", "values are rounded to the granularity", "granularity", ("            need(abs(n - round(n)) < 1e-6,", "            need(True,")),
    m("limits", "multiples are counted from the smallest value", "range", ('value / its["granularity"] for its', '(value - its["min_value"]) / its["granularity"] for its'), ('ANGLES = {"min_value": 0,', 'ANGLES = {"min_value": 0.25,'), ('"unit": "deg", "default_value": 0,', '"unit": "deg", "default_value": 1,')),
    m("limits", "the remainder is compared with zero", "range status-value granularity-decimal", ("            need(abs(n - round(n)) < 1e-6,", "            need(n == int(n),"), base="wheel"),
    m("limits", "the largest value is refused", "range", ('its["min_value"] <= value <= its["max_value"]', 'its["min_value"] <= value < its["max_value"]')),
    m("limits", "a value beyond the limits is set to the limit", "range", ('        need(all(its["min_value"] <= value <= its["max_value"] for its in kinds), "beyond its limits", "out_of_range")\n', "")),
    # Leases.
    m("leases", "the lease of the newest command applies to all, shorter", "lease-each", ("            device.held.append(c)\n", "            device.held.append(c)\n            for each in device.held:\n                each.leases = [c.leases[1]] * len(each.leases)\n")),
    m("leases", "the longest lease applies to all", "lease-each", (LEASE_OF, "                    ends = max(one.lease_ends(shift + (self.owner_heard if one.session else one.link.heard)) for one in device.held or [c])\n")),
    m("leases", "the shortest lease applies to all", "lease-each lease-queued", (LEASE_OF, "                    ends = min(one.lease_ends(shift + (self.owner_heard if one.session else one.link.heard)) for one in device.held or [c])\n")),
    m("leases", "a lease of 0 is none", "lease-zero", ("def ns(milliseconds): return NEVER if milliseconds is None", "def ns(milliseconds): return NEVER if not milliseconds"), ("        self.offsets = [ns(step.time_offset_to_start) for", "        self.offsets = [round(step.time_offset_to_start * MS) for"), (START, START.replace("ns(c.time_offset_to_start)", "round(c.time_offset_to_start * MS)"))),
    m("leases", "a pair without running has the pending limit for both", "lease-pair lease-half-pair", ('return [value.get("pending"), value.get("running")]', 'return [value.get("pending"), value.get("running") or value.get("pending")]')),
    m("leases", "a pair without pending has the running limit for both", "lease-half-pair", ('return [value.get("pending"), value.get("running")]', 'return [value.get("pending", value.get("running")), value.get("running")]')),
    m("leases", "the pending limit is the running one", "lease-half-pair lease-pair", (LEASES, LEASES.replace("phases(self.stop_condition) +", "phases(self.stop_condition)[::-1] +"))),
    m("leases", "only requests for control renew the lease", "lease-renewal", (HEARD, HEARD.replace("= now, True", "= now if claims and session else link.heard, True")), ("        reads = c.sensor and", "        link.heard = time.monotonic_ns()\n        reads = c.sensor and")),
    m("leases", "an initialization request does not renew the lease", "lease-renewal-each", ('            busy = self.hear(link, getattr(request, "session", None), name != "inquiry")\n            if name == "initialization_request":\n                return {"initialization_block": BLOCK}\n', '            if name == "initialization_request":\n                return {"initialization_block": BLOCK}\n            busy = self.hear(link, getattr(request, "session", None), name != "inquiry")\n')),
    m("leases", "a refused request does not renew the lease", "lease-renewal-each", ("        try:\n            check(c, device, now)\n", "        try:\n            before = link.heard_before\n            check(c, device, now)\n"), ('            message, code = fault.args if isinstance(fault, Refused) else (str(fault), "internal")\n            if code', '            link.heard = before\n            message, code = fault.args if isinstance(fault, Refused) else (str(fault), "internal")\n            if code'), (HEARD, "        link.heard_before = link.heard\n" + HEARD)),
    m("leases", "messages of robots renew the lease", "lease-ignored", (IGNORED, "            if name in OF_ROBOTS:\n                self.hear(link, None, False)\n                return None\n")),
    m("leases", "unknown messages renew the lease", "lease-ignored", ('            need(name in REQUESTS, "no such message")\n', '            if name not in REQUESTS:\n                self.hear(link, None, False)\n            need(name in REQUESTS, "no such message")\n')),
    m("leases", "malformed requests renew the lease", "lease-noise lease-ignored", ("        except (ValueError, RecursionError) as fault:\n", "        except (ValueError, RecursionError) as fault:\n            self.hear(link, None, False)\n")),
    m("leases", "the end of a running lease keeps the waiting commands", "lease-running-all", (LOSE, "        if c.passed:\n            return self.drop(device, [c], *why)\n")),
    m("leases", "the end of a pending lease ends only its command", "lease-pending-later", (LOSE_PENDING, "        self.drop(device, [c], *why)\n")),
    m("leases", "the end of a pending lease ends all waiting commands", "lease-pending-later", (LOSE_PENDING, "        self.drop(device, [other for other in device.held if not other.passed], *why)\n")),
    m("leases", "the end of a pending lease ends the running script", "lease-queued", (LOSE, "        if True:\n            return self.rest(device, *why)\n")),
    m("leases", "a lost command reports no steps", "failed-report", ('            self.respond(c, "Failed", None, now, steps_done=c.done, error=', '            self.respond(c, "Failed", None, now, steps_done=0, error=')),
    m("leases", "a lost command reports without steps_done", "failed-report", ('            self.respond(c, "Failed", None, now, steps_done=c.done, error=', '            self.respond(c, "Failed", None, now, error=')),
    m("leases", "a lost command reports without its time", "failed-report", (BODY, '                **more, **({"event_timestamp": stamp(event)} if event and status != "Failed" else {})}\n')),
    m("leases", "a closed connection ends its commands", "stays-held", (CLOSED, CLOSED.replace("\ndef own", '        for device in self.devices.values():\n            self.drop(device, [c for c in device.held if c.link is link], "link_lost", "the connection is closed", time.time_ns())\n\ndef own'))),
    m("leases", "a closed connection ends all commands as cancelled", "stays-held", (CLOSED, CLOSED.replace("\ndef own", '        for device in self.devices.values():\n            self.drop(device, device.held, "cancelled", "the connection is closed", time.time_ns())\n\ndef own'))),
    m("leases", "a new connection ends the commands of the last one", "stays-held", ("        self.links += [link] if len(self.links) < MAX_LINKS else []\n", "        for device in self.devices.values():\n            self.drop(device, [c for c in device.held if c.link not in self.links], 'cancelled', 'new connection', time.time_ns())\n        self.links += [link] if len(self.links) < MAX_LINKS else []\n")),
    m("leases", "a speed that continues has no lease", "lease-left-on", ("            device.left_on = [c] if device.still not in (None, value) and c.leases[-1] is not None else []\n", "            device.left_on = []\n"), base="wheel"),
    # Answers and reports.
    m("answers", "OK to a stop before its reports", "stop-after-reports", (REST, "            asyncio.get_running_loop().call_later(0.02, lambda: self.rest(device, *why, home=c.home))\n")),
    m("answers", "OK to a stop before the report of one of two commands", "stop-after-reports", ("        for c in sorted(commands, key=lambda c: c.times):\n            self.respond(", "        for c in sorted(commands, key=lambda c: c.times)[:1]:\n            self.respond("), ("            self.rest(device, *why, home=c.home)\n        return self.respond(c, \"OK\")", "            rest_of = sorted(device.held, key=lambda c: c.times)[1:]\n            self.rest(device, *why, home=c.home)\n            asyncio.get_running_loop().call_later(0.02, lambda: [self.drop(device, [each], *why) for each in rest_of])\n        return self.respond(c, \"OK\")")),
    m("answers", "a failed command reports its value", "failed-report", ('            self.respond(c, "Failed", None, now, steps_done', '            self.respond(c, "Failed", c.steps[0].control_value, now, steps_done')),
    m("answers", "a failed command reports without status_value", "failed-report response-keys", (BODY, BODY + '        if status == "Failed" and event:\n            del body["status_value"]\n')),
    m("answers", "a refusal is without status_value", "response-keys", (BODY, BODY + '        if status == "Failed" and not event:\n            del body["status_value"]\n')),
    m("answers", "a malformed request is answered with its value", "response-keys", ('"status_value": None, **ids, **result}}', '"status_value": meant.get("control_value"), **ids, **result}}')),
    m("answers", "OK reports the first value", "script-values", (OK_ENDS, OK_ENDS.replace('"OK", value', '"OK", c.steps[0].control_value'))),
    m("answers", "Started reports the last value", "script-values", ('            self.respond(c, "Started", value, now)', '            self.respond(c, "Started", c.steps[-1].control_value, now)')),
    m("answers", "Accepted of a script reports its first value", "status-value", ('for step in c.value] if c.script else c.value\n', 'for step in c.value][0]["control_value"] if c.script else c.value\n')),
    m("answers", "an error has no message", "response-keys", ('error={"code": code, "message": message})\n    def respond', 'error={"code": code})\n    def respond'), ('            return self.respond(c, "Failed", error={"code": code, "message": message})\n', '            return self.respond(c, "Failed", error={"code": code})\n')),
    m("answers", "OK reports without late_steps", "response-keys", (OK_ENDS, OK_ENDS.replace(" late_steps=c.late,", ""))),
    m("answers", "OK reports without steps_done", "script-timing response-keys", (OK_ENDS, OK_ENDS.replace(" steps_done=c.done,", ""))),
    m("answers", "OK reports without its time", "script-timing response-keys", (BODY, '                **more, **({"event_timestamp": stamp(event)} if event and status != "OK" else {})}\n')),
    m("answers", "Accepted carries an error of null text", "response-keys", (BODY, BODY + '        if status == "Accepted":\n            body["error"] = {"code": "", "message": ""}\n')),
    m("answers", "capital digits of a hash are refused", "hash-digits", ("self.content_hash.lower() if self.content_hash", "self.content_hash if self.content_hash")),
    m("answers", "capital digits of a hash are repeated", "hash-digits", ('{"content_hash": c.hash} if c.hash else {}', '{"content_hash": c.content_hash} if c.hash else {}')),
    m("answers", "a refusal as busy is kept", "busy-not-kept", ('        need(not busy or reads, busy, "busy")\n', '        if busy and not reads:\n            return self.respond(c, "Failed", error={"code": "busy", "message": busy})\n')),
    m("answers", "a repeated refusal is a new request", "repeated-refusal", ('            return self.respond(c, "Failed", error={"code": code, "message": message})\n', '            answer = self.respond(c, "Failed", error={"code": code, "message": message})\n            self.answers.pop(c.request_id, None)\n            return answer\n')),
    m("answers", "a malformed line uses up its request id", "malformed-not-kept", ('                ids = {key: meant[key]', '                self.answers[meant.get("request_id")] = {"timestamp": stamp(0), "device_id": meant["device_id"], "request_id": meant.get("request_id"), "status": "Failed", "status_value": None, "error": {"code": "malformed", "message": message}}\n                ids = {key: meant[key]')),
    m("answers", "a wrong hash does not use up its request id", "malformed-kept", ('            return self.respond(c, "Failed", error={"code": code, "message": message})\n', '            answer = self.respond(c, "Failed", error={"code": code, "message": message})\n            if code == "malformed": self.answers.pop(c.request_id, None)\n            return answer\n')),
    m("answers", "a repeated stop drops the commands again", "repeated-stop", ("        if c.request_id in self.answers:\n", "        if c.request_id in self.answers and (c.steps or c.sensor):\n")),
    # Order of the checks.
    m("order", "the device is checked before the session", "check-order", ('        need(not busy or reads, busy, "busy")\n', '        need(not busy or reads or not device, busy, "busy")\n')),
    m("order", "the control type is checked before the session", "check-order", ('        need(not busy or reads, busy, "busy")\n', '        need(not busy or reads or device and c.control_type not in device.types, busy, "busy")\n')),
    m("order", "the hash is checked before the device", "check-order", ('    need(device, "the robot has no such device", "unknown_device")\n    need(not c.hash or c.right, "content_hash is not that of control_value")\n', '    need(not c.hash or c.right, "content_hash is not that of control_value")\n    need(device, "the robot has no such device", "unknown_device")\n')),
    m("order", "the start is checked before the values", "check-order", (KINDS, '    need(c.times[0] >= now, "the start has passed", "late")\n' + KINDS)),
    m("order", "the values are checked before the number of steps", "check-order", ('    need(len(c.steps) <= kinds[0].get("max_number_of_steps", 1), "the script is too long", "too_many_steps")\n', ""), ('    need(c.times[0] >= now, "the start has passed", "late")\n', '    need(len(c.steps) <= kinds[0].get("max_number_of_steps", 1), "the script is too long", "too_many_steps")\n    need(c.times[0] >= now, "the start has passed", "late")\n')),
    m("order", "the queue is checked before the overlap", "check-order", ("    for other in device.held:\n", '    need(len(device.held) < device.queue, "the device holds as many commands as it can", "busy")\n    for other in device.held:\n')),
    m("order", "the overlap is checked before the start", "check-order", ('    need(c.times[0] >= now, "the start has passed", "late")\n', '    for other in device.held:\n        need(c.times[0] >= other.times[-1] or other.times[0] >= c.times[-1], "not free", "overlap")\n    need(c.times[0] >= now, "the start has passed", "late")\n')),
    # Stops.
    m("stops", "a device without scripts refuses a stop", "stop-any-device", (NO_TYPES, NO_TYPES.replace(" or c.script and not c.steps", ""))),
    m("stops", "a stop whose start has passed is late", "stop-passed", (NO_TYPES, NO_TYPES.replace("    if not c.steps:\n        return\n", '    if not c.steps:\n        need(c.times[0] >= now, "the start has passed", "late")\n        return\n'))),
    m("stops", "a stop with a start ends the running script", "stop-later", (DROP_FROM, "            self.rest(device, *why)\n        else:")),
    m("stops", "a stop with a start cancels only later ones", "stop-later cancel-from", (DROP_FROM, DROP_FROM.replace("other.times[0] >= c", "other.times[0] > c"))),
    m("stops", "a stop with a start stops at once", "stop-later", ("        if c.times[0] > now:\n            self.drop(device", "        if False:\n            self.drop(device")),
    m("stops", "a request as old as the stop is accepted", "take-back-equal", (BACK, BACK.replace("c.sent > ", "c.sent >= "))),
    m("stops", "a request without a timestamp is taken back", "take-back-none", (BACK, BACK.replace("c.timestamp is None or c.sent >", "c.sent >"))),
    m("stops", "a stop in the future takes back for as long", "take-back-ahead", (TAKEN, TAKEN.replace("min(c.sent, now + FUTURE)", "c.sent"))),
    m("stops", "a stop takes back from the next session", "take-back-claimed", ("                device.taken_back = min(device.taken_back, time.time_ns())\n", "                pass\n")),
    m("stops", "a stop takes nothing back", "take-back", (TAKEN, "            pass\n")),
    m("stops", "a stop drops only waiting commands", "cancel-running", (REST, "            self.drop(device, [each for each in device.held if not each.passed], *why)\n")),
    # Sessions.
    m("sessions", "seize is obeyed without proof", "seize-plain", ('                need(link.roles is not None, "the robot can be seized only by an operator with the role seize; this connection has not proven any role", "forbidden")\n                permit("seize")\n', "")),
    m("sessions", "the owner cannot be asked without a session", "session-ask", ('            need(not busy or name != "inquiry" and request.session is None, busy, "busy")\n', '            need(not busy, busy, "busy")\n')),
    m("sessions", "a sensor is read only for the owner", "session-sensor", ('        need(not busy or reads, busy, "busy")\n', '        need(not busy, busy, "busy")\n')),
    m("sessions", "a reading claims the robot", "session-sensor", ("        busy, now = self.hear(link, c.session, not reads), time", "        busy, now = self.hear(link, c.session), time")),
    m("sessions", "only an accepted request claims the robot", "session-refused", ("        busy, now = self.hear(link, c.session, not reads), time", "        busy, now = self.hear(link, c.session, not reads and bool(c.steps) and (not device or c.control_type in device.types and all(device.types[device.drive or c.control_type]['min_value'] <= s.control_value <= device.types[device.drive or c.control_type]['max_value'] for s in c.steps))), time")),
    m("sessions", "a session ends with its connection, although commands are held", "session-holds", ("        if gone and not any(device.held or device.left_on for device in devices):\n", "        if all(other.session != self.owner for other in self.links):\n")),
    m("sessions", "a session is tied to its connection", "reports-follow session-two-links", ("        if self.owner is None and session and claims:\n", "        if self.owner is None and session and claims:\n            self.of = link\n"), ("        if self.owner not in (None, session):\n", "        if session and self.owner == session and link is not self.of and self.of in self.links:\n            return 'another connection'\n        if self.owner not in (None, session):\n")),
    m("sessions", "a request without a session uses that of its connection", "session-each-time", ("        c.session = own(link, c.session)\n", "        c.session = own(link, c.session) or link.session\n")),
    m("sessions", "the busy error names the session", "session", ('            return f"`{BLOCK[\'id\']}` belongs to another session until that session ends"', '            return f"`{BLOCK[\'id\']}` belongs to {self.owner[1]}"')),
    # Inquiries.
    m("inquiries", "the room counts only waiting commands", "room-running", (ROOM, '"room": device.queue - len([each for each in device.held if not each.passed])')),
    m("inquiries", "the room is that of an idle device", "inquiry-room", (ROOM, '"room": device.queue')),
    m("inquiries", "an inquiry without requests reports all", "inquiry-nothing", ("for key in asked.requests or []],\n", "for key in (asked.requests if asked.requests is not None else list(self.answers))],\n")),
    m("inquiries", "an inquiry without devices reports all", "inquiry-nothing", ("        found = [self.devices[key] for key in asked.devices or [] if key in self.devices]\n", "        found = [self.devices[key] for key in (asked.devices if asked.devices is not None else self.devices) if key in self.devices]\n")),
    m("inquiries", "pending_lease applies to requests of others", "pending-lease-stranger", ("            if not c.passed and (c.session == asked.session if c.session else c.link is link):\n", "            if not c.passed:\n")),
    m("inquiries", "pending_lease applies to running requests", "pending-lease-running", ("            if not c.passed and (c.session", "            if (c.session"), ("                c.leases[0] = min(limits, default=None)\n", "                c.leases = [min(limits, default=None)] * len(c.leases)\n")),
    m("inquiries", "a request asked for twice is reported once", "inquiry-twice", ("for key in asked.requests or []],\n", "for key in dict.fromkeys(asked.requests or [])],\n")),
    m("inquiries", "a cancelled request is unknown", "inquiry-ended", ('"ended" if key in self.answers else "unknown"', '"ended" if key in self.answers and self.answers[key]["status"] == "OK" else "unknown"')),
    m("inquiries", "a stop is unknown to an inquiry", "inquiry-stop", ('"ended" if key in self.answers else "unknown"', '"ended" if key in self.answers and "steps_done" in self.answers[key] or self.answers.get(key, {}).get("error") else "unknown"')),
    # Declarations.
    m("declared", "api_version is not a number", "api-version", (API, '"api_version": "v1", "reports": True,')),
    m("declared", "api_version is another version", "api-version", (API, '"api_version": "2.0", "reports": True,')),
    m("declared", "a claimed encoding is not spoken", "encodings", (API, API + ' "encodings": ["msgpack"],')),
    m("declared", "pending_until without inquiry", "initialization", ('         "inquiry": True, "pending_until"', '         "inquiry": False, "pending_until"')),
    m("declared", "reports are claimed and not sent", "script-timing", ("        if event and links:\n", "        if False:\n")),
    m("declared", "the queue holds less than declared", "queue", ('        self.queue, self.held, self.taken_back = spec.get("script_queue", 1),', "        self.queue, self.held, self.taken_back = 1,")),
    m("declared", "the block changes with each connection", "initialization", ('                return {"initialization_block": BLOCK}\n', '                return {"initialization_block": {**BLOCK, "name": f"arm {id(link)}"}}\n')),
    m("declared", "nothing can be moved", "late exit-code-5", ('"available_control_types": {"position": ANGLES, "script": {**ANGLES, "max_number_of_steps": 1000}}}', '"available_control_types": {}}'), ('"available_control_types": {"speed": SPEEDS, "script": {**SPEEDS, "max_number_of_steps": 1000}}}', '"available_control_types": {}}')),
]
