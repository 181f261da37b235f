/* A program whose first thread stands still once the file $STAND_STILL exists. Preloaded into the program under test. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/syscall.h>
#include <unistd.h>

int epoll_wait(int poll, struct epoll_event *events, int count, int timeout)
{
    int (*real)(int, struct epoll_event *, int, int) =
        (int (*)(int, struct epoll_event *, int, int))dlsym(RTLD_NEXT, "epoll_wait");
    const char *path = getenv("STAND_STILL");
    int ready = real(poll, events, count, timeout);
    if (path && getpid() == syscall(SYS_gettid) && access(path, F_OK) == 0)
        for (;;)
            pause();
    return ready;
}
