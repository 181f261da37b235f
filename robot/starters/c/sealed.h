/* hmac:// (docs/protocol.md, "A shared secret"): a peer proves a pass that follows from the robot's secret, and then each record
   of bytes has its code. No sockets in here: bytes as they came go in, what is to be sent comes out. */
#ifndef SEALED_H
#define SEALED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "sha256.h"

#define SEALED_RECORD 16384 /* bytes that a record carries at most */
#define SEALED_HEAD 20      /* its length, and its code */
#define SEALED_LINE 8192    /* of the handshake */
#define SEALED_NONCE 16
#define SEALED_NAME 256     /* of an operator, in bytes; a longer one is not let in */

enum { ROLE_OBSERVE = 1, ROLE_DRIVE = 2, ROLE_STOP = 4, ROLE_SEIZE = 8 };

/* What the robot knows. */
struct sealed_key {
    unsigned char secret[SHA256_BYTES];
    const char *robot;   /* its id */
    size_t robot_length;
    const char *revoked; /* a file with the numbers of revoked passes; NULL: none */
};

enum sealed_stage { SEALED_HELLO, SEALED_PROOF, SEALED_OPEN };

/* One connection. */
struct sealed {
    enum sealed_stage stage;
    unsigned roles;
    char name[SEALED_NAME];
    size_t name_length;
    unsigned char pass[SHA256_BYTES], to_robot[SHA256_BYTES], to_operator[SHA256_BYTES];
    uint64_t came, went; /* records each way */
    size_t said_length, raw_length;
    char said[SEALED_LINE + 256];                      /* the first two lines */
    unsigned char raw[SEALED_RECORD + SEALED_HEAD];   /* what came and is not a whole record, or line */
};

/* Reads a file that `downbeat keys secret` wrote; false with a reason on stderr. */
bool sealed_read_secret(struct sealed_key *key, const char *path);

/* Random bytes; false if there are none. */
bool sealed_random(unsigned char *bytes, size_t length);

/* Takes a line of the handshake if a whole one has come. `now` is the calendar's time in seconds since 1970, `nonce` the robot's
   number for this connection. What is to be answered is put into `answer`, which has room for SEALED_LINE characters and an end.
   False: to be hung up on, behind the answer. */
bool sealed_greet(const struct sealed_key *key, struct sealed *s, int64_t now, const unsigned char *nonce, char *answer);

/* Appends what the next whole record carries, if it fits; how many bytes that were. -1: to be hung up on. */
int sealed_open(struct sealed *s, char *bytes, size_t room);

/* Writes the head of a record with these bytes. */
void sealed_seal(struct sealed *s, const void *bytes, size_t length, unsigned char *head);

/* The roles as a message to people has them; `what` has room for 64 characters. */
const char *sealed_roles(unsigned roles, char *what);

#endif
