/* Tests sha256.c and sealed.c with published vectors, and with Downbeat's tests/vectors/hmac.json:

   cc -std=c99 -D_POSIX_C_SOURCE=200809L -O2 -o test test.c json.c sealed.c sha256.c -lm && ./test hmac.json */
#include <stdio.h>
#include <string.h>

#include "json.h"
#include "sealed.h"

static int failed;

static void check(bool good, const char *what)
{
    if (!good) {
        printf("failed: %s\n", what);
        failed = 1;
    }
}

static void sha(const char *part, int times, const char *expected, const char *what)
{
    struct sha256 sha;
    unsigned char digest[SHA256_BYTES];
    char hex[2 * SHA256_BYTES + 1];
    sha256_start(&sha);
    while (times--)
        sha256_add(&sha, part, strlen(part));
    sha256_end(&sha, digest);
    hex_of(digest, sizeof digest, hex);
    check(!strcmp(hex, expected), what);
}

/* Keys shorter than 32 bytes are padded with zeros, as HMAC itself does. */
static void mac(const char *key, size_t size, const char *data, size_t length, const char *expected, const char *what)
{
    struct hmac hmac;
    unsigned char whole[SHA256_BYTES] = {0}, code[SHA256_BYTES];
    char hex[2 * SHA256_BYTES + 1];
    memcpy(whole, key, size);
    hmac_start(&hmac, whole);
    hmac_add(&hmac, data, length);
    hmac_end(&hmac, code);
    hex_of(code, sizeof code, hex);
    check(!strcmp(hex, expected), what);
}

static void published(void)
{
    char key[25], data[50];
    int i;
    sha("abc", 1, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad", "FIPS 180-4, one block");
    sha("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", 1,
        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1", "FIPS 180-4, two blocks");
    sha("", 1, "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855", "SHA-256 of nothing");
    sha("aaaaaaaaaa", 100000, "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0", "SHA-256 of a million a");
    memset(key, 0x0b, sizeof key);
    mac(key, 20, "Hi There", 8, "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7", "RFC 4231, case 1");
    mac("Jefe", 4, "what do ya want for nothing?", 28, "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843",
        "RFC 4231, case 2");
    memset(key, 0xaa, sizeof key);
    memset(data, 0xdd, sizeof data);
    mac(key, 20, data, 50, "773ea91e36800e46854db8ebd09181a72959098b3ef8c122d9635514ced565fe", "RFC 4231, case 3");
    for (i = 0; i < 25; i++)
        key[i] = (char)(i + 1);
    memset(data, 0xcd, sizeof data);
    mac(key, 25, data, 50, "82558a389a443c0ea4cc819899f2083a85f0faa3e578f8077a2e3ff46729665b", "RFC 4231, case 4");
}

static struct json vectors;

static const char *text(int object, const char *name, size_t *length)
{
    static char copy[4][SEALED_LINE];
    static int turn;
    int node = json_get(&vectors, object, name);
    char *to = copy[turn++ % 4];
    *length = node == JSON_NONE || vectors.nodes[node].length >= SEALED_LINE ? 0 : vectors.nodes[node].length;
    memcpy(to, node == JSON_NONE ? "" : vectors.nodes[node].text, *length);
    to[*length] = '\0';
    return to;
}

static size_t bytes(int object, const char *name, unsigned char *to)
{
    size_t length, i;
    const char *hex = text(object, name, &length);
    for (i = 0; 2 * i + 1 < length; i++) {
        unsigned byte = 0;
        sscanf(hex + 2 * i, "%2x", &byte);
        to[i] = (unsigned char)byte;
    }
    return i;
}

static void hear(struct sealed *s, const char *line, size_t length)
{
    memcpy(s->raw + s->raw_length, line, length);
    s->raw_length += length;
}

static bool greet(const struct sealed_key *key, struct sealed *s, const char *hello, size_t length, char *answer)
{
    unsigned char nonce[SEALED_NONCE];
    bytes(0, "robots_number", nonce);
    memset(s, 0, sizeof *s);
    hear(s, hello, length);
    return sealed_greet(key, s, 2000000000, nonce, answer);
}

static bool uses(struct sealed_key *key, const char *list)
{
    FILE *file = fopen("revoked.test", "w");
    bool used = file && fputs(list, file) >= 0 && fclose(file) == 0 && sealed_read_revoked(key, "revoked.test");
    remove("revoked.test");
    return used;
}

static void handshake(void)
{
    static struct sealed s, before;
    static unsigned char record[2 * SEALED_RECORD], carried[SEALED_RECORD];
    static char answer[SEALED_LINE + 1], opened[SEALED_RECORD];
    static struct sealed_key key;
    const char *hello;
    size_t length, hello_length;
    int item, list, i;
    bool refused;
    bytes(0, "secret", key.secret);
    key.robot = text(0, "robot", &key.robot_length);
    hello = text(0, "hello", &hello_length);
    check(greet(&key, &s, hello, hello_length, answer), "the first line is understood");
    check(!strcmp(answer, text(0, "answer", &length)), "the robot's answer");
    check(s.roles == (ROLE_OBSERVE | ROLE_DRIVE) && s.name_length == 7 && !memcmp(s.name, "anna \xc3\xb6", 7), "who it is");
    key.robot = text(0, "robot", &key.robot_length); /* `text` has four buffers */
    hello = text(0, "hello", &hello_length);
    key.made = 2000000301;
    refused = !greet(&key, &before, hello, hello_length, answer);
    check(refused && !strcmp(answer, "URRCP-HMAC 1 refused clock\n"), "a clock that is not set");
    key.made = 2000000300;
    check(greet(&key, &before, hello, hello_length, answer), "a clock that is a little behind");
    before = s;
    hear(&s, text(0, "proof", &length), 65);
    check(sealed_greet(&key, &s, 2000000000, NULL, answer) && s.stage == SEALED_OPEN, "the operator's proof");
    hear(&before, "0000000000000000000000000000000000000000000000000000000000000000\n", 65);
    check(!sealed_greet(&key, &before, 2000000000, NULL, answer), "another proof");
    list = json_get(&vectors, 0, "to_robot");
    for (item = vectors.nodes[list].first, i = 0; item != JSON_NONE; item = vectors.nodes[item].next, i++) {
        size_t size = bytes(item, "record", record), expected = bytes(item, "bytes", carried);
        before = s;
        record[size - 1] ^= 1;
        hear(&before, (char *)record, size);
        check(sealed_open(&before, opened, sizeof opened) == -1, "a record that was altered");
        record[size - 1] ^= 1;
        hear(&s, (char *)record, size);
        check(sealed_open(&s, opened, sizeof opened) == (int)expected && !memcmp(opened, carried, expected), "a record to the robot");
        before = s;
        hear(&before, (char *)record, size);
        check(sealed_open(&before, opened, sizeof opened) == -1, "a record that was repeated");
    }
    check(i == 3, "three records to the robot");
    list = json_get(&vectors, 0, "to_operator");
    for (item = vectors.nodes[list].first, i = 0; item != JSON_NONE; item = vectors.nodes[item].next, i++) {
        unsigned char head[SEALED_HEAD];
        size_t size = bytes(item, "bytes", carried);
        bytes(item, "record", record);
        sealed_seal(&s, carried, size, head);
        check(!memcmp(head, record, SEALED_HEAD), "a record to the operator");
    }
    check(i == 2, "two records to the operator");
    key.robot = "arm-1";
    list = json_get(&vectors, 0, "refused");
    for (item = vectors.nodes[list].first; item != JSON_NONE; item = vectors.nodes[item].next) {
        check(uses(&key, "# numbers\n0b:00\n# end\n"), "a list of revoked passes");
        hello = text(item, "hello", &length);
        refused = !greet(&key, &s, hello, length, answer);
        check(refused && !strcmp(answer, text(item, "answer", &length)), answer);
    }
}

static void lists(void)
{
    static struct sealed_key key;
    static char list[SEALED_REVOKED * SEALED_SERIAL];
    static const struct sealed_claim first = {"0b:00", 10}, second = {"0b:01", 10};
    int i;
    check(uses(&key, "# number 7\n0b:00\n# end\n"), "the first list");
    check(!uses(&key, "# number 6\n0b:01\n# end\n"), "an older list");
    check(!uses(&key, "# number 8\n0b:01\n"), "a list that was cut off");
    check(!uses(&key, "# number 8\nhello\n# end\n"), "a list of something else");
    check(!uses(&key, ""), "an empty list");
    sprintf(list, "# number 8\n");
    for (i = 0; i <= SEALED_REVOKED; i++)
        sprintf(list + strlen(list), "%02x:%02x\n", i >> 8, i & 255);
    strcat(list, "# end\n");
    check(!uses(&key, list), "a list without room");
    check(!sealed_read_revoked(&key, "no/such/file"), "no list");
    check(key.revoked.number == 7 && sealed_invalid(&key, &first, 10) && !sealed_invalid(&key, &second, 10), "the first list remains");
    check(uses(&key, "# number 8\n0b:01\n# end\n"), "a later list");
    check(!sealed_invalid(&key, &first, 10) && sealed_invalid(&key, &second, 10), "it replaces the first one");
    check(strstr(sealed_invalid(&key, &first, 11), "expired") != NULL, "a pass that has expired");
}

int main(int argc, char **argv)
{
    static char file[65536];
    FILE *from = argc > 1 ? fopen(argv[1], "r") : NULL;
    size_t length = from ? fread(file, 1, sizeof file - 1, from) : 0;
    published();
    if (!json_read(&vectors, file, length)) {
        printf("no vectors: %s\n", from ? vectors.error : "name their file");
        return 1;
    }
    handshake();
    lists();
    if (!failed)
        printf("all is as published\n");
    return failed;
}
