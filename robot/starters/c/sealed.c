#include "sealed.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char VERSION[] = "URRCP-HMAC 1 ";
static const char *const ROLES[] = {"observe", "drive", "stop", "seize"};

#define HEX (2 * SHA256_BYTES)
#define CLOCKS_DIFFER 300 /* seconds by which this clock may be behind that of the authority */

static int digit(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

static bool bytes_of(const char *hex, size_t length, unsigned char *bytes)
{
    for (; length; length--, hex += 2) {
        if (digit(hex[0]) < 0 || digit(hex[1]) < 0)
            return false;
        *bytes++ = (unsigned char)(digit(hex[0]) << 4 | digit(hex[1]));
    }
    return true;
}

/* Takes the same time wherever they differ. */
static bool alike(const unsigned char *a, const unsigned char *b, size_t length)
{
    unsigned char differ = 0;
    for (; length; length--)
        differ |= (unsigned char)(*a++ ^ *b++);
    return !differ;
}

static void code(const unsigned char *key, const char *what, const char *bytes, size_t length, unsigned char *to)
{
    struct hmac hmac;
    hmac_start(&hmac, key);
    hmac_add(&hmac, what, strlen(what));
    hmac_add(&hmac, bytes, length);
    hmac_end(&hmac, to);
}

bool sealed_read_secret(struct sealed_key *key, const char *path)
{
    char line[1024];
    bool found = false, good = true;
    struct stat stat;
    FILE *file = fopen(path, "r");
    if (!file || fstat(fileno(file), &stat) < 0) {
        perror(path);
        if (file)
            fclose(file);
        return false;
    }
    while (fgets(line, sizeof line, file)) {
        size_t length = strcspn(line, "\r\n");
        if (!strncmp(line, "# made ", 7))
            key->made = strtoll(line + 7, NULL, 10);
        if (!length || line[0] == '#')
            continue;
        good = good && !found && length == HEX && bytes_of(line, SHA256_BYTES, key->secret);
        found = true;
    }
    fclose(file);
    if (stat.st_mode & 077)
        fprintf(stderr, "%s: other users can read this secret; restrict access with `chmod 600 %s`\n", path, path);
    else if (!found || !good)
        fprintf(stderr, "%s: expected a file that `downbeat keys secret` wrote\n", path);
    return found && good && !(stat.st_mode & 077);
}

bool sealed_random(unsigned char *bytes, size_t length)
{
    int file = open("/dev/urandom", O_RDONLY);
    ssize_t got = file < 0 ? -1 : read(file, bytes, length);
    if (file >= 0)
        close(file);
    return got == (ssize_t)length;
}

bool sealed_read_revoked(struct sealed_key *key, const char *path)
{
    static struct sealed_list list; /* replaces the one in use as a whole */
    char line[1024];
    const char *why = "expected a list that `downbeat keys` wrote";
    bool good = true, whole = false;
    FILE *file = fopen(path, "r");
    list.number = list.count = 0;
    while (file && good && fgets(line, sizeof line, file)) {
        size_t length = strcspn(line, "\n");
        whole = !strcmp(line, "# end\n"); /* without it, the list was cut off */
        if (!strncmp(line, "# number ", 9))
            list.number = strtoull(line + 9, NULL, 10);
        if (!length || line[0] == '#')
            continue;
        line[length] = '\0';
        good = length < SEALED_SERIAL && strspn(line, "0123456789abcdef:") == length && list.count < SEALED_REVOKED;
        if (good)
            strcpy(list.serials[list.count++], line);
        else if (list.count == SEALED_REVOKED)
            why = "it names more passes than SEALED_REVOKED";
    }
    good = good && whole && !ferror(file);
    if (!file)
        why = strerror(errno);
    else
        fclose(file);
    if (good && list.number >= key->revoked.number) {
        key->revoked = list;
        return true;
    }
    if (good)
        fprintf(stderr, "%s: its number %" PRIu64 " is smaller than %" PRIu64 ", that of the list in use\n", path, list.number,
            key->revoked.number);
    else
        fprintf(stderr, "%s: %s\n", path, why);
    return false;
}

const char *sealed_invalid(const struct sealed_key *key, const struct sealed_claim *claim, int64_t now)
{
    size_t i;
    for (i = 0; i < key->revoked.count; i++)
        if (!strcmp(key->revoked.serials[i], claim->serial))
            return "the operator's key was revoked";
    return claim->expires < now ? "the operator's key has expired" : NULL;
}

/* Percent-encodes all but the unreserved characters of RFC 3986. Returns 0 if there is no room. */
static size_t encode(const char *text, size_t length, char *to, size_t room)
{
    size_t used = 0;
    for (; length; length--, text++) {
        unsigned char c = (unsigned char)*text;
        bool kept = c < 0x80 && (isalnum(c) || (c && strchr("-._~", c)));
        if (used + 4 > room)
            return 0;
        used += (size_t)sprintf(to + used, kept ? "%c" : "%%%02X", c);
    }
    return used;
}

/* Decodes an operator's name. Returns false if it is damaged or too long. */
static bool decode(struct sealed *s, const char *text, size_t length)
{
    s->name_length = 0;
    for (; length; length--, text++) {
        unsigned char c = (unsigned char)*text;
        if (s->name_length == SEALED_NAME)
            return false;
        if (c == '%') {
            int high = length > 2 ? digit((char)tolower((unsigned char)text[1])) : -1;
            int low = length > 2 ? digit((char)tolower((unsigned char)text[2])) : -1;
            if (high < 0 || low < 0)
                return false;
            c = (unsigned char)(high << 4 | low);
            text += 2;
            length -= 2;
        }
        s->name[s->name_length++] = (char)c;
    }
    return s->name_length > 0;
}

static unsigned roles_of(const char *text, size_t length)
{
    unsigned roles = 0;
    while (length) {
        const char *end = memchr(text, ',', length);
        size_t word = end ? (size_t)(end - text) : length;
        int i;
        for (i = 0; i < 4; i++)
            if (strlen(ROLES[i]) == word && !memcmp(ROLES[i], text, word))
                roles |= 1u << i;
        text += word + (end != NULL);
        length -= word + (end != NULL);
    }
    return roles;
}

void sealed_roles(unsigned roles, char *what)
{
    int i;
    what[0] = '\0';
    for (i = 0; i < 4; i++)
        if (roles & 1u << i)
            sprintf(what + strlen(what), "%s%s", what[0] ? ", " : "", ROLES[i]);
}

static bool refuse(char *answer, const char *why, const char *more)
{
    sprintf(answer, "%srefused %s%s\n", VERSION, why, more);
    return false;
}

/* The first line. */
static bool hello(const struct sealed_key *key, struct sealed *s, size_t length, int64_t now, const unsigned char *nonce,
    char *answer)
{
    char own[12 * 256 + 1], *line = s->said, *word[7], *end;
    size_t at = sizeof VERSION - 1, words = 0, own_length;
    unsigned char number[SEALED_NONCE], tag[SHA256_BYTES];
    if (length < at || memcmp(line, VERSION, at) != 0)
        return false; /* another protocol */
    while (words < 7) { /* nonce, robot, "operator", name, roles, end, number */
        word[words++] = line + at;
        end = memchr(line + at, ' ', length - at);
        if (!end)
            break;
        at = (size_t)(end - line) + 1;
    }
    if (words != 7 || memchr(word[6], ' ', (size_t)(line + length - word[6])) || word[1] - word[0] != 2 * SEALED_NONCE + 1
        || !bytes_of(word[0], SEALED_NONCE, number) || strncmp(word[2], "operator ", 9) != 0
        || !decode(s, word[3], (size_t)(word[4] - word[3]) - 1))
        return refuse(answer, "claim", "");
    own_length = encode(key->robot, key->robot_length, own, sizeof own);
    own[own_length] = '\0';
    if ((size_t)(word[2] - word[1]) - 1 != own_length || memcmp(word[1], own, own_length) != 0)
        return refuse(answer, "robot ", own);
    s->claim.expires = strtoll(word[5], &end, 10);
    if (end != word[6] - 1 || line + length - word[6] >= SEALED_SERIAL)
        return refuse(answer, "claim", "");
    sprintf(s->claim.serial, "%.*s", (int)(line + length - word[6]), word[6]);
    if (now < key->made - CLOCKS_DIFFER)
        return refuse(answer, "clock", "");
    if (s->claim.expires < now)
        return refuse(answer, "expired", "");
    if (sealed_invalid(key, &s->claim, now))
        return refuse(answer, "revoked", "");
    s->roles = roles_of(word[4], (size_t)(word[5] - word[4]) - 1);
    code(key->secret, "urrcp pass 1\n", word[2], (size_t)(line + length - word[2]), s->pass);
    /* The proof covers the answer and the line before it. */
    line[length++] = '\n';
    at = length + (size_t)sprintf(line + length, "%s", VERSION);
    hex_of(nonce, SEALED_NONCE, line + at);
    at += 2 * SEALED_NONCE;
    code(s->pass, "robot\n", line, at, tag);
    line[at++] = ' ';
    hex_of(tag, sizeof tag, line + at);
    at += HEX;
    line[at++] = '\n';
    s->said_length = at;
    memcpy(answer, line + length, at - length);
    answer[at - length] = '\0';
    code(s->pass, "to robot\n", line, at, s->to_robot);
    code(s->pass, "to operator\n", line, at, s->to_operator);
    s->stage = SEALED_PROOF;
    return true;
}

bool sealed_greet(const struct sealed_key *key, struct sealed *s, int64_t now, const unsigned char *nonce, char *answer)
{
    unsigned char *end = memchr(s->raw, '\n', s->raw_length);
    unsigned char tag[SHA256_BYTES], told[SHA256_BYTES];
    size_t length, known = s->raw_length < sizeof VERSION - 1 ? s->raw_length : sizeof VERSION - 1;
    bool good;
    answer[0] = '\0';
    if (s->stage == SEALED_HELLO && memcmp(s->raw, VERSION, known) != 0)
        return false;
    if (!end)
        return s->raw_length <= SEALED_LINE;
    length = (size_t)(end - s->raw);
    if (length >= SEALED_LINE)
        return false;
    if (s->stage == SEALED_HELLO) {
        memcpy(s->said, s->raw, length);
        good = hello(key, s, length, now, nonce, answer);
    } else {
        code(s->pass, "operator\n", s->said, s->said_length, tag);
        good = length == HEX && bytes_of((char *)s->raw, SHA256_BYTES, told) && alike(tag, told, sizeof tag);
        s->stage = SEALED_OPEN;
    }
    s->raw_length -= length + 1;
    memmove(s->raw, end + 1, s->raw_length);
    return good;
}

static void record_code(const unsigned char *key, uint64_t number, const unsigned char *length, const void *bytes, size_t size,
    unsigned char *tag)
{
    struct hmac hmac;
    unsigned char counted[8];
    int i;
    for (i = 0; i < 8; i++)
        counted[i] = (unsigned char)(number >> (56 - 8 * i));
    hmac_start(&hmac, key);
    hmac_add(&hmac, counted, sizeof counted);
    hmac_add(&hmac, length, 4);
    hmac_add(&hmac, bytes, size);
    hmac_end(&hmac, tag);
}

int sealed_open(struct sealed *s, char *bytes, size_t room)
{
    unsigned char tag[SHA256_BYTES];
    size_t size;
    if (s->raw_length < 4)
        return 0;
    size = (size_t)s->raw[0] << 24 | (size_t)s->raw[1] << 16 | (size_t)s->raw[2] << 8 | s->raw[3];
    if (!size || size > SEALED_RECORD)
        return -1;
    if (s->raw_length < SEALED_HEAD + size || size > room)
        return 0;
    record_code(s->to_robot, s->came, s->raw, s->raw + SEALED_HEAD, size, tag);
    if (!alike(tag, s->raw + 4, SEALED_HEAD - 4))
        return -1;
    s->came++;
    memcpy(bytes, s->raw + SEALED_HEAD, size);
    s->raw_length -= SEALED_HEAD + size;
    memmove(s->raw, s->raw + SEALED_HEAD + size, s->raw_length);
    return (int)size;
}

void sealed_seal(struct sealed *s, const void *bytes, size_t length, unsigned char *head)
{
    unsigned char tag[SHA256_BYTES];
    head[0] = (unsigned char)(length >> 24);
    head[1] = (unsigned char)(length >> 16);
    head[2] = (unsigned char)(length >> 8);
    head[3] = (unsigned char)length;
    record_code(s->to_operator, s->went++, head, bytes, length, tag);
    memcpy(head + 4, tag, SEALED_HEAD - 4);
}
