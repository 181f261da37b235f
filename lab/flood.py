#!/usr/bin/env python3
"""How long does `downbeat stop --fleet` take while strangers open connections to the robot? A robot that requires TLS or a shared secret
runs in a network namespace. Strangers in a second one open connections from many addresses and send nothing, the beginning of a TLS handshake,
or one message. An operator with the role `stop` in a third one stops the robot over a slow network, which a relay simulates: each message
takes half of the round trip. Needs root:

  lab/flood.py                                      TLS, 2,000 and 5,000 connections per second
  lab/flood.py --link hmac --networks 1000          a shared secret; each address in a /24 of its own
  lab/flood.py --send hello                         strangers send the first message of a TLS handshake
  lab/flood.py --link tcp --send request            strangers send an availability request

Prints a row for each rate, including a rate of 0, and exits 1 if a stop fails or takes longer than 4 s at the first rate, or if 9 of 10
stops at this rate do not end within 1 s.
"""

import asyncio
import collections
import contextlib
import os
import selectors
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from downbeat_lab import fleet, program
from downbeat_lab.machines import ip, machines, on
from downbeat_lab.processes import Processes

ROBOTS, STRANGERS, OPERATOR = MACHINES = ["downbeat-robots", "downbeat-strangers", "downbeat-operator"]
ROBOT_ADDRESS, OPERATOR_ADDRESS = "192.168.77.1", "192.168.77.2"
PORT = 7400
OPEN_MAX = 8000
"""Number of connections that the strangers keep open; beyond it, they close the oldest one."""
REQUEST = b'{"availability_request": {}}\n'
WARM_UP_S = 3
STOP_TIMEOUT_S = 60
GOAL_P90_S, GOAL_MAX_S = 1.0, 4.0


def addresses(count, networks):
    """`count` addresses in this number of /24."""
    per_network = -(-count // networks)
    if per_network > 250:
        sys.exit(f"{networks} networks have fewer than {count} addresses")
    return [f"10.{network // 250}.{network % 250}.{host + 1}" for network in range(networks) for host in range(per_network)][:count]


@contextlib.contextmanager
def network(strangers):
    """The machines and the links between them, which exist during a `with` block. The strangers have these addresses."""
    with machines(MACHINES):
        ip("-n", ROBOTS, "addr", "add", f"{ROBOT_ADDRESS}/32", "dev", "lo")
        for machine, own, from_robots in ((STRANGERS, strangers, "10.0.0.0/8"), (OPERATOR, [OPERATOR_ADDRESS], f"{OPERATOR_ADDRESS}/32")):
            port = f"to-{machine[-8:]}"
            ip("-n", machine, "link", "add", "eth0", "type", "veth", "peer", "name", port, "netns", ROBOTS)
            ip("-n", machine, "-batch", "-", lines="".join(f"addr add {address}/32 dev eth0\n" for address in own))
            ip("-n", machine, "link", "set", "eth0", "up")
            ip("-n", machine, "route", "add", f"{ROBOT_ADDRESS}/32", "dev", "eth0")
            ip("-n", ROBOTS, "link", "set", port, "up")
            ip("-n", ROBOTS, "route", "add", from_robots, "dev", port, "src", ROBOT_ADDRESS)
        yield


def client_hello():
    """The first message of a TLS handshake."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    handshake = ssl.create_default_context().wrap_bio(incoming, outgoing, server_hostname="robot.urrcp.invalid")
    with contextlib.suppress(ssl.SSLWantReadError):
        handshake.do_handshake()
    return outgoing.read()


def open_connections(own, rate, first_message):
    """Opens `rate` connections per second from the addresses `own` in turn, until the process is killed. Prints how
    many it has opened each second."""
    selector, opened = selectors.DefaultSelector(), collections.deque()
    begin, count, shown, before = time.monotonic(), 0, 0, 0
    while True:
        now = time.monotonic() - begin
        while count < now * rate:
            stream = socket.socket()
            stream.setblocking(False)
            stream.setsockopt(socket.IPPROTO_IP, 24, 1)  # IP_BIND_ADDRESS_NO_PORT
            # Closes by a reset, so that no port stays occupied.
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            stream.bind((own[count % len(own)], 0))
            stream.connect_ex((ROBOT_ADDRESS, PORT))
            opened.append(stream)
            if first_message:
                selector.register(stream, selectors.EVENT_WRITE)
            count += 1
            if len(opened) > OPEN_MAX:
                oldest = opened.popleft()
                with contextlib.suppress(KeyError, ValueError):
                    selector.unregister(oldest)
                oldest.close()
        for key, _ in selector.select(0) if first_message else ():
            selector.unregister(key.fileobj)
            with contextlib.suppress(OSError):
                key.fileobj.send(first_message)
        if now >= shown + 1:
            print(count - before, flush=True)
            shown, before = now, count
        time.sleep(0.001)


class Relay:
    """A slow network between the operator and the robot, at a port of the operator's namespace. A connection to the robot begins one and
    a half round trips after the operator's, as with TCP; each byte then takes half a round trip."""

    def __init__(self, round_trip_s):
        self.round_trip_s = round_trip_s

    async def serve(self):
        server = await asyncio.start_server(self.relay, "127.0.0.1", 0)
        print(server.sockets[0].getsockname()[1], flush=True)
        async with server:
            await server.serve_forever()

    async def relay(self, near_reader, near_writer):
        await asyncio.sleep(1.5 * self.round_trip_s)
        try:
            far_reader, far_writer = await asyncio.open_connection(ROBOT_ADDRESS, PORT)
        except OSError:
            near_writer.close()
            return
        # What the operator sent meanwhile arrives with the connection.
        await asyncio.gather(self.carry(near_reader, far_writer, 0), self.carry(far_reader, near_writer, self.round_trip_s / 2))

    async def carry(self, reader, writer, first_delay_s):
        loop, delay_s = asyncio.get_running_loop(), first_delay_s
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                loop.call_later(delay_s, writer.write, data)
                delay_s = self.round_trip_s / 2
        loop.call_later(self.round_trip_s / 2, writer.close)


def start_robot(downbeat, link, folder, processes):
    """Makes the keys, and starts the robot."""
    keys = lambda *arguments: program.run(downbeat, "keys", *arguments, "--keys", "keys", folder=folder)
    (folder / "robot.yaml").write_text(fleet.robot_with_id("r0"))
    keys("init")
    keys("operator", "dora", "--role", "stop")
    keys("robot", "r0")
    secret = {"tls": ["--identity", "keys/robots/r0.pem"], "hmac": ["--secret", "keys/secrets/r0.secret"], "tcp": ["--insecure"]}[link]
    if link == "hmac":
        keys("secret", "r0")
    processes.start_listening(*on(ROBOTS, downbeat), "robot", "--init", "robot.yaml", "--id", "r0", "--listen",
                              f"{ROBOT_ADDRESS}:{PORT}", *secret, "--realtime", "off", robots=1, errors=folder / "errors", cwd=folder,
                              env={**os.environ, "DOWNBEAT_STATE": str(folder / "state-robot")})


def stops(downbeat, count, folder):
    """The durations of `count` stops in seconds, `None` for a stop that failed."""
    environment = {**os.environ, "DOWNBEAT_STATE": str(folder / "state")}
    for _ in range(count):
        begin = time.monotonic()
        ended = subprocess.run(on(OPERATOR, downbeat, "stop", "--fleet", "fleet.yaml"), cwd=folder, env=environment, capture_output=True,
                               text=True, timeout=STOP_TIMEOUT_S)
        took = time.monotonic() - begin
        if ended.returncode != 0:
            print(ended.stdout + ended.stderr, file=sys.stderr)
        yield took if ended.returncode == 0 else None


def quantile(values, share):
    return sorted(values)[max(0, -(-int(len(values) * share * 1000) // 1000) - 1)]


def main():
    parser = program.arguments(__doc__)
    parser.add_argument("--link", choices=["tls", "hmac", "tcp"], default="tls")
    parser.add_argument("--rates", type=int, nargs="+", default=[2000, 5000], help="connections per second")
    parser.add_argument("--addresses", type=int, default=1000)
    parser.add_argument("--networks", type=int, default=4, help="number of /24 that have these addresses")
    parser.add_argument("--round-trip-ms", type=float, default=150)
    parser.add_argument("--stops", type=int, default=50, help="stops at each rate")
    parser.add_argument("--send", choices=["nothing", "hello", "request"], default="nothing", help="message on each connection")
    options = parser.parse_args()
    downbeat = program.find_downbeat(options.downbeat)
    own = addresses(options.addresses, options.networks)
    first_message, missed = {"nothing": bytes, "hello": client_hello, "request": lambda: REQUEST}[options.send](), False
    with tempfile.TemporaryDirectory() as folder, network(own), Processes() as processes:
        folder = Path(folder)
        start_robot(downbeat, options.link, folder, processes)
        relay = processes.start(*on(OPERATOR, sys.executable, __file__, "--relay", str(options.round_trip_ms / 1000)), stdout=subprocess.PIPE)
        address = {"r0": f"{options.link}://127.0.0.1:{int(relay.stdout.readline())}"}
        (folder / "fleet.yaml").write_text(fleet.fleet(address, head="identity: keys/operators/dora.pem\n"))
        print("per second  stops  failed  median s   p90 s   max s", flush=True)
        for rate in [0, *options.rates]:
            flood = rate and processes.start(*on(STRANGERS, sys.executable, __file__, "--strangers", str(rate), first_message.hex()), *own,
                                             stdout=subprocess.PIPE)
            time.sleep(WARM_UP_S if flood else 0)
            took = list(stops(downbeat, options.stops, folder))
            if flood:
                flood.kill()
                opened = [int(line) for line in flood.stdout.read().split()]
                print(f"opened per second: {min(opened[1:])} to {max(opened[1:])}", file=sys.stderr)
            done = [each for each in took if each is not None]
            failed = len(took) - len(done)
            row = [quantile(done, share) if done else float("nan") for share in (0.5, 0.9, 1)]
            print(f"{rate:10}  {len(took):5}  {failed:6}  {row[0]:8.3f}  {row[1]:6.3f}  {row[2]:6.3f}", flush=True)
            if rate == options.rates[0]:
                missed = failed > 0 or row[1] > GOAL_P90_S or row[2] > GOAL_MAX_S
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--strangers"]:
        open_connections(sys.argv[4:], int(sys.argv[2]), bytes.fromhex(sys.argv[3]))
    if sys.argv[1:2] == ["--relay"]:
        asyncio.run(Relay(float(sys.argv[2])).serve())
    main()
