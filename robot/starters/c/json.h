/* A JSON reader without allocation and without recursion. The text is read in place: strings are decoded where they
   stand, so it has to be writable, and the nodes are good for as long as it is left alone. */
#ifndef JSON_H
#define JSON_H

#include <stdbool.h>
#include <stddef.h>

#define JSON_MAX_NODES 8192 /* values and keys of one text */
#define JSON_MAX_DEPTH 128
#define JSON_MAX_KEYS 512   /* of one object: each is compared with those ahead of it */
#define JSON_NONE (-1)

enum json_type { JSON_NULL, JSON_FALSE, JSON_TRUE, JSON_NUMBER, JSON_STRING, JSON_LIST, JSON_OBJECT };

struct json_node {
    enum json_type type;
    const char *text;   /* a string: decoded, without quotes and without an end of its own; else the text as it came */
    size_t length;
    int size;           /* of a list or an object */
    int first;          /* of a list: its first item; of an object: its first key; of a key: its value */
    int next;           /* the next item or key */
    bool twice;         /* a key that stands twice in its object */
    double number;
};

struct json {
    struct json_node nodes[JSON_MAX_NODES];
    int count;
    const char *error;  /* why it is not JSON, or not for us */
    const char *fault;  /* JSON, and yet malformed: a key that stands twice, a number out of range */
};

/* Node 0 is the whole. False: see `error`. `text[length]` must be writable as well. */
bool json_read(struct json *json, char *text, size_t length);

/* The value of a key; JSON_NONE where it is missing, null or stands twice, and where `object` is none. */
int json_get(const struct json *json, int object, const char *key);

bool json_is(const struct json *json, int node, const char *text);

#endif
