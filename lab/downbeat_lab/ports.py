"""Free ports and addresses of the loopback interface."""

import contextlib
import socket
import time

ADDRESSES_PER_BYTE = 250
LOOPBACK_MAX = 255 * ADDRESSES_PER_BYTE
"""Number of addresses that `loopback` has in one network."""


def free_ports(count):
    """Different TCP ports that are free at every address of this machine."""
    with contextlib.ExitStack() as open_sockets:
        sockets = [open_sockets.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("0.0.0.0", 0))
        return [each.getsockname()[1] for each in sockets]


def free_port():
    return free_ports(1)[0]


def loopback(index, network=0):
    """The address of the robot with this index: `127.NETWORK.1.1`, `127.NETWORK.1.2`, ... `network` is at most 255."""
    if not 0 <= index < LOOPBACK_MAX or not 0 <= network <= 255:
        raise ValueError(f"no loopback address for index {index} in network {network}")
    return f"127.{network}.{1 + index // ADDRESSES_PER_BYTE}.{1 + index % ADDRESSES_PER_BYTE}"


def wait_until_open(port, is_alive, interval_s=0.05):
    """Whether a server accepts connections at this port of 127.0.0.1. Waits while `is_alive()` returns true."""
    while True:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return True
        except OSError:
            if not is_alive():
                return False
            time.sleep(interval_s)
