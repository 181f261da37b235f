"""Starts processes and ends all of them, also after an error."""

import os
import subprocess
import sys

from downbeat_lab.program import shown


class Processes:
    """Processes that are ended at the end of a `with` block."""

    def __init__(self):
        self.started = []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        for process in self.started:
            process.kill()
        for process in self.started:
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()

    def start(self, *command, **options):
        """Starts a process with the options of `subprocess.Popen`."""
        process = subprocess.Popen(command, text=True, **options)
        self.started.append(process)
        return process

    def start_listening(self, *command, robots, errors=None, **options):
        """Starts `downbeat robot` or `downbeat sim` and waits until it has printed one address for each of its robots.

        `errors` is the file for its standard error, which is discarded by default. Returns the process and the printed lines. Exits if
        the process ends before that.
        """
        with open(errors or os.devnull, "w") as file:
            process = self.start(*command, stdout=subprocess.PIPE, stderr=file, **options)
        lines = []
        while len(lines) < robots:
            line = process.stdout.readline()
            if not line:
                reason = errors.read_text() if errors else "no output"
                sys.exit(f"{shown(command)}: ended after {len(lines)} of {robots} robots: {reason}")
            if " listens on " in line:
                lines.append(line.strip())
        return process, lines


def wait_with_usage(process):
    """Waits for a process and returns its `rusage`, which `Popen.wait` discards."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return usage
