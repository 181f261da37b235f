/* Serves the robot of core.c over TCP on a POSIX system: core --listen HOST:PORT. On a microcontroller, lwIP has the same calls. */
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core.h"

static struct { int socket; bool skips; size_t used; int64_t heard; char line[CORE_LINE + 2]; } peers[CORE_LINKS];

void core_drive(int device, double value) { (void)device, (void)value; }

static struct core_now now(void)
{
    struct timespec clock, steady;
    clock_gettime(CLOCK_REALTIME, &clock);
    clock_gettime(CLOCK_MONOTONIC, &steady);
    return (struct core_now){clock.tv_sec * INT64_C(1000000000) + clock.tv_nsec, steady.tv_sec * INT64_C(1000000000) + steady.tv_nsec};
}

static void hang_up(int i)
{
    close(peers[i].socket);
    peers[i].socket = -1;
    core_closed(i);
}

static void take(int i, char *line, size_t length)
{
    static char answer[CORE_ANSWER + 1];
    size_t blank = line ? strspn(line, " \t\r") : 0;
    core_run(now());
    if (line && blank >= length)
        return;
    length = core_line(i, line, length, now(), answer);
    answer[length] = '\n';
    if (length && send(peers[i].socket, answer, length + 1, MSG_NOSIGNAL) != (ssize_t)length + 1)
        hang_up(i);             /* also a peer that does not read: its answers do not fit */
}

static void receive(int i)
{
    char *line = peers[i].line, *end;
    ssize_t read = recv(peers[i].socket, line + peers[i].used, CORE_LINE + 1 - peers[i].used, 0);
    if (read <= 0) {
        hang_up(i);
        return;
    }
    peers[i].used += (size_t)read;
    peers[i].heard = now().steady;
    while (peers[i].socket >= 0 && (end = memchr(line, '\n', peers[i].used)) != NULL) {
        size_t length = (size_t)(end - line);
        *end = '\0';
        if (!peers[i].skips)
            take(i, line, length);
        peers[i].skips = false;
        peers[i].used -= length + 1;
        memmove(line, end + 1, peers[i].used);
    }
    if (peers[i].socket >= 0 && peers[i].used > CORE_LINE) {
        if (!peers[i].skips)
            take(i, NULL, peers[i].used);
        peers[i].skips = true;
        peers[i].used = 0;
    }
}

/* A new connection replaces the one that has been silent for longest. */
static void welcome(int server)
{
    int i, place = 0, one = 1, socket = accept(server, NULL, NULL);
    for (i = 1; i < CORE_LINKS; i++)
        if (peers[place].socket >= 0 && (peers[i].socket < 0 || peers[i].heard < peers[place].heard))
            place = i;
    if (peers[place].socket >= 0)
        hang_up(place);
    fcntl(socket, F_SETFL, O_NONBLOCK);
    setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    peers[place].socket = socket;
    peers[place].used = 0;
    peers[place].skips = false;
    peers[place].heard = now().steady;
    core_opened(place, now());
}

int main(int count, char **arguments)
{
    struct sockaddr_in address = {.sin_family = AF_INET};
    socklen_t size = sizeof address;
    struct pollfd polled[CORE_LINKS + 1];
    char *port = count == 3 && !strcmp(arguments[1], "--listen") ? strrchr(arguments[2], ':') : NULL;
    int i, one = 1, server = socket(AF_INET, SOCK_STREAM, 0);
    if (!port) {
        fprintf(stderr, "expected --listen HOST:PORT\n");
        return 2;
    }
    *port++ = '\0';
    address.sin_port = htons((uint16_t)atoi(port));
    setsockopt(server, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (inet_pton(AF_INET, arguments[2], &address.sin_addr) != 1 || bind(server, (struct sockaddr *)&address, size) || listen(server, 64)) {
        perror("cannot listen");
        return 1;
    }
    getsockname(server, (struct sockaddr *)&address, &size);
    printf("listening on %s:%d\n", arguments[2], ntohs(address.sin_port));
    fflush(stdout);
    for (i = 0; i < CORE_LINKS; i++)
        peers[i].socket = -1;
    for (;;) {
        int64_t next = core_run(now());
        for (i = 0; i < CORE_LINKS; i++)
            polled[i] = (struct pollfd){peers[i].socket, POLLIN, 0};
        polled[CORE_LINKS] = (struct pollfd){server, POLLIN, 0};
        poll(polled, CORE_LINKS + 1, (int)(next / 1000000));
        for (i = 0; i < CORE_LINKS; i++)
            if (peers[i].socket >= 0 && polled[i].revents)
                receive(i);
        if (polled[CORE_LINKS].revents)
            welcome(server);
    }
}
