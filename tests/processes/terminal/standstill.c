/* A program whose first thread stalls once the file $STAND_STILL exists. Preloaded into the program under test. */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

/* The first thread asks for the time whenever it has something to do. */
int clock_gettime(clockid_t clock, struct timespec *now)
{
    const char *path = getenv("STAND_STILL");
    if (path && getpid() == syscall(SYS_gettid))
        while (access(path, F_OK) == 0)
            pause();
    return (int)syscall(SYS_clock_gettime, clock, now);
}
