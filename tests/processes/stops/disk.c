/* A disk that stalls while the file $STALL_DISK exists, and has no room under $DOWNBEAT_STATE while $FULL_DISK does.
   Preloaded into the program under test. Once something waits for the disk, there is a file $STALL_DISK.waits. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static int holds(const char *name)
{
    const char *path = getenv(name);
    return path && access(path, F_OK) == 0;
}

static int (*real(const char *name))(int)
{
    return (int (*)(int))dlsym(RTLD_NEXT, name);
}

static void stand_still(void)
{
    const struct timespec moment = {0, 10 * 1000 * 1000};
    char waits[4096];
    while (holds("STALL_DISK")) {
        snprintf(waits, sizeof waits, "%s.waits", getenv("STALL_DISK"));
        close(open(waits, O_WRONLY | O_CREAT, 0600));
        nanosleep(&moment, NULL);
    }
}

int fsync(int fd)
{
    stand_still();
    return real("fsync")(fd);
}

int fdatasync(int fd)
{
    stand_still();
    return real("fdatasync")(fd);
}

static int is_state(int fd)
{
    char link[64], path[4096];
    const char *state = getenv("DOWNBEAT_STATE");
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (!state || length < 0)
        return 0;
    path[length] = 0;
    return strncmp(path, state, strlen(state)) == 0;
}

ssize_t write(int fd, const void *bytes, size_t count)
{
    if (holds("FULL_DISK") && is_state(fd)) {
        errno = ENOSPC;
        return -1;
    }
    return ((ssize_t(*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write"))(fd, bytes, count);
}
