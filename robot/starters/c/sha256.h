/* SHA-256 (FIPS 180-4) and HMAC-SHA256 (RFC 2104), without allocation. */
#ifndef SHA256_H
#define SHA256_H

#include <stddef.h>
#include <stdint.h>

#define SHA256_BYTES 32

struct sha256 {
    uint32_t state[8];
    uint64_t length;
    unsigned char block[64];
};

void sha256_start(struct sha256 *sha);
void sha256_add(struct sha256 *sha, const void *bytes, size_t length);
void sha256_end(struct sha256 *sha, unsigned char *digest);

struct hmac {
    struct sha256 inner, outer;
};

/* Keys have the length of digests. */
void hmac_start(struct hmac *hmac, const unsigned char *key);
void hmac_add(struct hmac *hmac, const void *bytes, size_t length);
void hmac_end(struct hmac *hmac, unsigned char *code);

/* Two characters per byte, and a terminator. */
void hex_of(const unsigned char *bytes, size_t length, char *hex);

#endif
