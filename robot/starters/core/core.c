#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../c/json.h"

#define MS INT64_C(1000000)
#define NEVER INT64_MAX
#define KEPT 16 /* last answers: those of 8 ended requests, and of the commands that are held */
#define JSON(...) #__VA_ARGS__
static const char block[] = JSON({"initialization_block":{"id":"core-2","api_version":"1","devices":[
    {"id":"arm","unit":"deg","default_value":0,"available_control_types":{"position":{"min_value":0,"max_value":90,"granularity":0.5}}},
    {"id":"wheel","unit":"m/s","available_control_types":{"speed":{"min_value":-10,"max_value":10,"granularity":0.1}}}]}});

struct kept { uint64_t id, order; const char *code; char value[32]; int device; bool held; };
struct command { int64_t start, until, pending, running; double value; struct kept *kept; uint64_t session; int link; };
static struct device {
    const char *id, *kind; double low, high, step; bool rests_at_zero, holds, left_on;
    struct command held, on; /* the command that waits, and the one whose speed continues */
    int64_t taken_back;
} devices[] = {{"arm", "position", 0, 90, 0.5, false, .taken_back = INT64_MIN}, {"wheel", "speed", -10, 10, 0.1, true, .taken_back = INT64_MIN}};
#define EACH(item) for (struct device *item = devices; item < devices + sizeof devices / sizeof *devices; item++)
static struct kept answers[KEPT];
static struct { bool open; uint64_t session; int64_t heard; } links[CORE_LINKS];
static uint64_t owner, order; /* sessions and request ids are compared by 64-bit hashes; 0 is none */
static int64_t owner_heard;
static struct json json;
static char *out;
static size_t used;

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }
static int64_t after(int64_t from, int64_t span) { return span == NEVER ? NEVER : from + span; }
static void drop(struct device *device, const char *code)
{
    if (device->holds)
        device->held.kept->code = code, device->held.kept->held = device->holds = false;
}
static void rest(struct device *device, const char *code, bool home)
{
    drop(device, code);
    device->left_on = false;
    if (device->rests_at_zero || home) /* the default_value is 0 here */
        core_drive((int)(device - devices), 0);
}
int64_t core_run(struct core_now now)
{
    int64_t next = 250 * MS, shift = now.clock - now.steady; /* leases measure silence, independent of changes of the clock */
    EACH(device) {
        struct command *on = &device->on, *c = &device->held;
        int64_t ends = after(shift + (on->session ? owner_heard : links[on->link].heard), on->running);
        if (device->left_on && ends <= now.clock)
            rest(device, "link_lost", false);
        else if (device->left_on)
            next = least(next, ends - now.clock);
        if (!device->holds)
            continue;
        int64_t heard = shift + (c->session ? owner_heard : links[c->link].heard), running = after(heard, c->running);
        ends = least(least(after(heard, c->pending), c->until), running > c->start ? running : NEVER);
        if (running <= c->start)    /* the lease would be over by the start */
            ends = least(ends, c->start);
        if (ends <= c->start && ends <= now.clock)
            drop(device, "link_lost");
        else if (c->start <= now.clock) {
            drop(device, now.clock - c->start > 50 * MS ? "late" : NULL);
            if (c->kept->code)
                continue;
            core_drive((int)(device - devices), c->value);
            *on = *c;
            device->left_on = device->rests_at_zero && c->value != 0 && c->running != NEVER;
            next = 0;
        } else
            next = least(next, least(ends, c->start) - now.clock);
    }
    return next < 0 ? 0 : next;
}
static void put(const char *text, size_t length, bool escape)
{
    for (; length && used < CORE_ANSWER - 8; text++, length--)
        if (escape && ((unsigned char)*text < 0x20 || *text == '"' || *text == '\\'))
            used += (size_t)sprintf(out + used, "\\u%04x", *text);
        else
            out[used++] = *text;
}
static void say(const char *text) { put(text, strlen(text), false); }
static void say_time(const char *key, int64_t at)
{
    long long days = at / 1000000000 / 86400, era = (days += 719468) / 146097, of = days - era * 146097; /* of a calendar that begins in March */
    long long year = (of - of / 1460 + of / 36524 - of / 146096) / 365, day = of - (365 * year + year / 4 - year / 100), month = (5 * day + 2) / 153;
    long long second = at / 1000000000 % 86400;
    used += (size_t)sprintf(out + used, "\"%s\":\"%04lld-%02lld-%02lldT%02lld:%02lld:%02lld.%09lldZ\"", key, year + era * 400 + (month > 9),
        month < 10 ? month + 3 : month - 9, day - (153 * month + 2) / 5 + 1, second / 3600, second / 60 % 60, second % 60, (long long)(at % 1000000000));
}
static int get(int object, const char *key) { return json_get(&json, object, key); }
static void say_node(const char *key, int node)
{
    if (node == JSON_NONE)
        return;
    say(",\""), say(key), say("\":\""), put(json.nodes[node].text, json.nodes[node].length, true), say("\"");
}
static void fail(const char *code) { say(",\"error\":{\"code\":\""), say(code), say("\",\"message\":\"see the code\"}"); }
static const char *first_device; /* of a request asked twice: the device that the first one named, if the robot has it */
static size_t respond(int device, int id, const char *status, const char *value, const char *code, struct core_now now)
{
    say("{\"control_response\":{"), say_time("timestamp", now.clock);
    if (first_device)
        say(",\"device_id\":\""), say(first_device), say("\"");
    else
        say_node("device_id", device);
    say_node("request_id", id);
    say(",\"status\":\""), say(status), say("\",\"status_value\":"), say(value);
    if (code)
        fail(code);
    say("}}");
    return used;
}
static size_t availability(int node, const char *code, struct core_now now)
{
    say("{\"availability_response\":{"), say_time("receive_timestamp", now.clock), say(","), say_time("timestamp", now.clock);
    say_node("originate_timestamp", node), say(code ? ",\"status\":\"Failed\"" : ",\"status\":\"OK\"");
    if (code)
        fail(code);
    say("}}");
    return used;
}
static uint64_t hash(int node)
{
    uint64_t h = UINT64_C(14695981039346656037);
    for (size_t i = 0; node != JSON_NONE && i < json.nodes[node].length; i++)
        h = (h ^ (unsigned char)json.nodes[node].text[i]) * UINT64_C(1099511628211);
    return node == JSON_NONE ? 0 : h ? h : 1;
}
static bool is(int node, enum json_type type) { return node == JSON_NONE || json.nodes[node].type == type; }
static bool string(int node, size_t least_length)
{
    size_t i, characters = 0;
    for (i = 0; node != JSON_NONE && is(node, JSON_STRING) && i < json.nodes[node].length; i++)
        characters += (json.nodes[node].text[i] & 0xc0) != 0x80;
    return node == JSON_NONE || (is(node, JSON_STRING) && characters <= 256 && characters >= least_length);
}
static bool boolean(int node) { return is(node, JSON_TRUE) || is(node, JSON_FALSE); }
static bool period(int node, int64_t *to)
{
    double value = node == JSON_NONE ? 0 : json.nodes[node].number;
    *to = node == JSON_NONE ? NEVER : (int64_t)llround(fmin(fmax(value, 0), 1e11) * 1e6);
    return is(node, JSON_NUMBER) && value >= 0 && value <= 1e11;
}
static bool instant(int node, int64_t *to)
{
    static const int days[] = {0, 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    int y, m, d, h, min, s, n = 0, oh = 0, om = 0, end = 0, leap;
    char text[40] = "", sign = 0;
    int64_t fraction = 0, unit = 100000000;
    if (node == JSON_NONE)
        return true;
    if (!is(node, JSON_STRING) || json.nodes[node].length > 35)
        return false;
    memcpy(text, json.nodes[node].text, json.nodes[node].length);
    for (n = 0; n < 19; n++) /* sscanf alone would accept signs and spaces */
        if ("0000-00-00T00:00:00"[n] == '0' ? text[n] < '0' || text[n] > '9' : text[n] != "0000-00-00T00:00:00"[n])
            return false;
    sscanf(text, "%4d-%2d-%2dT%2d:%2d:%2d", &y, &m, &d, &h, &min, &s);
    if (text[n] == '.')
        for (n++; text[n] >= '0' && text[n] <= '9' && unit; n++, unit /= 10)
            fraction += (text[n] - '0') * unit;
    leap = (y % 4 == 0 && y % 100) || y % 400 == 0;
    if (text[n - 1] == '.' || m < 1 || m > 12 || d < 1 || d > days[m] + (m == 2 && leap) || h > 23 || min > 59 || s > 59 || y < 1700 || y > 2250)
        return false;
    if (strcmp(text + n, "Z") && (sscanf(text + n, "%c%2d:%2d%n", &sign, &oh, &om, &end) != 3 || text[n + end] || (sign != '+' && sign != '-') || end != 6))
        return false;
    y -= m < 3;
    *to = ((((365LL * y + y / 4 - y / 100 + y / 400 + (153 * (m + (m > 2 ? -3 : 9)) + 2) / 5 + d - 1 - 719468) * 24 + h) * 60 + min
        - (sign == '-' ? -1 : 1) * (oh * 60 + om)) * 60 + s) * 1000000000LL + fraction;
    return true;
}
/* Renews leases and determines the owner. Returns whether the robot belongs to another session. */
static bool hear(int link, uint64_t session, struct core_now now)
{
    bool idle = true, present = false;
    EACH(device) idle &= !device->holds && !device->left_on;
    for (int i = 0; i < CORE_LINKS; i++)
        present |= links[i].open && links[i].session == owner;
    if (idle && (!present || now.steady - owner_heard >= 5000 * MS))
        owner = 0;
    if (!owner && session) {
        owner = session;
        EACH(device) device->taken_back = least(device->taken_back, now.clock);
    }
    links[link].heard = now.steady;
    links[link].session = session ? session : links[link].session;
    owner_heard = links[link].session == owner ? now.steady : owner_heard;
    return owner && owner != session;
}
static struct kept *keep(uint64_t id, int device)
{
    struct kept *oldest = NULL;
    for (struct kept *k = answers; k < answers + KEPT; k++)
        oldest = !k->held && (!oldest || k->order < oldest->order) ? k : oldest;
    *oldest = (struct kept){id, ++order, NULL, "null", device, false};
    return oldest;
}
static size_t control(int body, int link, struct core_now now)
{
    int id = get(body, "request_id"), name = get(body, "device_id"), kind = get(body, "control_type"), value = get(body, "control_value");
    int lease = get(body, "stop_condition"), sent_node = get(body, "timestamp"), offset_node = get(body, "time_offset_to_start"), at, further = 0;
    bool script = json_is(&json, kind, "script"), sensor = json_is(&json, kind, "sensor"), home, stop, right, valued;
    int64_t sent = 0, offset;
    struct command c = {.until = NEVER, .link = link};
    const char *code = NULL;
    valued = json_is(&json, kind, "position") || json_is(&json, kind, "speed") || json_is(&json, kind, "acceleration")
        || (kind != JSON_NONE && json.nodes[kind].length > 7 && !memcmp(json.nodes[kind].text, "custom_", 7));
    right = name != JSON_NONE && string(name, 1) && kind != JSON_NONE && string(kind, 0) && string(id, 0) && string(get(body, "session"), 1)
        && instant(sent_node, &sent) && period(offset_node, &offset) && instant(get(body, "pending_until"), &c.until) && boolean(get(body, "home"));
    if (lease != JSON_NONE && json.nodes[lease].type == JSON_OBJECT)
        right &= period(get(lease, "pending"), &c.pending) & period(get(lease, "running"), &c.running);
    else
        right &= period(lease, &c.pending), c.running = c.pending;
    at = get(body, "content_hash");
    right &= at == JSON_NONE || (is(at, JSON_STRING) && json.nodes[at].length == 64 && strspn(json.nodes[at].text, "0123456789abcdefABCDEF") >= 64);
    for (at = right ? json.nodes[body].first : JSON_NONE; at != JSON_NONE; at = json.nodes[at].next)
        if (json.nodes[at].length > 14 && !memcmp(json.nodes[at].text, "control_value_", 14) && json.nodes[json.nodes[at].first].type != JSON_NULL)
            further++;
    for (int n = 2; n < further + 2; n++) {
        char key[32];
        sprintf(key, "control_value_%d", n);
        at = get(body, key);
        right &= script ? false : !valued || (at != JSON_NONE && json.nodes[at].type == JSON_NUMBER && n <= 256);
    }
    right &= script ? value != JSON_NONE && is(value, JSON_LIST) : !valued || (value != JSON_NONE && is(value, JSON_NUMBER));
    if (!right)
        return name != JSON_NONE && json.nodes[name].type == JSON_STRING && string(name, 1)
            ? respond(name, id != JSON_NONE && json.nodes[id].type == JSON_STRING && string(id, 0) ? id : JSON_NONE, "Failed", "null", "malformed", now)
            : availability(JSON_NONE, "malformed", now);
    struct device *device = NULL;
    EACH(each) device = json_is(&json, name, each->id) ? each : device;
    bool busy = hear(link, c.session = hash(get(body, "session")), now);
    home = get(body, "home") != JSON_NONE && json.nodes[get(body, "home")].type == JSON_TRUE;
    stop = script && json.nodes[value].size == 0;
    for (struct kept *k = answers; id != JSON_NONE && k < answers + KEPT; k++)
        if (k->order && k->id == hash(id)) { /* asked twice */
            first_device = k->device < 0 ? NULL : devices[k->device].id;
            return respond(name, id, k->code ? "Failed" : k->value[0] == 'n' ? "OK" : "Accepted", k->code ? "null" : k->value, k->code, now);
        }
    c.start = sent_node != JSON_NONE && offset_node != JSON_NONE ? sent + offset : now.clock;
    if (busy)
        return respond(name, id, "Failed", "null", "busy", now);
    c.kept = keep(hash(id), device ? (int)(device - devices) : -1);
    c.kept->order = id == JSON_NONE ? 0 : c.kept->order;
    if (!device)
        code = "unknown_device";
    else if (stop) {
        if (c.start > now.clock && device->holds && device->held.start >= c.start)
            drop(device, "cancelled");
        else if (c.start <= now.clock) {
            sent = sent_node == JSON_NONE ? INT64_MIN : least(sent, now.clock + 250 * MS);
            device->taken_back = sent > device->taken_back ? sent : device->taken_back;
            rest(device, "cancelled", home);
        }
        return respond(name, id, "OK", "null", NULL, now);
    } else if (sensor || !json_is(&json, kind, device->kind)) {
        code = "unsupported_control_type";
        rest(device, "cancelled", true);
    } else {
        double n = (c.value = json.nodes[value].number) / device->step;
        code = further ? "malformed" : c.value < device->low || c.value > device->high ? "out_of_range" : fabs(n - round(n)) > 1e-6 ? "off_granularity"
            : c.start < now.clock || c.until <= now.clock ? "late" : sent_node != JSON_NONE && sent <= device->taken_back ? "cancelled"
            : device->holds ? "busy" : NULL;
    }
    c.kept->code = code;
    if (code)
        return respond(name, id, "Failed", "null", code, now);
    sprintf(c.kept->value, "%.17g", c.value);
    c.kept->held = device->holds = true;
    device->held = c;
    return respond(name, id, "Accepted", c.kept->value, NULL, now);
}
size_t core_line(int link, char *line, size_t length, struct core_now now, char answer[CORE_ANSWER])
{
    static const char *const of_robots[] = {"availability_response", "initialization_block", "control_response", "inquiry_response"};
    int key, body, session, seize, sent_node;
    int64_t sent;
    out = answer, used = 0, first_device = NULL;
    bool right = line && json_read(&json, line, length) && json.nodes[0].type == JSON_OBJECT && json.nodes[0].size == 1;
    key = right ? json.nodes[0].first : JSON_NONE;
    for (int i = 0; right && i < 4; i++)
        if (json_is(&json, key, of_robots[i]))
            return 0;
    body = right ? json.nodes[key].first : JSON_NONE;
    right = right && json.nodes[body].type == JSON_OBJECT;
    if (right && json.fault && json_is(&json, key, "control_request")) { /* a duplicate key is no key, so it may lack its device */
        int name = get(body, "device_id"), id = get(body, "request_id");
        if (name != JSON_NONE && string(name, 1))
            return respond(name, id != JSON_NONE && string(id, 0) ? id : JSON_NONE, "Failed", "null", "malformed", now);
    }
    if (!right || json.fault)
        return availability(JSON_NONE, "malformed", now);
    if (json_is(&json, key, "control_request"))
        return control(body, link, now);
    bool claims = json_is(&json, key, "availability_request");
    session = claims ? get(body, "session") : JSON_NONE, seize = claims ? get(body, "seize") : JSON_NONE, sent_node = get(body, "timestamp");
    if ((!claims && !json_is(&json, key, "initialization_request")) || !string(session, 1) || !boolean(seize) || !instant(sent_node, &sent))
        return availability(JSON_NONE, "malformed", now);
    if (seize != JSON_NONE && json.nodes[seize].type == JSON_TRUE)
        return availability(sent_node, session == JSON_NONE ? "malformed" : "forbidden", now);
    bool busy = hear(link, hash(session), now);
    if (claims)
        return availability(sent_node, busy && session != JSON_NONE ? "busy" : NULL, now);
    say(block);
    return used;
}
void core_opened(int link, struct core_now now) { links[link].open = true, links[link].session = 0, links[link].heard = now.steady; }
void core_closed(int link) { links[link].open = false; }
