/* A URRCP robot of the profile Core, without transport: posix.c serves it over TCP. All times are nanoseconds. */
#ifndef CORE_H
#define CORE_H

#include <stddef.h>
#include <stdbool.h>
#include <stdint.h>

#define CORE_LINKS 4
#define CORE_LINE 4096  /* bytes of a line without its \n */
#define CORE_ANSWER 4096

/* `clock` is the time that NTP disciplines, since 1970. `steady` is a clock that nobody sets. */
struct core_now { int64_t clock, steady; };

/* Does all that is due. Returns the time until the next call at the latest. */
int64_t core_run(struct core_now now);

/* Handles a line of `length` bytes, which may be overwritten; `line[length]` must be writable. A longer line than CORE_LINE is passed
   with its length and NULL. Returns the length of the answer in `answer`, without a \n; 0 if there is no answer. */
size_t core_line(int link, char *line, size_t length, struct core_now now, char answer[CORE_ANSWER]);

/* A connection has opened, or has closed. */
void core_opened(int link, struct core_now now);
void core_closed(int link);

/* Your hardware; must return at once. */
void core_drive(int device, double value);

#endif
