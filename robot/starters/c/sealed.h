/* hmac:// (docs/protocol.md, "A shared secret"): a peer proves a pass that is derived from the robot's secret; after that, each record
   of bytes has an authentication code. Without sockets: received bytes go in, bytes to send come out. */
#ifndef SEALED_H
#define SEALED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "sha256.h"

#define SEALED_RECORD 16384 /* most bytes in a record */
#define SEALED_HEAD 20      /* a record's length and code */
#define SEALED_LINE 8192    /* of the handshake */
#define SEALED_NONCE 16
#define SEALED_NAME 256     /* longest name of an operator, in bytes; a longer one is rejected */
#define SEALED_SERIAL 64    /* room for the number of a pass; a longer one is rejected */
#define SEALED_REVOKED 256  /* most passes on a list of revoked ones */

enum { ROLE_OBSERVE = 1, ROLE_DRIVE = 2, ROLE_STOP = 4, ROLE_SEIZE = 8 };

/* A list of revoked passes. A later one has a larger number. */
struct sealed_list {
    uint64_t number;
    size_t count;
    char serials[SEALED_REVOKED][SEALED_SERIAL];
};

/* The number of an operator's pass, and when it expires, in seconds since 1970. */
struct sealed_claim {
    char serial[SEALED_SERIAL];
    int64_t expires;
};

/* The robot's secret and its settings. */
struct sealed_key {
    unsigned char secret[SHA256_BYTES];
    int64_t made;        /* when it was made, in seconds since 1970; 0 if unknown */
    const char *robot;   /* its id */
    size_t robot_length;
    struct sealed_list revoked;
};

enum sealed_stage { SEALED_HELLO, SEALED_PROOF, SEALED_OPEN };

/* One connection. */
struct sealed {
    enum sealed_stage stage;
    unsigned roles;
    char name[SEALED_NAME];
    size_t name_length;
    struct sealed_claim claim;
    unsigned char pass[SHA256_BYTES], to_robot[SHA256_BYTES], to_operator[SHA256_BYTES];
    uint64_t came, went; /* records in each direction */
    size_t said_length, raw_length;
    char said[SEALED_LINE + 256];                      /* the first two lines */
    unsigned char raw[SEALED_RECORD + SEALED_HEAD];   /* received bytes of an incomplete record or line */
};

/* Reads a file written by `downbeat keys secret`. On failure, returns false and prints the reason to stderr. */
bool sealed_read_secret(struct sealed_key *key, const char *path);

/* Replaces the list of revoked passes by the one in a file that `downbeat keys` wrote. If that one is damaged, longer than
   SEALED_REVOKED or older, returns false, prints the reason to stderr, and changes nothing. */
bool sealed_read_revoked(struct sealed_key *key, const char *path);

/* Why a pass is not valid at `now`, in seconds since 1970; NULL if it is. */
const char *sealed_invalid(const struct sealed_key *key, const struct sealed_claim *claim, int64_t now);

/* Fills `bytes` with random bytes; false if that is impossible. */
bool sealed_random(unsigned char *bytes, size_t length);

/* Handles a line of the handshake if it is complete. `now` is the calendar time in seconds since 1970, `nonce` the robot's number for
   this connection. Puts the answer into `answer`, which has room for SEALED_LINE characters and a terminator. If it returns false,
   close the connection after the answer. */
bool sealed_greet(const struct sealed_key *key, struct sealed *s, int64_t now, const unsigned char *nonce, char *answer);

/* Appends the content of the next complete record, if it fits. Returns its number of bytes, or -1 if the connection must be closed. */
int sealed_open(struct sealed *s, char *bytes, size_t room);

/* Writes the head of a record with these bytes. */
void sealed_seal(struct sealed *s, const void *bytes, size_t length, unsigned char *head);

/* The roles as text for users, empty without roles; `what` has room for 64 characters. */
void sealed_roles(unsigned roles, char *what);

#endif
