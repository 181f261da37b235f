"""The messages of URRCP: reading, checking and writing them. Nothing here needs a change for your own robot.

Whatever is wrong with a line is a ValueError. All times are nanoseconds.
"""
import collections, datetime, hashlib, json, re, sys, time

NEVER = 1 << 100
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)

def need(condition, message):
    if not condition:
        raise ValueError(message)

def parse(line):
    """The JSON of a line, and those faults in it that still let one see which device was meant."""
    faults = []

    def read_object(pairs):
        found = dict(pairs)
        if len(found) < len(pairs):
            faults.append("a key stands twice in one object")
            counts = collections.Counter(key for key, _ in pairs)
            found = {key: value for key, value in pairs if counts[key] == 1}
        return found

    try:
        return json.loads(line.decode(), object_pairs_hook=read_object,
                          parse_constant=lambda text: need(False, f"{text} is not JSON")), faults
    except RecursionError:
        raise ValueError("nested too deeply") from None

def write(value):
    return json.dumps(value, separators=(",", ":"))

def content_hash(value):
    text = re.sub(r"e([+-])0", r"e\1", write(value))                        # Python writes 1e-06
    text = re.sub(r"([0-9])(?:\.([0-9]+))?e-5\b", r"0.0000\1\2", text)      # and 1e-05 for 0.00001
    return hashlib.sha256(text.encode()).hexdigest()

def ns(milliseconds):
    return round(milliseconds * 1e6)

def stamp(instant):
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(instant // 10**9)) + f".{instant % 10**9:09d}Z"

# What a key may hold: each of these returns the value or raises ValueError.

def string(value, least=0):
    need(isinstance(value, str) and least <= len(value) <= 256, f"not a string of {least} to 256 characters")
    value.encode()              # half a surrogate pair is a ValueError
    return value

def name(value):
    return string(value, 1)

def number(value):
    need(type(value) in (int, float) and abs(value) <= sys.float_info.max, "not a number, or beyond the doubles")
    value = float(value)
    return int(value) if value.is_integer() and abs(value) < 1e16 else value    # so it is written; -0 is 0

def period(value):
    value = number(value)
    need(0 <= value <= 1e11, "not a number of milliseconds from 0 to 1e11")
    return value

def boolean(value):
    need(isinstance(value, bool), "not a boolean")
    return value

def driving(value):
    match = re.fullmatch("position|speed|acceleration|custom_(0|[1-9][0-9]{0,9})", string(value))
    need(match and int(match[1] or 0) < 1 << 32, "not a control type")
    return value

def control_type(value):
    return value if value in ("script", "sensor") else driving(value)

def sha256(value):
    need(re.fullmatch("[0-9a-fA-F]{64}", string(value)), "not 64 hexadecimal digits")
    return value.lower()

def instant(value):
    match = re.fullmatch(r"([0-9-]{10}T[0-9:]{8})(?:\.([0-9]{1,9}))?(Z|[+-][0-9]{2}:[0-9]{2})", string(value).upper())
    need(match, "not an RFC 3339 timestamp")
    since = datetime.datetime.fromisoformat(match[1] + match[3].replace("Z", "+00:00")) - EPOCH
    found = (since.days * 86400 + since.seconds) * 10**9 + int((match[2] or "").ljust(9, "0"))
    need(-1 << 63 <= found < 1 << 63, "a timestamp outside the years 1678 to 2261")
    return found

def lease(value):
    if not isinstance(value, dict):
        return period(value)
    both = {key: None if value.get(key) is None else period(value[key]) for key in ("pending", "running")}
    return both["pending"] if both["pending"] == both["running"] is not None else both      # the canonical form

def limit(condition, phase):
    """How long a stop_condition lets the server be silent."""
    ms = condition.get(phase) if isinstance(condition, dict) else condition
    return NEVER if ms is None else ns(ms)

STEP = {"time_offset_to_start": period, "control_type": driving, "stop_condition": lease}
REQUEST = {**STEP, "control_type": control_type, "timestamp": instant, "session": name, "device_id": name,
           "request_id": string, "content_hash": sha256, "hold": boolean}
VALUES = {"control_value" + (f"_{n}" if n > 1 else ""): n for n in range(1, 257)}

def members(body, kinds, *required):
    """The known keys of an object; None for those left out."""
    need(isinstance(body, dict), "not an object")
    need(all(body.get(key) is not None for key in required), f"one of {', '.join(required)} is missing")
    return {key: kind(body[key]) if body.get(key) is not None else None for key, kind in kinds.items()}

def values(body):
    given = {VALUES[key]: number(value) for key, value in body.items() if key in VALUES and value is not None}
    need(given and max(given) == len(given), "control_value is missing or has gaps")
    need(all(key in VALUES for key in body if key.startswith("control_value_")), "control_value_N is of a wrong N")
    return [given[n] for n in sorted(given)]

class Step:
    def __init__(self, body):
        found = members(body, STEP, "time_offset_to_start", "control_type")
        self.offset, self.kind, self.values = ns(found["time_offset_to_start"]), found["control_type"], values(body)
        self.lease = found.pop("stop_condition")
        self.json = {**found, **dict(zip(VALUES, self.values))}     # without keys that we do not know
        if self.lease is not None:
            self.json["stop_condition"] = self.lease

class Command:
    """A control request; once accepted, a command that is held until it ends."""
    def __init__(self, body, link):
        self.__dict__.update(members(body, REQUEST, "device_id", "control_type"))
        self.sent, self.kind, self.start, value = self.timestamp, self.control_type, None, body.get("control_value")
        if self.sent is not None and self.time_offset_to_start is not None:
            self.start = self.sent + ns(self.time_offset_to_start)
        if self.kind in ("script", "sensor"):
            need(self.kind == "sensor" or isinstance(value, list), "control_value is no list of steps")
            need(self.kind == "sensor" or not any(key.startswith("control_value_") for key in body), "one value only")
            self.steps = [Step(item) for item in value] if self.kind == "script" else []
            need(all(a.offset <= b.offset for a, b in zip(self.steps, self.steps[1:])), "a step before the one ahead")
            self.value = self.hashed = [step.json for step in self.steps]
        else:
            self.steps = [Step({**body, "time_offset_to_start": 0, "stop_condition": None})]
            self.value = self.steps[0].values[0]
            self.hashed = self.value if len(self.steps[0].values) == 1 else self.steps[0].values
        self.party = self.session or link        # whose messages renew the lease, and who gets the reports
        self.done = self.late = 0
        self.begun = self.started = False

    def lease_ends(self, shift):
        """Where the lease that follows the next step would be over by then, that step is not done."""
        def ends(done, phase):
            own = self.steps[done - 1].lease if done else None
            return self.heard + shift + limit(self.stop_condition if own is None else own, phase)
        if self.done == len(self.steps):
            return ends(self.done, "running")
        following = self.start + (self.steps[self.done].offset if self.begun else 0)
        steps = self.done + (self.begun or self.steps[0].offset == 0)
        return min(ends(self.done, "running" if self.begun else "pending"), max(following, ends(steps, "running")))

def refusal(c, device, now):
    """The first check that fails, in the order of the protocol, as code and message."""
    if not device:
        return "unknown_device", "the robot has no such device"
    if c.content_hash and c.kind != "sensor" and c.content_hash != content_hash(c.hashed):
        return "malformed", "content_hash is not that of control_value"
    if c.kind == "script" and not c.steps:
        return None
    if c.kind not in device.types:
        return "unsupported_control_type", f"`{device.id}` has no such control type"
    if c.kind == "sensor":
        return None
    own = device.types[c.kind]
    usable = own.get("control_types", set(device.types) - {"script", "sensor"})
    if len(c.steps) > own.get("max_number_of_steps", 1):
        return "too_many_steps", f"`{device.id}` takes {own['max_number_of_steps']} steps"
    for n, step in enumerate(c.steps):
        if c.kind == "script" and step.kind not in usable:
            return "unsupported_control_type", f"step {n} is of a control type that scripts cannot use"
        if step.kind.startswith("custom_"):
            continue
        value, both = step.values[0], (device.types.get(step.kind, own), own)
        if len(step.values) > 1:
            return "malformed", "only a custom type takes several values"
        if any(not each["min_value"] <= value <= each["max_value"] for each in both):
            return "out_of_range", f"{value} lies outside"
        if any(abs(value / each["granularity"] - round(value / each["granularity"])) > 1e-6 for each in both):
            return "off_granularity", f"{value} is no multiple of the granularity"
    if c.start < now:
        return "late", "the start has passed"
    if c.sent is not None and c.sent <= device.taken_back:
        return "cancelled", "it was taken back by an empty script"
    if any(c.start < other.end and other.start < c.end for other in device.held):
        return "overlap", "the device is not free all that time"
    if len(device.held) >= device.queue:
        return "busy", f"the device holds {device.queue} commands"

class Meant:
    """What can be made out of a control request that is no message: enough to answer it. ValueError if it is not."""
    def __init__(self, kind, body):
        need(kind == "control_request" and isinstance(body, dict), "no control request")
        self.device_id, self.request_id = name(body.get("device_id")), body.get("request_id")
        try:
            string(self.request_id)
        except ValueError:
            self.request_id = None

REQUESTS = {
    "availability_request": lambda body, _: members(body, {"timestamp": instant, "session": name}),
    "initialization_request": lambda body, _: members(body, {"timestamp": instant}),
    "control_request": Command,
}
IGNORED = {"availability_response", "initialization_block", "control_response"}      # only a robot sends these
