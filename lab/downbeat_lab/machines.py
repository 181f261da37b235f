"""Several machines on this one: network namespaces, each with its own addresses. They need root."""

import contextlib
import subprocess
import sys


def ip(*arguments, check=True, lines=None):
    """Runs `ip`, with these lines as its input. Returns whether it succeeded; exits if it fails and `check` is true."""
    errors = None if check else subprocess.DEVNULL
    return subprocess.run(["ip", *arguments], check=check, stderr=errors, input=lines, text=True).returncode == 0


def on(machine, *command):
    """The words that run a command on a machine."""
    return ["ip", "netns", "exec", machine, *command]


@contextlib.contextmanager
def machines(names):
    """Machines with these names, each with a loopback interface, which exist during a `with` block."""
    # Removes the machines of an interrupted run.
    remove(names)
    try:
        for name in names:
            if not ip("netns", "add", name, check=False):
                sys.exit("network namespaces are not permitted here: this needs root")
            ip("-n", name, "link", "set", "lo", "up")
        yield
    finally:
        remove(names)


def remove(names):
    for name in names:
        ip("netns", "del", name, check=False)
