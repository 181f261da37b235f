/* A JSON reader without allocation and without recursion. Strings are decoded in place, so the text has to be writable, and the nodes
   are valid until it is changed. */
#ifndef JSON_H
#define JSON_H

#include <stdbool.h>
#include <stddef.h>

#ifndef JSON_MAX_NODES
#define JSON_MAX_NODES 8192 /* values and keys of one text */
#endif
#define JSON_MAX_DEPTH 128
#define JSON_MAX_KEYS 512   /* of one object: each key is compared with all previous ones */
#define JSON_NONE (-1)

enum json_type { JSON_NULL, JSON_FALSE, JSON_TRUE, JSON_NUMBER, JSON_STRING, JSON_LIST, JSON_OBJECT };

struct json_node {
    enum json_type type;
    const char *text;   /* a string: decoded, without quotes and not terminated; else the source text */
    size_t length;
    int size;           /* of a list or an object */
    int first;          /* of a list: its first item; of an object: its first key; of a key: its value */
    int next;           /* next item or key */
    bool twice;         /* a duplicate key of its object */
    double number;
};

struct json {
    struct json_node nodes[JSON_MAX_NODES];
    int count;
    const char *error;  /* why the text is not JSON, or exceeds our limits */
    const char *fault;  /* valid JSON, but malformed: a duplicate key, a number out of range */
};

/* Reads a text. Node 0 is the root. If it returns false, `error` is the reason. `text[length]` must be writable as well. */
bool json_read(struct json *json, char *text, size_t length);

/* The value of a key; JSON_NONE if it is missing, null or duplicate, or if `object` is not an object. */
int json_get(const struct json *json, int object, const char *key);

bool json_is(const struct json *json, int node, const char *text);

#endif
