/* Runs a command on a terminal of its own, and stops the output like Ctrl-S when SIGUSR1 comes.
   terminal PIDFILE COMMAND ARGUMENT...: the command's process is in the file, its exit code is this program's.
   Once the output is stopped, there is a file PIDFILE.stopped. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

static volatile sig_atomic_t stopped;

static void stop(int signal)
{
    (void)signal;
    stopped = 1;
}

static int begin(int master, char **command)
{
    const struct winsize size = {30, 100, 0, 0};
    int terminal = open(ptsname(master), O_RDWR | O_NOCTTY);
    ioctl(terminal, TIOCSWINSZ, &size);
    int child = fork();
    if (child == 0) {
        close(master);
        setsid();
        ioctl(terminal, TIOCSCTTY, 0);
        for (int fd = 0; fd < 3; fd++)
            dup2(terminal, fd);
        execvp(command[0], command);
        _exit(127);
    }
    close(terminal);
    return child;
}

int main(int count, char **arguments)
{
    char bytes[4096];
    int status, master = posix_openpt(O_RDWR | O_NOCTTY);
    if (count < 3 || master < 0 || grantpt(master) || unlockpt(master))
        return 126;
    signal(SIGUSR1, stop);
    int child = begin(master, arguments + 2);
    FILE *file = fopen(arguments[1], "w");
    fprintf(file, "%d\n", child);
    fclose(file);
    while (waitpid(child, &status, WNOHANG) == 0) {
        struct pollfd readable = {master, POLLIN, 0};
        /* Stops an output immediately, as an unread terminal or Ctrl-S does once the terminal's memory is full. */
        if (stopped == 1) {
            int terminal = open(ptsname(master), O_RDWR | O_NOCTTY);
            tcflow(terminal, TCOOFF);
            stopped = 2;
            char name[4096];
            snprintf(name, sizeof name, "%s.stopped", arguments[1]);
            close(open(name, O_WRONLY | O_CREAT, 0600));
        }
        if (stopped)
            usleep(10000);
        else if (poll(&readable, 1, 10) > 0 && read(master, bytes, sizeof bytes) < 0)
            usleep(1000);
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}
