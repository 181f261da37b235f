/* A URRCP robot to copy: put your own description into BLOCK and your own hardware into arm_set and arm_read.

   cc -std=c99 -D_POSIX_C_SOURCE=200809L -O2 -o robot robot.c json.c sealed.c sha256.c -lm
   ./robot --listen 127.0.0.1:7000
   ./robot --listen 0.0.0.0:7000 --secret arm-1.secret --revoked revoked.serials

   Nothing is allocated: all data is in the pools below, whose sizes are the limits. */
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "json.h"
#include "sealed.h"

/* Limits. A line must have room for the largest script. */

#define MAX_DEVICES 8
#define MAX_QUEUE 2       /* script_queue of a device */
#define MAX_STEPS 256     /* max_number_of_steps of a script */
#define MAX_LINKS 8
#define STRANGERS 6       /* of them, those whose session does not own the robot */
#define MAX_LINE (96 * 1024)
#define MAX_OUT (160 * 1024) /* unread bytes at which a peer is disconnected; from MAX_UNREAD on, its input is not read */
#define MAX_UNREAD (48 * 1024)
#define KEPT 300          /* last answers of requests that have ended; the protocol requires 256 */
#define AUTHORS 16        /* reasons with the name of an operator */
#define MAX_ID 256        /* characters of a string */
#define MAX_NAMES 128     /* requests, and devices, in an inquiry; its answer must fit into MAX_OUT */

/* Your robot. The macro turns it into a string. */

#define JSON(...) #__VA_ARGS__

static const char BLOCK[] = JSON(
{"id": "arm-2", "name": "right arm", "type": "Industrial", "api_version": "1", "reports": true,
 "inquiry": true, "pending_until": true, "devices": [
    {"id": "shoulder", "name": "shoulder servo", "unit": "deg", "default_value": 0, "interpolation": "linear", "script_queue": 2,
     "available_control_types": {
        "position": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25},
        "script": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25,
                   "max_number_of_steps": 256, "control_types": ["position"]}}},
    {"id": "wheel", "name": "wheel motor", "unit": "m/s", "interpolation": "hold",
     "available_control_types": {
        "speed": {"min_value": -10, "max_value": 10, "granularity": 0.1},
        "script": {"min_value": -10, "max_value": 10, "granularity": 0.1,
                   "max_number_of_steps": 256, "control_types": ["speed"]}}},
    {"id": "camera", "name": "camera temperature", "unit": "degC",
     "available_control_types": {"sensor": {"min_value": -40, "max_value": 125, "max_delay": 20}}}]}
);

/* Control types that set a value. This robot does not support any custom_N. */
enum kind { POSITION, SPEED, ACCELERATION, KINDS, OTHER = KINDS };

static const char *const KIND_NAMES[] = {"position", "speed", "acceleration"};

/* Your hardware: `device` counts from 0 in the order of BLOCK. Both must return at once; false is answered or reported as `internal`. */
static bool arm_set(int device, enum kind kind, double value)
{
    (void)device, (void)kind, (void)value;
    return true;
}

static bool arm_read(int device, double *value)
{
    (void)device;
    *value = 42.5;
    return true;
}

/* Times are nanoseconds, by the clock that NTP disciplines; silence is measured by a clock that is never set. Timestamps outside the
   years 1685 to 2255 are malformed, so that nothing overflows. */

#define MS INT64_C(1000000)
#define SECOND INT64_C(1000000000)
#define FAR INT64_C(9000000000000000000)
#define NEVER INT64_MAX
#define SAMPLE (20 * MS)      /* period at which a linear device is set between two steps */
#define LATE_STEP MS
#define LATE_START (50 * MS)
#define SILENCE (5 * SECOND)  /* after which a session without commands ends */
#define FUTURE (5 * SECOND)   /* a stop cancels requests sent until at most this far in the future */
#define FIRST (5 * SECOND)    /* for a peer to prove its identity, if required, and to send its first message */
#define BEGUN (10 * SECOND)   /* for a stranger to complete a message that it has begun */
#define SPIN MS               /* busy-waits for this long before a step is due */

struct text {
    size_t length;
    char bytes[4 * MAX_ID];
};

struct limits {
    bool there;
    double min, max, granularity;
};

/* A stop_condition; a phase without limit is NaN. */
struct lease {
    enum { NO_LEASE, ONE_LEASE, TWO_LEASES } form;
    double pending, running;
};

struct step {
    double ms, value;
    int64_t offset;
    enum kind kind;
    struct lease lease;
};

enum status { ACCEPTED, STARTED, OK, FAILED, PROVIDE };

static const char *const STATUS_NAMES[] = {"Accepted", "Started", "OK", "Failed", "Provide"};

/* The last answer to a request, repeated if the request is repeated. */
struct answer {
    bool used, ended, named, has_value, is_report;
    uint64_t number;
    struct text request_id, device_id;
    enum status status;
    double value;
    int64_t event;
    int steps_done, late_steps;
    int64_t latest; /* largest lateness of a step, in ns */
    const char *code, *message;
    const struct command *command; /* the command, from its acceptance to its end */
    char content_hash[65];         /* of the accepted request */
    bool began;
    int64_t began_at;
};

struct command {
    bool held, script, begun, started;
    bool of_owner;                 /* belongs to the session, else to the connection `link` */
    uint64_t link, number;
    struct sealed_claim by;        /* unless it belongs to the session */
    struct answer *answer;
    char content_hash[65];
    struct lease lease;
    int64_t start, end, heard, sampled;
    int64_t until;                 /* pending_until of the request or of an inquiry */
    int64_t from_offset;           /* where a linear device comes from */
    double from_value;
    enum kind from_kind;
    int done, late, size;
    int64_t latest;                /* largest lateness of a step, in ns */
    struct step steps[MAX_STEPS];
};

struct device {
    struct text id;
    struct limits kinds[KINDS], script;
    bool sensor, linear, has_default;
    bool usable[KINDS];            /* in its scripts */
    double default_value, where[KINDS];
    bool placed;                   /* whether the hardware has accepted a position, which is in `where` */
    enum kind primary;             /* the control type of default_value */
    int queue, max_steps;
    int64_t taken_back;
    struct command commands[MAX_QUEUE];
    struct tail {                  /* the lease of a speed that continues after its command */
        bool there, of_owner, named;
        uint64_t link, command;
        struct sealed_claim by;
        int64_t limit, heard;
        int steps_done;
        struct text request_id;
    } tails[KINDS];
};

struct link {
    int socket;                    /* -1: free */
    uint64_t number;
    bool of_owner, skipping, dead, more, spoken;
    int64_t heard;                 /* the last message; before the first, when the peer connected */
    int64_t begun;                 /* when the incomplete line began; 0 without one */
    size_t in_length, out_length, ready; /* ready: bytes of `out` that are records already */
    struct sealed sealed;
    char in[MAX_LINE + 2 + SEALED_RECORD], out[MAX_OUT];
};

static struct device devices[MAX_DEVICES];
static int device_count;
static struct answer answers[KEPT + MAX_DEVICES * MAX_QUEUE];
static struct link links[MAX_LINKS];
static struct json json;
static struct text robot_id, owner;
static char owner_name[SEALED_NAME]; /* the operator that proved to own the robot */
static size_t owner_name_length;
static struct sealed_claim owner_claim; /* with which the session last proved to own the robot */
static bool owned, reports, secured; /* secured: a peer has to prove a pass */
static struct sealed_key key;
static const char *revoked;          /* the file of the list of revoked passes, or NULL */
static int64_t owner_heard;
static uint64_t numbers;

static int64_t clock_ns(clockid_t clock)
{
    struct timespec at;
    clock_gettime(clock, &at);
    return at.tv_sec * SECOND + at.tv_nsec;
}

static int64_t now_ns(void)
{
    return clock_ns(CLOCK_REALTIME);
}

static int64_t silence_ns(void)
{
    return clock_ns(CLOCK_MONOTONIC);
}

static int64_t ms_to_ns(double ms)
{
    return (int64_t)floor(ms * 1e6 + 0.5);
}

static bool same(const struct text *a, const struct text *b)
{
    return a->length == b->length && !memcmp(a->bytes, b->bytes, a->length);
}

/* Writing. A link that is NULL or dead accepts everything and sends nothing. */

/* Turns the pending output into records. */
static void link_seal(struct link *link)
{
    while (link->ready < link->out_length && !link->dead) {
        char *at = link->out + link->ready;
        size_t size = link->out_length - link->ready;
        if (MAX_OUT - link->out_length < SEALED_HEAD) {
            link->dead = true; /* a peer that does not read */
            return;
        }
        memmove(at + SEALED_HEAD, at, size);
        size = size < SEALED_RECORD ? size : SEALED_RECORD;
        sealed_seal(&link->sealed, at + SEALED_HEAD, size, (unsigned char *)at);
        link->out_length += SEALED_HEAD;
        link->ready += SEALED_HEAD + size;
    }
}

static void link_flush(struct link *link)
{
    if (secured)
        link_seal(link);
    while (link->out_length && !link->dead) {
        ssize_t sent = send(link->socket, link->out, link->out_length, MSG_NOSIGNAL);
        if (sent < 0) {
            if (errno == EINTR)
                continue;
            if (errno != EAGAIN && errno != EWOULDBLOCK)
                link->dead = true;
            return;
        }
        link->out_length -= (size_t)sent;
        link->ready -= link->ready < (size_t)sent ? link->ready : (size_t)sent;
        memmove(link->out, link->out + sent, link->out_length);
    }
}

static void put_bytes(struct link *link, const char *bytes, size_t length)
{
    if (!link || link->dead)
        return;
    if (length > MAX_OUT - link->out_length) {
        link->dead = true; /* a peer that does not read */
        return;
    }
    memcpy(link->out + link->out_length, bytes, length);
    link->out_length += length;
}

static void put(struct link *link, const char *format, ...)
{
    char bytes[256];
    va_list list;
    int length;
    va_start(list, format);
    length = vsnprintf(bytes, sizeof bytes, format, list);
    va_end(list);
    if (length > 0)
        put_bytes(link, bytes, (size_t)length < sizeof bytes ? (size_t)length : sizeof bytes - 1);
}

static void put_text(struct link *link, const char *bytes, size_t length)
{
    put_bytes(link, "\"", 1);
    for (; length; length--, bytes++) {
        if (*bytes == '"' || *bytes == '\\')
            put_bytes(link, "\\", 1);
        if ((unsigned char)*bytes < 0x20)
            put(link, "\\u%04x", (unsigned)*bytes);
        else
            put_bytes(link, bytes, 1);
    }
    put_bytes(link, "\"", 1);
}

/* Writes the fewest digits that read back as the same double. */
static void put_number(struct link *link, double value)
{
    char digits[40];
    int precision = 0, exponent;
    if (value == floor(value) && fabs(value) < 1e16) {
        put(link, "%.0f", value);
        return;
    }
    do
        snprintf(digits, sizeof digits, "%.*e", precision, value);
    while (strtod(digits, NULL) != value && precision++ < 17);
    exponent = atoi(strchr(digits, 'e') + 1);
    if (exponent >= -5 && exponent < 16)
        put(link, "%.*f", precision > exponent ? precision - exponent : 0, value);
    else
        put(link, "%.*se%+d", (int)(strchr(digits, 'e') - digits), digits, exponent);
}

static void put_stamp(struct link *link, int64_t at)
{
    time_t seconds = (time_t)(at / SECOND);
    struct tm utc;
    gmtime_r(&seconds, &utc);
    put(link, "\"%04d-%02d-%02dT%02d:%02d:%02d.%09dZ\"", utc.tm_year + 1900, utc.tm_mon + 1, utc.tm_mday, utc.tm_hour,
        utc.tm_min, utc.tm_sec, (int)(at % SECOND));
}

static void put_steps(struct link *link, const struct command *c)
{
    int i;
    put(link, "[");
    for (i = 0; i < c->size; i++) {
        const struct step *step = &c->steps[i];
        put(link, "%s{\"time_offset_to_start\":", i ? "," : "");
        put_number(link, step->ms);
        put(link, ",\"control_type\":\"%s\",\"control_value\":", KIND_NAMES[step->kind]);
        put_number(link, step->value);
        if (step->lease.form == ONE_LEASE) {
            put(link, ",\"stop_condition\":");
            put_number(link, step->lease.running);
        } else if (step->lease.form == TWO_LEASES) {
            put(link, ",\"stop_condition\":{");
            if (!isnan(step->lease.pending)) {
                put(link, "\"pending\":");
                put_number(link, step->lease.pending);
            }
            if (!isnan(step->lease.running)) {
                put(link, isnan(step->lease.pending) ? "\"running\":" : ",\"running\":");
                put_number(link, step->lease.running);
            }
            put(link, "}");
        }
        put(link, "}");
    }
    put(link, "]");
}

static void put_error(struct link *link, const char *code, const char *message)
{
    put(link, ",\"error\":{\"code\":\"%s\",\"message\":", code);
    put_text(link, message, strlen(message));
    put(link, "}");
}

static void send_end(struct link *link)
{
    put(link, "}}\n");
    if (link)
        link_flush(link);
}

static void put_late(struct link *link, const struct answer *a)
{
    put(link, ",\"late_steps\":%d", a->late_steps);
    if (a->late_steps) {
        put(link, ",\"late_ms_max\":");
        put_number(link, a->latest / 1e6);
    }
}

static void send_answer(struct link *link, const struct answer *a)
{
    put(link, "{\"control_response\":{\"timestamp\":");
    put_stamp(link, now_ns());
    put(link, ",\"device_id\":");
    put_text(link, a->device_id.bytes, a->device_id.length);
    put(link, ",\"status\":\"%s\",\"status_value\":", STATUS_NAMES[a->status]);
    if (a->status == ACCEPTED && a->command->script)
        put_steps(link, a->command);
    else if (a->has_value)
        put_number(link, a->value);
    else
        put(link, "null");
    if (a->named) {
        put(link, ",\"request_id\":");
        put_text(link, a->request_id.bytes, a->request_id.length);
    }
    if (a->status == ACCEPTED && a->command->content_hash[0])
        put(link, ",\"content_hash\":\"%s\"", a->command->content_hash);
    if (a->is_report) {
        put(link, ",\"event_timestamp\":");
        put_stamp(link, a->event);
        if (a->status != STARTED)
            put(link, ",\"steps_done\":%d", a->steps_done);
        if (a->status == OK)
            put_late(link, a);
    }
    if (a->status == FAILED)
        put_error(link, a->code, a->message);
    send_end(link);
}

/* Commands. */

/* A report goes to the connection on which the session sent its last message, or to the connection of a command without a session. */
static struct link *link_of(bool of_owner, uint64_t number)
{
    struct link *to = NULL, *link;
    for (link = links; link < links + MAX_LINKS; link++)
        if (link->socket >= 0 && !link->dead && (of_owner ? link->of_owner : link->number == number)
            && (!to || link->heard > to->heard))
            to = link;
    return reports ? to : NULL;
}

static void report(struct command *c, enum status status, const double *value, const char *code, const char *message, int64_t now)
{
    struct answer *a = c->answer;
    struct link *to = link_of(c->of_owner, c->link);
    a->status = status;
    a->is_report = true;
    a->has_value = value != NULL;
    a->value = value ? *value : 0;
    a->event = now;
    a->steps_done = c->done;
    a->late_steps = c->late;
    a->latest = c->latest;
    a->code = code;
    a->message = message;
    if (to)
        send_answer(to, a);
    if (status != STARTED) {
        c->held = false;
        a->command = NULL;
        a->ended = true;
        a->number = ++numbers;
        a->used = a->named;
    }
}

static struct answer *find_answer(const struct text *request_id)
{
    struct answer *a;
    for (a = answers; a < answers + sizeof answers / sizeof *answers; a++)
        if (a->used && a->named && same(&a->request_id, request_id))
            return a;
    return NULL;
}

/* Reports that the lease of a speed, which continued after its command, has ended. */
static void report_tail(const struct device *device, const struct tail *tail, const char *code, const char *message, int64_t now)
{
    struct answer *kept = tail->named ? find_answer(&tail->request_id) : NULL, a;
    struct link *to = link_of(tail->of_owner, tail->link);
    memset(&a, 0, sizeof a);
    a.used = a.ended = a.is_report = true;
    a.named = tail->named;
    a.request_id = tail->request_id;
    a.device_id = device->id;
    a.status = FAILED;
    a.event = now;
    a.steps_done = tail->steps_done;
    a.code = code;
    a.message = message;
    if (kept) {
        a.number = kept->number;
        a.began = kept->began;
        a.began_at = kept->began_at;
        memcpy(a.content_hash, kept->content_hash, sizeof a.content_hash);
        *kept = a;
    }
    if (to)
        send_answer(to, &a);
}

static bool goes_before(const struct command *a, const struct command *b)
{
    return a->start != b->start ? a->start < b->start : a->end != b->end ? a->end < b->end : a->number < b->number;
}

/* Ends the commands that start at `from` or later, in the order of their starts; `pending`: only those that have not begun. */
static void drop(struct device *device, int64_t from, bool pending, const char *code, const char *message, int64_t now)
{
    for (;;) {
        struct command *first = NULL;
        int i;
        for (i = 0; i < MAX_QUEUE; i++) {
            struct command *c = &device->commands[i];
            if (c->held && c->start >= from && !(pending && c->begun) && (!first || goes_before(c, first)))
                first = c;
        }
        if (!first)
            return;
        report(first, FAILED, NULL, code, message, now);
    }
}

static bool set(struct device *device, enum kind kind, double value)
{
    bool taken = arm_set((int)(device - devices), kind, value);
    device->where[kind] = value;
    if (kind == POSITION || value != 0)
        device->placed = kind == POSITION && taken;
    return taken;
}

static bool moves(const struct device *device, const struct command *c)
{
    return device->linear && c->script;
}

/* Sets a linear device to its value at the time `now`. */
static bool sample(struct device *device, struct command *c, int64_t now)
{
    const struct step *step = &c->steps[c->done];
    c->sampled = now;
    if (step->kind == c->from_kind && step->offset > c->from_offset) {
        double part = (double)(now - c->start - c->from_offset) / (double)(step->offset - c->from_offset);
        if (part <= 1) /* else the step itself is due */
            return set(device, step->kind, c->from_value + (step->value - c->from_value) * (part < 0 ? 0 : part));
    }
    return true;
}

/* Ends all commands: speeds go to zero, and a position is kept. With `home` the device goes to its default state. A device with an
   `acceleration` should slow down with it. */
static void rest(struct device *device, bool home, const char *code, const char *message, int64_t now)
{
    int i;
    home = home && device->has_default;
    for (i = 0; i < MAX_QUEUE && !home; i++) {
        struct command *c = &device->commands[i];
        if (c->held && c->begun && moves(device, c) && c->steps[c->done].kind == POSITION)
            sample(device, c, now);
    }
    for (i = SPEED; i <= ACCELERATION; i++)
        if (device->kinds[i].there && !(home && i == (int)device->primary))
            set(device, (enum kind)i, 0);
    if (home)
        set(device, device->primary, device->default_value);
    for (i = 0; i < KINDS; i++)
        device->tails[i].there = false;
    drop(device, -NEVER, false, code, message, now);
}

static const char RUNNING_ENDED[] = "the running lease ended", PENDING_ENDED[] = "the pending lease ended", BROKEN[] = "the hardware failed";

/* The lease of a running command, or of a speed that continues, has ended: everything ends. */
static void run_out(struct device *device, int64_t now)
{
    int i, j;
    for (i = 0; i < KINDS; i++) {
        const struct tail *tail = &device->tails[i];
        for (j = 0; j < i && !(device->tails[j].there && device->tails[j].command == tail->command); j++)
            ;
        if (tail->there && j == i)
            report_tail(device, tail, "link_lost", RUNNING_ENDED, now);
    }
    rest(device, false, "link_lost", RUNNING_ENDED, now);
}

static void tell_started(struct device *device, struct command *c, int64_t now)
{
    if (!c->started) {
        c->started = true;
        c->answer->began = true;
        c->answer->began_at = now;
        device->tails[c->steps[0].kind].there = false;
        report(c, STARTED, &c->steps[0].value, NULL, NULL, now);
    }
}

static int64_t lease_limit(double ms)
{
    return isnan(ms) ? NEVER : ms_to_ns(ms);
}

static int64_t after(int64_t from, int64_t limit)
{
    return limit == NEVER ? NEVER : from + limit;
}

static int64_t ends(const struct command *c, int64_t shift, int done, bool begun)
{
    const struct lease *lease = done && c->steps[done - 1].lease.form != NO_LEASE ? &c->steps[done - 1].lease : &c->lease;
    return after(c->heard + shift, lease_limit(begun ? lease->running : lease->pending));
}

/* If the lease that follows the next step would already have ended at that step, the step is not done. */
static int64_t lease_ends(const struct command *c, int64_t shift)
{
    int64_t at = c->start + (c->begun ? c->steps[c->done].offset : 0), now = ends(c, shift, c->done, c->begun);
    int64_t then = ends(c, shift, c->done + (c->begun || !c->steps[0].offset), true);
    then = then > at ? then : at;
    if (!c->begun && c->until < now)
        now = c->until;
    return now < then ? now : then;
}

static void leave_on(struct device *device, const struct command *c)
{
    int i;
    for (i = 0; i < c->size; i++) {
        struct tail *tail = &device->tails[c->steps[i].kind];
        tail->there = c->steps[i].kind != POSITION && device->where[c->steps[i].kind] != 0;
        tail->limit = ends(c, -c->heard, c->done, true);
        tail->there = tail->there && tail->limit != NEVER;
        tail->of_owner = c->of_owner;
        tail->link = c->link;
        tail->by = c->by;
        tail->command = c->number;
        tail->heard = c->heard;
        tail->steps_done = c->done;
        tail->named = c->answer->named;
        tail->request_id = c->answer->request_id;
    }
}

static void go_on(struct device *device, struct command *c, int64_t now)
{
    const struct step *step = &c->steps[c->done];
    if (!c->begun && now > c->start + LATE_START) {
        report(c, FAILED, NULL, "late", "the robot was delayed at the start", now);
    } else if (!c->begun) {
        c->begun = true;
        c->sampled = now;
        c->from_offset = 0;
        c->from_kind = step->kind;
        c->from_value = device->where[step->kind];
        if (moves(device, c) && step->offset > 0)
            tell_started(device, c, now);
    } else if (!set(device, step->kind, step->value)) {
        rest(device, false, "internal", BROKEN, now);
    } else {
        tell_started(device, c, now);
        device->tails[step->kind].there = false;
        c->late += now > c->start + step->offset + LATE_STEP;
        if (now - c->start - step->offset > c->latest)
            c->latest = now - c->start - step->offset;
        c->from_offset = step->offset;
        c->from_kind = step->kind;
        c->from_value = step->value;
        if (++c->done == c->size) {
            leave_on(device, c);
            report(c, OK, &step->value, NULL, NULL, now);
        }
    }
}

/* Runs the due actions in order of time; at the same instant, leases before steps. Returns when the next action is due. An ended lease
   of a running command comes first: a delayed program would otherwise do steps that were due before. */
static int64_t run(void)
{
    for (;;) {
        enum { LEASE, PENDING, STEP, MOVE } what = LEASE; /* in this order at the same instant */
        int64_t now = now_ns(), shift = now - silence_ns(), due = NEVER, at;
        struct device *device, *of = NULL;
        struct command *c, *with = NULL;
        int i;
        for (device = devices; device < devices + device_count; device++) {
            for (i = 0; i < KINDS; i++) {
                at = device->tails[i].there ? device->tails[i].heard + shift + device->tails[i].limit : NEVER;
                if (at <= now)
                    at = INT64_MIN;
                if (at < due || (at == due && at < NEVER && what != LEASE))
                    due = at, what = LEASE, of = device;
            }
            for (c = device->commands; c < device->commands + MAX_QUEUE; c++) {
                if (!c->held)
                    continue;
                at = lease_ends(c, shift);
                if (c->begun && at <= now)
                    at = INT64_MIN;
                if (at < due || (at == due && at < NEVER && what > (c->begun ? LEASE : PENDING)))
                    due = at, what = c->begun ? LEASE : PENDING, of = device, with = c;
                at = c->begun ? c->start + c->steps[c->done].offset : c->start;
                if (at < due || (at == due && (what == MOVE || (what == STEP && goes_before(c, with)))))
                    due = at, what = STEP, of = device, with = c;
                if (c->begun && moves(device, c) && c->sampled + SAMPLE < due)
                    due = c->sampled + SAMPLE, what = MOVE, of = device, with = c;
            }
        }
        if (due > now)
            return due;
        if (what == LEASE)
            run_out(of, now);
        else if (what == PENDING) /* commands that start then or later have not moved anything */
            drop(of, with->start, true, "link_lost", PENDING_ENDED, now);
        else if (what == STEP)
            go_on(of, with, now);
        else if (!sample(of, with, now))
            rest(of, false, "internal", BROKEN, now);
    }
}

/* Reading messages. `fault` is the error of a message. */

static const char *fault;

static bool text_of(int node, size_t least, struct text *to)
{
    size_t i, characters = 0;
    to->length = 0;
    if (json.nodes[node].type == JSON_STRING)
        for (i = 0; i < json.nodes[node].length; i++)
            characters += (json.nodes[node].text[i] & 0xc0) != 0x80;
    if (json.nodes[node].type != JSON_STRING || characters < least || characters > MAX_ID) {
        fault = "a value is no string, or of a wrong length";
        return false;
    }
    to->length = json.nodes[node].length;
    memcpy(to->bytes, json.nodes[node].text, to->length);
    return true;
}

static bool text_at(int object, const char *key, size_t least, struct text *to)
{
    int node = json_get(&json, object, key);
    to->length = 0;
    return node != JSON_NONE && text_of(node, least, to);
}

static bool number_at(int object, const char *key, double *to)
{
    int node = json_get(&json, object, key);
    if (node == JSON_NONE)
        return false;
    *to = json.nodes[node].number;
    if (json.nodes[node].type == JSON_NUMBER)
        return true;
    fault = "a value is no number";
    return false;
}

static bool period_at(int object, const char *key, double *to)
{
    if (!number_at(object, key, to))
        return false;
    if (!(*to >= 0 && *to <= 1e11))
        fault = "a number of milliseconds is not within 0 to 1e11";
    return !fault;
}

static bool boolean_at(int object, const char *key)
{
    int node = json_get(&json, object, key);
    if (node != JSON_NONE && json.nodes[node].type != JSON_TRUE && json.nodes[node].type != JSON_FALSE)
        fault = "a value is no boolean";
    return node != JSON_NONE && json.nodes[node].type == JSON_TRUE;
}

/* Reads as many digits as the pattern has 0, and its other characters. Returns the position after them. */
static const char *digits(const char *at, const char *end, const char *pattern, int *values)
{
    for (*values = 0; *pattern; pattern++, at++) {
        if (at == end)
            return NULL;
        if (*pattern == '0' && *at >= '0' && *at <= '9') {
            *values = *values * 10 + (*at - '0');
        } else if (*pattern != '0' && (*at == *pattern || (*pattern == 'T' && *at == 't'))) {
            if (pattern[1])
                *++values = 0;
        } else {
            return NULL;
        }
    }
    return at;
}

static bool timestamp_at(int object, const char *key, struct text *echo, int64_t *to)
{
    static const int days[] = {31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    int v[8] = {0}, offset[3] = {0}, fraction = 0, scale = 100000000, sign = 1, y, leap;
    const char *at, *end;
    int64_t seconds;
    if (!text_at(object, key, 0, echo))
        return false;
    end = echo->bytes + echo->length;
    at = digits(echo->bytes, end, "0000-00-00T00:00:00", v);
    if (at && at < end && *at == '.') {
        for (at++; at < end && *at >= '0' && *at <= '9' && scale; at++, scale /= 10)
            fraction += (*at - '0') * scale;
        if (at[-1] == '.')
            at = NULL;
    }
    if (at && at < end && (*at == 'Z' || *at == 'z')) {
        at++;
    } else if (at && at < end && (*at == '+' || *at == '-')) {
        sign = *at == '-' ? -1 : 1;
        at = digits(at + 1, end, "00:00", offset);
    } else {
        at = NULL;
    }
    leap = (v[0] % 4 == 0 && v[0] % 100 != 0) || v[0] % 400 == 0;
    if (at != end || v[1] < 1 || v[1] > 12 || v[2] < 1 || v[2] > days[v[1] - 1] + (v[1] == 2 && leap) || v[3] > 23
        || v[4] > 59 || v[5] > 59 || offset[0] > 23 || offset[1] > 59) {
        fault = "invalid timestamp, expected RFC 3339";
        return false;
    }
    y = v[0] - (v[1] < 3); /* years begin in March, so that a leap day is the last one */
    seconds = (int64_t)365 * y + y / 4 - y / 100 + y / 400 + (153 * (v[1] + (v[1] < 3 ? 9 : -3)) + 2) / 5 + v[2] - 1 - 719468;
    if (v[0] == 0)
        seconds = -719528; /* 1 January of the year 0: far enough */
    seconds = seconds * 86400 + v[3] * 3600 + v[4] * 60 + v[5] - sign * (offset[0] * 3600 + offset[1] * 60);
    if (seconds >= FAR / SECOND || seconds <= -FAR / SECOND) {
        fault = "a timestamp lies too far away";
        return false;
    }
    *to = seconds * SECOND + fraction;
    return true;
}

static void lease_at(int object, struct lease *to)
{
    int node = json_get(&json, object, "stop_condition");
    to->form = NO_LEASE;
    to->pending = to->running = (double)NAN;
    if (node == JSON_NONE)
        return;
    if (json.nodes[node].type == JSON_OBJECT) {
        to->form = TWO_LEASES;
        period_at(node, "pending", &to->pending);
        period_at(node, "running", &to->running);
    } else {
        to->form = ONE_LEASE;
        period_at(object, "stop_condition", &to->pending);
        to->running = to->pending;
    }
}

/* Counts control_value, control_value_2 ... and returns the first of them. */
static int values_at(int object, double *first)
{
    int at, most = number_at(object, "control_value", first), count = most;
    for (at = json.nodes[object].first; at != JSON_NONE; at = json.nodes[at].next) {
        const char *key = json.nodes[at].text;
        size_t length = json.nodes[at].length, i;
        int n = 0;
        if (length < 14 || memcmp(key, "control_value_", 14) != 0 || json.nodes[json.nodes[at].first].type == JSON_NULL)
            continue;
        for (i = 14; i < length && i < 17 && key[i] >= '0' && key[i] <= '9'; i++)
            n = n * 10 + (key[i] - '0');
        if (i < length || n < 2 || n > 256 || key[14] == '0')
            fault = "control_value_N is of a wrong N";
        if (json.nodes[json.nodes[at].first].type != JSON_NUMBER)
            fault = "a value is no number";
        most = n > most ? n : most;
        count++;
    }
    if (!count || count != most)
        fault = "control_value is missing or has gaps";
    return count;
}

static bool is(const struct text *text, const char *word)
{
    return text->length == strlen(word) && !memcmp(text->bytes, word, text->length);
}

/* OTHER for custom_N, and for names that the protocol does not define: no device here supports them. */
static enum kind kind_of(const struct text *name)
{
    int i;
    for (i = 0; i < KINDS; i++)
        if (is(name, KIND_NAMES[i]))
            return (enum kind)i;
    return OTHER;
}

/* A well-formed control request. */
struct request {
    struct text device_id, request_id, session, timestamp, control_type;
    bool named, has_session, has_sent, has_start, home, script, sensor, unknown; /* unknown: not a control type of the protocol */
    enum kind kind;            /* unless it is a script or a sensor */
    int64_t sent, start, until;
    char content_hash[65];
    struct lease lease;
    int size;                  /* of a script; may exceed MAX_STEPS */
    int values;                /* largest number of values in one of the first MAX_STEPS steps */
    struct step steps[MAX_STEPS];
    int step_values[MAX_STEPS];
};

static struct request request;

static void read_request(int body)
{
    struct request *r = &request;
    struct text hash, type;
    int value = json_get(&json, body, "control_value"), i, item;
    double offset = 0;
    if (!text_at(body, "device_id", 1, &r->device_id) || !text_at(body, "control_type", 0, &r->control_type))
        fault = "device_id or control_type is missing or no string of 1 to 256 characters";
    r->named = text_at(body, "request_id", 0, &r->request_id);
    r->has_session = text_at(body, "session", 1, &r->session);
    if (!timestamp_at(body, "pending_until", &r->timestamp, &r->until))
        r->until = NEVER;
    r->has_sent = timestamp_at(body, "timestamp", &r->timestamp, &r->sent);
    r->has_start = period_at(body, "time_offset_to_start", &offset) && r->has_sent;
    r->start = r->has_start ? r->sent + ms_to_ns(offset) : 0;
    r->home = boolean_at(body, "home");
    lease_at(body, &r->lease);
    r->content_hash[0] = '\0';
    if (text_at(body, "content_hash", 0, &hash)) {
        for (i = 0; i < 64 && hash.length == 64 && strchr("0123456789abcdefABCDEF", hash.bytes[i]) && hash.bytes[i]; i++)
            r->content_hash[i] = (char)(hash.bytes[i] | 0x20); /* digits have this bit already */
        r->content_hash[i] = '\0';
        if (i < 64)
            fault = "invalid content_hash, expected 64 hexadecimal digits";
    }
    r->script = is(&r->control_type, "script");
    r->sensor = is(&r->control_type, "sensor");
    r->unknown = false;
    r->size = 1;
    if (r->sensor || r->script) {
        r->size = 0;
        if (r->script && (value == JSON_NONE || json.nodes[value].type != JSON_LIST))
            fault = "control_value is no list of steps";
        for (item = json.nodes[body].first; r->script && item != JSON_NONE; item = json.nodes[item].next)
            if (json.nodes[item].length >= 14 && !memcmp(json.nodes[item].text, "control_value_", 14)
                && json.nodes[json.nodes[item].first].type != JSON_NULL)
                fault = "only custom types take several values";
    } else {
        r->steps[0].ms = 0;
        r->steps[0].offset = 0;
        r->steps[0].kind = r->kind = kind_of(&r->control_type);
        r->steps[0].lease.form = NO_LEASE;
        r->unknown = r->kind == OTHER && (r->control_type.length < 8 || memcmp(r->control_type.bytes, "custom_", 7) != 0);
        r->step_values[0] = r->unknown ? 0 : values_at(body, &r->steps[0].value); /* any value is accepted for an unknown type */
    }
    if (!r->script || fault)
        return;
    for (item = json.nodes[value].first; item != JSON_NONE && !fault; item = json.nodes[item].next) {
        struct step step;
        int count;
        if (json.nodes[item].type != JSON_OBJECT) {
            fault = "a step is no object";
            return;
        }
        if (!period_at(item, "time_offset_to_start", &step.ms) || !text_at(item, "control_type", 0, &type)) {
            fault = "a step lacks its time or its control type";
            return;
        }
        if (item != json.nodes[value].first && step.ms < offset)
            fault = "a step lies before the one ahead of it";
        offset = step.ms;
        step.offset = ms_to_ns(step.ms);
        step.kind = kind_of(&type);
        if (is(&type, "script") || is(&type, "sensor"))
            fault = "a step is no script and no sensor";
        lease_at(item, &step.lease);
        count = values_at(item, &step.value);
        if (r->size < MAX_STEPS) {
            r->steps[r->size] = step;
            r->step_values[r->size] = count;
        }
        r->size++;
    }
}

/* Hashes the bytes as received: a server that sends content_hash writes them in the canonical form. */
static void hash_request(int body, char *hex)
{
    struct sha256 sha;
    unsigned char digest[SHA256_BYTES];
    int n;
    sha256_start(&sha);
    for (n = 1; n <= 256; n++) {
        char key[20];
        int node;
        sprintf(key, n == 1 ? "control_value" : "control_value_%d", n);
        node = json_get(&json, body, key);
        if (node == JSON_NONE)
            break;
        if (n == 1 && json_get(&json, body, "control_value_2") != JSON_NONE)
            sha256_add(&sha, "[", 1);
        if (n > 1)
            sha256_add(&sha, ",", 1);
        sha256_add(&sha, json.nodes[node].text, json.nodes[node].length);
    }
    if (n > 2)
        sha256_add(&sha, "]", 1);
    sha256_end(&sha, digest);
    hex_of(digest, sizeof digest, hex);
}

/* Checks. */

static bool within(const struct limits *limits, double value)
{
    return !limits->there || (value >= limits->min && value <= limits->max);
}

static bool multiple(const struct limits *limits, double value)
{
    double steps = value / limits->granularity;
    return !limits->there || fabs(steps - floor(steps + 0.5)) <= 1e-6;
}

static bool refuse(struct answer *a, const char *code, const char *message)
{
    a->code = code;
    a->message = message;
    return true;
}

/* The first check that fails, from the fourth check of the protocol on, in its order. */
static bool refused(const struct request *r, struct device *device, int body, int64_t now, struct answer *a)
{
    char hex[65];
    int64_t start = r->has_start ? r->start : now, end;
    const struct limits *own;
    int i, held = 0;
    if (!device)
        return refuse(a, "unknown_device", "the robot has no such device");
    if (r->content_hash[0] && !r->sensor && !r->unknown) {
        hash_request(body, hex);
        if (strcmp(hex, r->content_hash) != 0)
            return refuse(a, "malformed", "content_hash is not that of control_value");
    }
    if (r->script && !r->size)
        return false;
    if (r->script ? !device->script.there : r->sensor ? !device->sensor : r->kind == OTHER || !device->kinds[r->kind].there)
        return refuse(a, "unsupported_control_type", "the device has no such control type");
    if (r->sensor)
        return false;
    if (r->script && r->size > device->max_steps)
        return refuse(a, "too_many_steps", "the script has more steps than max_number_of_steps");
    own = r->script ? &device->script : &device->kinds[r->kind];
    for (i = 0; i < r->size; i++) {
        const struct step *step = &r->steps[i];
        if (r->script && (step->kind == OTHER || !device->usable[step->kind]))
            return refuse(a, "unsupported_control_type", "a step is of a control type that the device's scripts cannot use");
        if (r->step_values[i] > 1)
            return refuse(a, "malformed", "only custom types take several values");
        if (!within(&device->kinds[step->kind], step->value) || !within(own, step->value))
            return refuse(a, "out_of_range", "the value lies outside min_value to max_value");
        if (!multiple(&device->kinds[step->kind], step->value) || !multiple(own, step->value))
            return refuse(a, "off_granularity", "the value is no multiple of granularity");
    }
    if (start < now)
        return refuse(a, "late", "the start has passed");
    if (r->until <= now)
        return refuse(a, "late", "pending_until has passed");
    if (r->has_sent && r->sent <= device->taken_back)
        return refuse(a, "cancelled", "the command was cancelled by a stop that arrived before it");
    end = start + r->steps[r->size - 1].offset;
    for (i = 0; i < MAX_QUEUE; i++) {
        const struct command *other = &device->commands[i];
        held += other->held;
        if (other->held && start < other->end && other->start < end)
            return refuse(a, "overlap", "the device is not free all that time");
    }
    if (held >= device->queue)
        return refuse(a, "busy", "the device holds as many commands as script_queue says");
    return false;
}

/* Ownership of the robot. */

/* A session belongs to the operator name that claimed it. */
static bool owns(const struct link *link, const struct text *session)
{
    return same(session, &owner) && link->sealed.name_length == owner_name_length
        && !memcmp(link->sealed.name, owner_name, owner_name_length);
}

static void release(void)
{
    int i;
    owned = false;
    for (i = 0; i < MAX_LINKS; i++)
        links[i].of_owner = false;
}

/* Whether the robot runs or holds a command. A session that is over at this time loses the robot. */
static bool is_busy(void)
{
    bool busy = false, open = false;
    struct device *device;
    int i;
    for (device = devices; device < devices + device_count; device++) {
        for (i = 0; i < KINDS; i++)
            busy = busy || device->tails[i].there;
        for (i = 0; i < MAX_QUEUE; i++)
            busy = busy || device->commands[i].held;
    }
    for (i = 0; i < MAX_LINKS; i++)
        open = open || (links[i].socket >= 0 && links[i].of_owner);
    if (owned && !busy && (!open || silence_ns() - owner_heard >= SILENCE))
        release();
    return busy;
}

/* Renews leases and determines the owner; false if another session owns the robot. */
static bool hear(struct link *link, const struct text *session, bool claims)
{
    int64_t now = silence_ns(), received = now_ns();
    bool renews;
    struct device *device;
    int i;
    is_busy();
    if (session && claims && !owned) {
        owned = true;
        owner = *session;
        owner_name_length = link->sealed.name_length;
        memcpy(owner_name, link->sealed.name, owner_name_length);
        for (device = devices; device < devices + device_count; device++) /* stops by strangers may have named a future time */
            device->taken_back = device->taken_back < received ? device->taken_back : received;
    }
    if (session) /* a message without a session belongs to the session that its connection named last */
        link->of_owner = owned && owns(link, session);
    link->heard = now;
    link->spoken = true;
    renews = link->of_owner && (!session || owns(link, session));
    if (renews) {
        owner_heard = now;
        owner_claim = link->sealed.claim;
    }
    for (device = devices; device < devices + device_count; device++) {
        for (i = 0; i < KINDS; i++)
            if (device->tails[i].of_owner ? renews : device->tails[i].link == link->number)
                device->tails[i].heard = now;
        for (i = 0; i < MAX_QUEUE; i++)
            if (device->commands[i].of_owner ? renews : device->commands[i].link == link->number)
                device->commands[i].heard = now;
    }
    return !owned || (session && owns(link, session));
}

static const char *busy_message(void)
{
    static char message[sizeof robot_id.bytes + 64]; /* without the session's name, which is a secret */
    snprintf(message, sizeof message, "`%.*s` belongs to another session until that session ends", (int)robot_id.length, robot_id.bytes);
    return message;
}

/* Why something ended. Answers keep the text, so there is one per operator, for the last AUTHORS of them. */
static const char *done_by(const char *what, const struct link *link)
{
    static char authors[AUTHORS][SEALED_NAME + 32];
    static int next;
    char text[SEALED_NAME + 32];
    int i;
    snprintf(text, sizeof text, "%s by operator %.*s", what, (int)link->sealed.name_length, link->sealed.name);
    for (i = 0; i < AUTHORS; i++)
        if (!strcmp(authors[i], text))
            return authors[i];
    i = next++ % AUTHORS;
    return strcpy(authors[i], text);
}

/* An operator with the role seize takes the robot from others: their commands end, and it comes to rest. */
static void take_from_others(struct link *link, const struct text *session)
{
    bool busy = is_busy();
    const char *why;
    int64_t now = now_ns();
    int i;
    if (owned ? owns(link, session) : !busy)
        return;
    why = done_by("taken", link);
    fprintf(stderr, "%s\n", why);
    for (i = 0; i < device_count; i++)
        rest(&devices[i], false, "cancelled", why, now);
    release();
}

static struct answer *new_answer(void)
{
    struct answer *oldest = NULL, *a;
    for (a = answers; a < answers + sizeof answers / sizeof *answers; a++) {
        if (!a->used)
            return a;
        if (a->ended && (!oldest || a->number < oldest->number))
            oldest = a;
    }
    return oldest; /* never NULL: there are KEPT more entries than commands */
}

/* Whether the request just read stops its device at once. */
static bool stops(void)
{
    return request.script && !request.size && !request.has_start && !request.home;
}

static void control(struct link *link, int body, int64_t heard, int64_t now)
{
    const char *why = "cancelled by an empty script";
    struct request *r = &request;
    struct answer *place = NULL, passing;
    struct device *device = NULL;
    struct command *c = NULL;
    bool mine, reads;
    int i;
    for (i = 0; i < device_count; i++)
        if (same(&devices[i].id, &r->device_id))
            device = &devices[i];
    reads = r->sensor && device && device->sensor; /* any server may read a sensor, without claiming the robot */
    mine = hear(link, r->has_session ? &r->session : NULL, !reads);
    if (r->named && (place = find_answer(&r->request_id)) != NULL) {
        send_answer(link, place);
        return;
    }
    memset(&passing, 0, sizeof passing);
    passing.used = passing.ended = true;
    passing.named = r->named;
    passing.request_id = r->request_id;
    passing.device_id = r->device_id;
    passing.status = FAILED;
    if (!mine && !reads && !(stops() && !r->has_session && link->sealed.roles & ROLE_STOP)) {
        refuse(&passing, "busy", busy_message());
        send_answer(link, &passing);
        return;
    }
    if (secured && r->script && !r->size)
        why = done_by("stopped", link);
    if (refused(r, device, body, now, &passing)) {
        if (!strcmp(passing.code, "unsupported_control_type"))
            rest(device, true, "cancelled", "default state after an unsupported control type", now);
    } else if (r->sensor) {
        if (arm_read((int)(device - devices), &passing.value) && isfinite(passing.value)) {
            passing.status = PROVIDE;
            passing.has_value = true;
        } else {
            refuse(&passing, "internal", "no reading");
        }
    } else if (!r->size) {
        if (r->has_start && r->start > now) {
            drop(device, r->start, true, "cancelled", why, now);
        } else {
            if (r->has_sent) { /* limited to FUTURE, so that a wrong clock does not block a device for good */
                int64_t until = r->sent < now + FUTURE ? r->sent : now + FUTURE;
                device->taken_back = until > device->taken_back ? until : device->taken_back;
            }
            rest(device, r->home, "cancelled", why, now);
        }
        passing.status = OK;
    } else {
        for (c = device->commands; c->held; c++)
            ;
        memset(c, 0, offsetof(struct command, steps));
        c->held = true;
        c->script = r->script;
        c->of_owner = r->has_session;
        c->link = link->number;
        c->by = link->sealed.claim;
        c->number = ++numbers;
        memcpy(c->content_hash, r->content_hash, sizeof c->content_hash);
        c->lease = r->lease;
        c->start = r->has_start ? r->start : now;
        c->end = c->start + r->steps[r->size - 1].offset;
        c->heard = heard;
        c->until = r->until;
        c->size = r->size;
        memcpy(c->steps, r->steps, (size_t)r->size * sizeof *r->steps);
        passing.status = ACCEPTED;
        passing.ended = false;
        passing.command = c;
        memcpy(passing.content_hash, c->content_hash, sizeof passing.content_hash);
        passing.has_value = !r->script;
        passing.value = r->steps[0].value;
    }
    passing.number = ++numbers;
    if (r->named || c) {
        place = new_answer();
        *place = passing;
        if (c)
            c->answer = place;
    }
    send_answer(link, &passing);
}

/* Begins an availability response or an inquiry response with its clock and status. */
static void begin_clock(struct link *link, const char *name, int64_t received, const struct text *sent, const char *code,
    const char *message)
{
    int64_t now = now_ns();
    put(link, "{\"%s\":{", name);
    if (sent) {
        put(link, "\"originate_timestamp\":");
        put_text(link, sent->bytes, sent->length);
        put(link, ",");
    }
    put(link, "\"receive_timestamp\":");
    put_stamp(link, received);
    put(link, ",\"timestamp\":");
    put_stamp(link, now > received ? now : received);
    put(link, ",\"status\":\"%s\"", code ? "Failed" : "OK");
    if (code)
        put_error(link, code, message);
}

static void availability(struct link *link, int64_t received, const struct text *sent, const char *code, const char *message)
{
    begin_clock(link, "availability_response", received, sent, code, message);
    send_end(link);
}

/* The state of one request. A held or running request is a command; an ended one is only its last answer. */
static void put_request(struct link *link, const struct text *request_id)
{
    const struct answer *a = find_answer(request_id);
    const struct command *c = a ? a->command : NULL;
    put(link, "{\"request_id\":");
    put_text(link, request_id->bytes, request_id->length);
    put(link, ",\"state\":\"%s\"", !a ? "unknown" : !c ? "ended" : c->begun ? "running" : "held");
    if (a && a->content_hash[0])
        put(link, ",\"content_hash\":\"%s\"", a->content_hash);
    if (c) {
        put(link, ",\"start_timestamp\":");
        put_stamp(link, c->start);
    }
    if (a && a->began) {
        put(link, ",\"event_timestamp\":");
        put_stamp(link, a->began_at);
    }
    if (a && (c ? c->begun : a->is_report))
        put(link, ",\"steps_done\":%d", c ? c->done : a->steps_done);
    if (a && !c && a->is_report && a->status == OK)
        put_late(link, a);
    if (a && !c && a->status == FAILED)
        put_error(link, a->code, a->message);
    put(link, "}");
}

static void put_room(struct link *link, const struct device *device)
{
    int i, room = device->queue;
    for (i = 0; i < MAX_QUEUE; i++)
        room -= device->commands[i].held;
    put(link, "{\"device_id\":");
    put_text(link, device->id.bytes, device->id.length);
    put(link, ",\"room\":%d", room);
    if (device->placed) {
        put(link, ",\"position\":");
        put_number(link, device->where[POSITION]);
    }
    put(link, "}");
}

/* Whether a list of an inquiry is missing or contains only names. */
static bool names_at(int body, const char *key, size_t least)
{
    int list = json_get(&json, body, key), item;
    static struct text name;
    if (list == JSON_NONE)
        return true;
    if (json.nodes[list].type != JSON_LIST)
        fault = "requests and devices are lists";
    else if (json.nodes[list].size > MAX_NAMES)
        fault = "the inquiry names more than this robot takes";
    for (item = json.nodes[list].first; !fault && item != JSON_NONE; item = json.nodes[item].next)
        text_of(item, least, &name);
    return !fault;
}

/* A command of this connection's session, or one without a session from this connection, may wait for its start for at most `limit`
   while the server is silent, and at most until `until`. `limit` may be NaN and `until` NEVER, for no limit. */
static void shorten(struct link *link, const struct text *request_id, bool has_session, double limit, int64_t until)
{
    struct device *device;
    struct answer *a = find_answer(request_id);
    int i;
    for (device = devices; a && device < devices + device_count; device++)
        for (i = 0; i < MAX_QUEUE; i++) {
            struct command *c = &device->commands[i];
            if (!c->held || c->answer != a || c->begun || (c->of_owner ? !has_session : c->link != link->number))
                continue;
            if (isnan(c->lease.pending) || limit < c->lease.pending)
                c->lease.pending = limit;
            if (until != NEVER)
                c->until = until;
        }
}

/* An inquiry changes only leases. */
static void inquire(struct link *link, int body, int64_t received, bool mine, const struct text *sent, bool has_session)
{
    int item, requests = json_get(&json, body, "requests"), asked = json_get(&json, body, "devices"), i, count = 0;
    static struct text name;
    double limit;
    int64_t until;
    if (!period_at(body, "pending_lease", &limit))
        limit = (double)NAN;
    if (!timestamp_at(body, "pending_until", &name, &until))
        until = NEVER;
    begin_clock(link, "inquiry_response", received, sent, mine ? NULL : "busy", mine ? NULL : busy_message());
    put(link, ",\"requests\":[");
    item = mine && requests != JSON_NONE ? json.nodes[requests].first : JSON_NONE;
    for (; item != JSON_NONE; item = json.nodes[item].next) {
        put(link, count++ ? "," : "");
        text_of(item, 0, &name);
        put_request(link, &name);
    }
    put(link, "],\"devices\":[");
    item = mine && asked != JSON_NONE ? json.nodes[asked].first : JSON_NONE;
    for (count = 0; item != JSON_NONE; item = json.nodes[item].next) {
        text_of(item, 1, &name);
        for (i = 0; i < device_count; i++)
            if (same(&devices[i].id, &name)) {
                put(link, count++ ? "," : "");
                put_room(link, &devices[i]);
            }
    }
    put(link, "]");
    send_end(link);
    item = mine && requests != JSON_NONE ? json.nodes[requests].first : JSON_NONE;
    for (; item != JSON_NONE; item = json.nodes[item].next) {
        text_of(item, 0, &name);
        shorten(link, &name, has_session, limit, until);
    }
}

static void malformed(struct link *link, int64_t received, int body, const char *message)
{
    static struct answer a;
    fault = NULL;
    memset(&a, 0, sizeof a);
    a.status = FAILED;
    refuse(&a, "malformed", message);
    if (body != JSON_NONE && text_at(body, "device_id", 1, &a.device_id)) {
        a.named = text_at(body, "request_id", 0, &a.request_id);
        send_answer(link, &a);
    } else {
        availability(link, received, NULL, a.code, message);
    }
}

/* Whether the peer has one of these roles; else `message` names the missing role. Called before the message renews or claims anything. */
static bool permits(struct link *link, unsigned needed, char *message, size_t room)
{
    char own[64], takes[64], *comma;
    const char *has;
    if (!secured || link->sealed.roles & needed)
        return true;
    sealed_roles(link->sealed.roles, own);
    has = !own[0] ? "no role" : strchr(own, ',') ? "the roles " : "the role ";
    sealed_roles(needed, takes);
    while ((comma = strstr(takes, ", ")) != NULL) {
        memmove(comma + 4, comma + 2, strlen(comma + 2) + 1);
        memcpy(comma, " or ", 4);
    }
    snprintf(message, room, "operator %.*s has %s%s, but this requires the role %s", (int)link->sealed.name_length,
        link->sealed.name, has, own, takes);
    fprintf(stderr, "refused: %s\n", message);
    return false;
}

static void forbid_control(struct link *link, const char *message)
{
    static struct answer a;
    memset(&a, 0, sizeof a);
    a.named = request.named;
    a.request_id = request.request_id;
    a.device_id = request.device_id;
    a.status = FAILED;
    refuse(&a, "forbidden", message);
    send_answer(link, &a);
}

static void forbid_inquiry(struct link *link, int64_t received, const struct text *sent, const char *message)
{
    begin_clock(link, "inquiry_response", received, sent, "forbidden", message);
    put(link, ",\"requests\":[],\"devices\":[]");
    send_end(link);
}

static void take(struct link *link, char *line, size_t length, int64_t received)
{
    static char message[SEALED_NAME + 160];
    int name, body;
    bool control_request, ping, inquiry, mine, has_sent, has_session, seize;
    double limit;
    static struct text sent, session, until;
    int64_t at;
    if (!json_read(&json, line, length)) {
        malformed(link, received, JSON_NONE, json.error);
        return;
    }
    if (json.nodes[0].type != JSON_OBJECT || json.nodes[0].size != 1) {
        malformed(link, received, JSON_NONE, "a message is an object with one key");
        return;
    }
    name = json.nodes[0].first;
    body = json.nodes[name].first;
    control_request = json_is(&json, name, "control_request");
    ping = json_is(&json, name, "availability_request");
    inquiry = json_is(&json, name, "inquiry");
    fault = json.fault;
    if (!fault && (json_is(&json, name, "availability_response") || json_is(&json, name, "initialization_block")
        || json_is(&json, name, "control_response") || json_is(&json, name, "inquiry_response")))
        return;
    if (!control_request && !ping && !inquiry && !json_is(&json, name, "initialization_request"))
        fault = "no such message";
    else if (json.nodes[body].type != JSON_OBJECT)
        fault = "a message's content is an object";
    else if (!fault && control_request)
        read_request(body);
    if (fault) {
        malformed(link, received, control_request ? body : JSON_NONE, fault);
        return;
    }
    if (control_request) {
        unsigned needed = request.sensor ? ROLE_OBSERVE | ROLE_DRIVE : stops() ? ROLE_STOP | ROLE_DRIVE : ROLE_DRIVE;
        if (!permits(link, needed, message, sizeof message)) {
            forbid_control(link, message);
            return;
        }
        at = silence_ns(); /* before the other clock is read, so that a lease of 0 ends before commands that begin at once */
        control(link, body, at, now_ns());
        return;
    }
    has_sent = timestamp_at(body, "timestamp", &sent, &at);
    has_session = (ping || inquiry) && text_at(body, "session", 1, &session);
    seize = ping && boolean_at(body, "seize");
    if (inquiry && names_at(body, "requests", 0) && names_at(body, "devices", 1)
        && (period_at(body, "pending_lease", &limit) || !fault))
        timestamp_at(body, "pending_until", &until, &at);
    if (fault) {
        malformed(link, received, JSON_NONE, fault);
        return;
    }
    if (seize && !has_session) {
        malformed(link, received, JSON_NONE, "`seize` requires a `session`");
        return;
    }
    if (seize && !secured) { /* it would take a robot from another session without proof of identity */
        availability(link, received, has_sent ? &sent : NULL, "forbidden", "the robot can be seized only by an operator with the role seize; this connection has not proven any role");
        return;
    }
    if (!permits(link, has_session ? ROLE_DRIVE : inquiry ? ROLE_OBSERVE | ROLE_DRIVE : ROLE_OBSERVE | ROLE_DRIVE | ROLE_STOP,
            message, sizeof message)) {
        if (inquiry)
            forbid_inquiry(link, received, has_sent ? &sent : NULL, message);
        else
            availability(link, received, has_sent ? &sent : NULL, "forbidden", message);
        return;
    }
    if (seize && !permits(link, ROLE_SEIZE, message, sizeof message)) {
        availability(link, received, has_sent ? &sent : NULL, "forbidden", message);
        return;
    }
    if (seize)
        take_from_others(link, &session);
    mine = hear(link, has_session ? &session : NULL, !inquiry);
    if (inquiry) {
        inquire(link, body, received, mine, has_sent ? &sent : NULL, has_session);
    } else if (mine || !has_session) {
        if (ping) {
            availability(link, received, has_sent ? &sent : NULL, NULL, NULL);
        } else {
            put(link, "{\"initialization_block\":");
            put_bytes(link, BLOCK, sizeof BLOCK - 1);
            put(link, "}\n");
            link_flush(link);
        }
    } else {
        availability(link, received, has_sent ? &sent : NULL, "busy", busy_message());
    }
}

/* Connections. */

static void link_lines(struct link *link)
{
    int64_t received = now_ns();
    size_t from = 0;
    int turn;
    for (turn = 0; turn < 50 && !link->dead && link->out_length < MAX_UNREAD; turn++) {
        char *line = link->in + from, *end = memchr(line, '\n', link->in_length - from);
        size_t length;
        if (!end)
            break;
        length = (size_t)(end - line);
        from += length + 1;
        while (length && strchr(" \t\r", line[length - 1]) && line[length - 1])
            length--;
        run(); /* handles actions that were due before the message */
        if (link->skipping)
            link->skipping = false;
        else if (length > MAX_LINE)
            malformed(link, received, JSON_NONE, "the line is too long");
        else if (length)
            take(link, line, length, received);
    }
    link->in_length -= from;
    memmove(link->in, link->in + from, link->in_length);
    if (from)
        link->begun = 0;
    link->more = link->in_length && memchr(link->in, '\n', link->in_length);
    if (link->in_length > MAX_LINE && !link->more) {
        if (!link->skipping)
            malformed(link, received, JSON_NONE, "the line is too long");
        link->skipping = true;
        link->in_length = 0;
    }
    if (!link->begun && (link->in_length || link->skipping) && !link->more)
        link->begun = silence_ns();
}

/* Whether a peer takes too long for its first message, or, if it does not own the robot, to complete a message. */
static bool is_slow(const struct link *link)
{
    int64_t now = silence_ns();
    if (!link->spoken)
        return now - link->heard > FIRST;
    return link->begun && !link->of_owner && now - link->begun > BEGUN;
}

/* Handles the content of records after the peer has proven its identity. */
static void link_open(struct link *link)
{
    static char answer[SEALED_LINE + 1];
    unsigned char nonce[SEALED_NONCE];
    struct sealed *s = &link->sealed;
    int got = 0;
    answer[0] = '\0';
    while (s->stage != SEALED_OPEN && !link->dead) {
        size_t before = s->raw_length;
        bool good = sealed_random(nonce, sizeof nonce) && sealed_greet(&key, s, time(NULL), nonce, answer);
        put_bytes(link, answer, strlen(answer));
        link->ready = link->out_length;
        link_flush(link);
        if (!good) {
            fprintf(stderr, "a peer was disconnected because it did not prove its identity\n");
            link->dead = true;
        }
        if (s->raw_length == before)
            return;
    }
    while (!link->dead && (got = sealed_open(s, link->in + link->in_length, sizeof link->in - 1 - link->in_length)) > 0)
        link->in_length += (size_t)got;
    if (got < 0) {
        fprintf(stderr, "a connection was closed because its data was altered, repeated or reordered\n");
        link->dead = true;
    }
}

static void link_read(struct link *link)
{
    char *to = secured ? (char *)link->sealed.raw : link->in;
    size_t *length = secured ? &link->sealed.raw_length : &link->in_length;
    size_t room = (secured ? sizeof link->sealed.raw : sizeof link->in - 1) - *length;
    ssize_t got = room ? recv(link->socket, to + *length, room < 16384 ? room : 16384, 0) : -1;
    if (!room)
        return;
    if (got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR))
        link->dead = true;
    else if (got > 0)
        *length += (size_t)got;
}

static void link_close(struct link *link)
{
    close(link->socket);
    link->socket = -1;
    link->of_owner = false;
}

/* Reads the list of revoked passes again if its file has changed. */
static void refresh_revoked(void)
{
    static struct stat last;
    struct stat seen;
    if (!revoked || stat(revoked, &seen) < 0)
        memset(&seen, 0, sizeof seen);
    if (seen.st_ino == last.st_ino && seen.st_size == last.st_size && seen.st_ctim.tv_sec == last.st_ctim.tv_sec
        && seen.st_ctim.tv_nsec == last.st_ctim.tv_nsec)
        return;
    last = seen;
    if (!sealed_read_revoked(&key, revoked))
        fprintf(stderr, "the previous list of revoked passes remains in use\n");
}

/* Once per second, applies a new list of revoked passes, and ends what the robot holds for passes that are not valid. */
static void end_invalid(void)
{
    static int64_t next;
    const char *owners, *why;
    struct device *device;
    struct link *link;
    int i;
    if (!secured || silence_ns() < next)
        return;
    next = silence_ns() + SECOND;
    refresh_revoked();
    owners = owned ? sealed_invalid(&key, &owner_claim, time(NULL)) : NULL;
    for (device = devices; device < devices + device_count; device++) {
        why = owners;
        for (i = 0; i < KINDS && !why; i++)
            if (device->tails[i].there && !device->tails[i].of_owner)
                why = sealed_invalid(&key, &device->tails[i].by, time(NULL));
        for (i = 0; i < MAX_QUEUE && !why; i++)
            if (device->commands[i].held && !device->commands[i].of_owner)
                why = sealed_invalid(&key, &device->commands[i].by, time(NULL));
        if (why)
            rest(device, false, "forbidden", why, now_ns());
    }
    if (owners)
        release();
    for (link = links; link < links + MAX_LINKS; link++) {
        why = link->socket >= 0 && link->sealed.stage == SEALED_OPEN ? sealed_invalid(&key, &link->sealed.claim, time(NULL)) : NULL;
        if (why) {
            fprintf(stderr, "the connection of operator %.*s is closed: %s\n", (int)link->sealed.name_length, link->sealed.name, why);
            link_close(link);
        }
    }
}

/* Disconnects a stranger for a new one: one that has sent no message, or else the one that has been silent for longest. */
static void make_room(void)
{
    struct link *link, *least = NULL;
    int strangers = 0;
    for (link = links; link < links + MAX_LINKS; link++) {
        if (link->socket < 0 || link->of_owner)
            continue;
        strangers++;
        if (!least || (link->spoken != least->spoken ? !link->spoken : link->heard < least->heard))
            least = link;
    }
    if (strangers >= STRANGERS)
        link_close(least);
}

static void link_accept(int listener)
{
    int socket = accept(listener, NULL, NULL), one = 1, i;
    if (socket < 0)
        return;
    refresh_revoked();
    make_room();
    for (i = 0; i < MAX_LINKS && links[i].socket >= 0; i++)
        ;
    if (i == MAX_LINKS || fcntl(socket, F_SETFL, O_NONBLOCK) < 0) {
        close(socket);
        return;
    }
    setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    setsockopt(socket, SOL_SOCKET, SO_KEEPALIVE, &one, sizeof one);
    memset(&links[i], 0, offsetof(struct link, in));
    links[i].socket = socket;
    links[i].number = ++numbers;
    links[i].heard = silence_ns();
}

static int listen_at(const char *address)
{
    char host[256], bound[64], service[16];
    const char *colon = strrchr(address, ':');
    struct addrinfo hints, *found;
    struct sockaddr_storage at;
    socklen_t size = sizeof at;
    int listener, one = 1;
    if (!colon || (size_t)(colon - address) >= sizeof host)
        return -1;
    memcpy(host, address, (size_t)(colon - address));
    host[colon - address] = '\0';
    memset(&hints, 0, sizeof hints);
    hints.ai_socktype = SOCK_STREAM;
    hints.ai_flags = AI_PASSIVE;
    if (getaddrinfo(host[0] ? host : NULL, colon + 1, &hints, &found) != 0)
        return -1;
    listener = socket(found->ai_family, found->ai_socktype, found->ai_protocol);
    if (listener >= 0) {
        setsockopt(listener, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
        if (bind(listener, found->ai_addr, found->ai_addrlen) < 0 || listen(listener, MAX_LINKS) < 0
            || fcntl(listener, F_SETFL, O_NONBLOCK) < 0 || getsockname(listener, (struct sockaddr *)&at, &size) < 0
            || getnameinfo((struct sockaddr *)&at, size, bound, sizeof bound, service, sizeof service,
                NI_NUMERICHOST | NI_NUMERICSERV) != 0) {
            close(listener);
            listener = -1;
        }
    }
    freeaddrinfo(found);
    if (listener >= 0) {
        printf("listening on %s:%s\n", bound, service);
        fflush(stdout);
    }
    return listener;
}

/* Starting: the devices are read from BLOCK, so that the robot does what it describes. */

static struct limits limits_at(int types, const char *name)
{
    struct limits limits = {false, 0, 0, 0};
    int node = json_get(&json, types, name);
    limits.there = number_at(node, "min_value", &limits.min) && number_at(node, "max_value", &limits.max)
        && number_at(node, "granularity", &limits.granularity);
    return limits;
}

static bool read_block(void)
{
    static char block[sizeof BLOCK];
    int item, type, i;
    memcpy(block, BLOCK, sizeof BLOCK);
    if (!json_read(&json, block, sizeof BLOCK - 1) || !text_at(0, "id", 1, &robot_id))
        return false;
    reports = boolean_at(0, "reports");
    item = json_get(&json, 0, "devices");
    for (item = item == JSON_NONE ? item : json.nodes[item].first; item != JSON_NONE; item = json.nodes[item].next) {
        struct device *device = &devices[device_count];
        int types = json_get(&json, item, "available_control_types"), script = json_get(&json, types, "script");
        int usable = json_get(&json, script, "control_types");
        double queue = 1, steps = 0;
        if (device_count++ == MAX_DEVICES || !text_at(item, "id", 1, &device->id))
            return false;
        device->taken_back = -NEVER;
        device->linear = json_is(&json, json_get(&json, item, "interpolation"), "linear");
        device->has_default = number_at(item, "default_value", &device->default_value);
        device->sensor = json_get(&json, types, "sensor") != JSON_NONE;
        device->script = limits_at(types, "script");
        number_at(item, "script_queue", &queue);
        number_at(script, "max_number_of_steps", &steps);
        if (queue > MAX_QUEUE || steps > MAX_STEPS)
            return false;
        device->queue = (int)queue;
        device->max_steps = (int)steps;
        for (i = 0; i < KINDS; i++) {
            device->kinds[i] = limits_at(types, KIND_NAMES[i]);
            device->usable[i] = usable == JSON_NONE && device->kinds[i].there;
        }
        for (i = 0; i < KINDS && !device->kinds[i].there; i++)
            ;
        device->primary = i < KINDS ? (enum kind)i : POSITION;
        device->where[device->primary] = device->has_default ? device->default_value : 0;
        for (type = usable == JSON_NONE ? usable : json.nodes[usable].first; type != JSON_NONE; type = json.nodes[type].next)
            for (i = 0; i < KINDS; i++)
                if (json_is(&json, type, KIND_NAMES[i]))
                    device->usable[i] = true;
    }
    return device_count > 0 && !fault;
}

int main(int argc, char **argv)
{
    const char *address = "127.0.0.1:0", *secret = NULL;
    int listener, i;
    for (i = 1; i + 1 < argc; i += 2) {
        if (!strcmp(argv[i], "--listen"))
            address = argv[i + 1];
        else if (!strcmp(argv[i], "--secret"))
            secret = argv[i + 1];
        else if (!strcmp(argv[i], "--revoked"))
            revoked = argv[i + 1];
        else
            break;
    }
    if (i != argc || (revoked && !secret)) {
        fprintf(stderr, "robot [--listen HOST:PORT] [--secret FILE [--revoked FILE]]; port 0 is any that is free\n");
        return 2;
    }
    secured = secret != NULL;
    if (secured && !sealed_read_secret(&key, secret))
        return 1;
    if (revoked && !sealed_read_revoked(&key, revoked))
        return 1;
    if (!read_block()) {
        fprintf(stderr, "BLOCK cannot be read, or does not keep to the limits\n");
        return 1;
    }
    key.robot = robot_id.bytes;
    key.robot_length = robot_id.length;
    for (i = 0; i < MAX_LINKS; i++)
        links[i].socket = -1;
    listener = listen_at(address);
    if (listener < 0) {
        fprintf(stderr, "cannot listen on %s\n", address);
        return 1;
    }
    for (;;) {
        struct pollfd polls[MAX_LINKS + 1];
        int64_t wait;
        int timeout;
        end_invalid();
        wait = run() - now_ns() - SPIN;
        timeout = wait <= 0 ? 0 : wait > 250 * MS ? 250 : (int)(wait / MS);
        for (i = 0; i < MAX_LINKS; i++) {
            struct link *link = &links[i];
            bool listens = link->socket >= 0 && link->out_length < MAX_UNREAD;
            if (listens && link->more)
                timeout = 0;
            polls[i].fd = link->socket;
            polls[i].events = (short)((listens && !link->more ? POLLIN : 0) | (link->out_length ? POLLOUT : 0));
            polls[i].revents = 0;
        }
        polls[MAX_LINKS].fd = listener;
        polls[MAX_LINKS].events = POLLIN;
        polls[MAX_LINKS].revents = 0;
        if (poll(polls, MAX_LINKS + 1, timeout) < 0 && errno != EINTR)
            return 1;
        for (i = 0; i < MAX_LINKS; i++) {
            struct link *link = &links[i];
            if (link->socket < 0)
                continue;
            if (polls[i].revents & POLLOUT)
                link_flush(link);
            if (polls[i].revents & POLLIN)
                link_read(link);
            else if (polls[i].revents & (POLLERR | POLLHUP | POLLNVAL))
                link->dead = true;
            if (secured && !link->dead)
                link_open(link);
            if (!link->dead && link->in_length)
                link_lines(link);
            if (link->dead || is_slow(link))
                link_close(link);
        }
        if (polls[MAX_LINKS].revents & POLLIN)
            link_accept(listener);
    }
}
