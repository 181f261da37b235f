#include "json.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static bool utf8(const char *text, size_t length)
{
    const unsigned char *at = (const unsigned char *)text, *end = at + length;
    while (at < end) {
        unsigned char lead = *at++;
        int more = lead < 0x80 ? 0 : lead >= 0xc2 && lead < 0xe0 ? 1 : lead >= 0xe0 && lead < 0xf0 ? 2
                 : lead >= 0xf0 && lead < 0xf5 ? 3 : -1;
        if (more < 0 || end - at < more)
            return false;
        if (more > 1) {         /* overlong forms, surrogates, above U+10FFFF */
            unsigned char second = *at;
            if ((lead == 0xe0 && second < 0xa0) || (lead == 0xed && second > 0x9f)
                || (lead == 0xf0 && second < 0x90) || (lead == 0xf4 && second > 0x8f))
                return false;
        }
        for (; more; more--)
            if ((*at++ & 0xc0) != 0x80)
                return false;
    }
    return true;
}

static int hex4(const char *at)
{
    int value = 0, i;
    for (i = 0; i < 4; i++) {
        char c = at[i];
        int digit = c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
        if (digit < 0)
            return -1;
        value = value * 16 + digit;
    }
    return value;
}

static char *put_utf8(char *to, long c)
{
    if (c < 0x80) {
        *to++ = (char)c;
    } else if (c < 0x800) {
        *to++ = (char)(0xc0 | c >> 6);
        *to++ = (char)(0x80 | (c & 0x3f));
    } else if (c < 0x10000) {
        *to++ = (char)(0xe0 | c >> 12);
        *to++ = (char)(0x80 | (c >> 6 & 0x3f));
        *to++ = (char)(0x80 | (c & 0x3f));
    } else {
        *to++ = (char)(0xf0 | c >> 18);
        *to++ = (char)(0x80 | (c >> 12 & 0x3f));
        *to++ = (char)(0x80 | (c >> 6 & 0x3f));
        *to++ = (char)(0x80 | (c & 0x3f));
    }
    return to;
}

/* Decodes a string in place. Starts after the opening quote and returns the position after the closing quote; NULL if it is
   missing. A decoded string is never longer than its source. */
static char *read_string(struct json_node *node, char *at)
{
    char *to = at;
    node->text = to;
    while (*at != '"') {
        unsigned char c = (unsigned char)*at++;
        if (c < 0x20)           /* including the end of the text */
            return NULL;
        if (c != '\\') {
            *to++ = (char)c;
            continue;
        }
        switch (*at++) {
        case '"': *to++ = '"'; break;
        case '\\': *to++ = '\\'; break;
        case '/': *to++ = '/'; break;
        case 'b': *to++ = '\b'; break;
        case 'f': *to++ = '\f'; break;
        case 'n': *to++ = '\n'; break;
        case 'r': *to++ = '\r'; break;
        case 't': *to++ = '\t'; break;
        case 'u': {
            long point = hex4(at), low;
            if (point < 0)
                return NULL;
            at += 4;
            if (point >= 0xdc00 && point < 0xe000)
                return NULL;
            if (point >= 0xd800 && point < 0xdc00) {
                if (at[0] != '\\' || at[1] != 'u' || (low = hex4(at + 2)) < 0xdc00 || low > 0xdfff)
                    return NULL;
                at += 6;
                point = 0x10000 + ((point - 0xd800) << 10) + (low - 0xdc00);
            }
            to = put_utf8(to, point);
            break;
        }
        default: return NULL;
        }
    }
    node->length = (size_t)(to - node->text);
    return at + 1;
}

static bool digit(char c)
{
    return c >= '0' && c <= '9';
}

static char *read_number(struct json *json, struct json_node *node, char *at)
{
    char *start = at;
    if (*at == '-')
        at++;
    if (!digit(*at) || (at[0] == '0' && digit(at[1])))
        return NULL;
    while (digit(*at))
        at++;
    if (*at == '.') {
        if (!digit(*++at))
            return NULL;
        while (digit(*at))
            at++;
    }
    if (*at == 'e' || *at == 'E') {
        at++;
        if (*at == '+' || *at == '-')
            at++;
        if (!digit(*at))
            return NULL;
        while (digit(*at))
            at++;
    }
    node->number = strtod(start, NULL) + 0.0; /* 0 instead of -0 */
    if (!isfinite(node->number))
        json->fault = "a number is out of range";
    node->text = start;
    node->length = (size_t)(at - start);
    return at;
}

static char *blank(char *at)
{
    while (*at == ' ' || *at == '\t' || *at == '\r' || *at == '\n')
        at++;
    return at;
}

static bool fail(struct json *json, const char *error)
{
    json->error = error;
    return false;
}

bool json_read(struct json *json, char *text, size_t length)
{
    int stack[JSON_MAX_DEPTH], last[JSON_MAX_DEPTH], depth = 0;
    char *at = text;
    json->count = 0;
    json->error = json->fault = NULL;
    text[length] = '\0';
    if (!utf8(text, length))
        return fail(json, "the text is not UTF-8");
    for (;;) {
        /* Expects a key, a value, or the end of an empty list or object. */
        struct json_node *node, *parent = depth ? &json->nodes[stack[depth - 1]] : NULL;
        int index = json->count, key = JSON_NONE;
        at = blank(at);
        if (parent && parent->size == 0 && *at == (parent->type == JSON_LIST ? ']' : '}'))
            goto close;
        if (json->count > JSON_MAX_NODES - 2)
            return fail(json, "the text has too many values");
        if (parent && parent->type == JSON_OBJECT) {
            int other;
            if (parent->size == JSON_MAX_KEYS)
                return fail(json, "an object has too many keys");
            key = json->count++;
            index = json->count;
            node = &json->nodes[key];
            memset(node, 0, sizeof *node);
            node->type = JSON_STRING;
            node->first = index;
            node->next = JSON_NONE;
            if (*at != '"' || !(at = read_string(node, at + 1)))
                return fail(json, "the text is not JSON: a key was expected");
            for (other = parent->size ? parent->first : JSON_NONE; other != JSON_NONE; other = json->nodes[other].next)
                if (json->nodes[other].length == node->length && !memcmp(json->nodes[other].text, node->text, node->length)) {
                    json->nodes[other].twice = node->twice = true;
                    json->fault = "duplicate key in an object";
                }
            at = blank(at);
            if (*at++ != ':')
                return fail(json, "the text is not JSON: a colon was expected");
            at = blank(at);
        }
        json->count++;
        node = &json->nodes[index];
        memset(node, 0, sizeof *node);
        node->first = node->next = JSON_NONE;
        if (parent) {
            int child = key == JSON_NONE ? index : key;
            if (parent->size++)
                json->nodes[last[depth - 1]].next = child;
            else
                parent->first = child;
            last[depth - 1] = child;
        }
        if (*at == '{' || *at == '[') {
            if (depth == JSON_MAX_DEPTH)
                return fail(json, "the text is nested too deeply");
            node->type = *at == '{' ? JSON_OBJECT : JSON_LIST;
            node->text = at++;
            stack[depth++] = index;
            continue;
        }
        if (*at == '"') {
            node->type = JSON_STRING;
            at = read_string(node, at + 1);
        } else if (*at == '-' || digit(*at)) {
            node->type = JSON_NUMBER;
            at = read_number(json, node, at);
        } else {
            static const char *const words[] = {"null", "false", "true"};
            int word;
            for (word = 0; word < 3 && strncmp(at, words[word], strlen(words[word])) != 0; word++)
                ;
            node->type = (enum json_type)word;
            at = word < 3 ? at + strlen(words[word]) : NULL;
        }
        if (!at)
            return fail(json, "the text is not JSON: a value was expected");
        for (;;) {
            at = blank(at);
            if (!depth)
                return at == text + length || fail(json, "the text is not JSON: something follows it");
            parent = &json->nodes[stack[depth - 1]];
            if (*at == ',') {
                at++;
                break;
            }
            if (*at != (parent->type == JSON_LIST ? ']' : '}'))
                return fail(json, "the text is not JSON: a comma or an end was expected");
        close:
            at++;
            parent->length = (size_t)(at - parent->text);
            depth--;
        }
    }
}

int json_get(const struct json *json, int object, const char *key)
{
    int at;
    if (object == JSON_NONE || json->nodes[object].type != JSON_OBJECT)
        return JSON_NONE;
    for (at = json->nodes[object].first; at != JSON_NONE; at = json->nodes[at].next)
        if (json_is(json, at, key)) {
            int value = json->nodes[at].first;
            return json->nodes[at].twice || json->nodes[value].type == JSON_NULL ? JSON_NONE : value;
        }
    return JSON_NONE;
}

bool json_is(const struct json *json, int node, const char *text)
{
    return node != JSON_NONE && json->nodes[node].type == JSON_STRING && json->nodes[node].length == strlen(text)
        && !memcmp(json->nodes[node].text, text, json->nodes[node].length);
}
