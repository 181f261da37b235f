"""Simulated counterparts of the ready drivers: programs that log each value that they receive.

`counterparts.py NAME AT LOG`: AT is the port or the path at which the counterpart listens. Each line of LOG is the time in nanoseconds, the
place of a value, and the value as the hardware receives it. The program prints `ready` as soon as it listens.
"""

import os
import pathlib
import socket
import struct
import sys
import threading
import time
import tty

MAESTRO_TARGET, MAESTRO_POSITION, MAESTRO_ERRORS = 0x84, 0x90, 0xA1


class Log:
    """Writes each value with its time."""

    def __init__(self, path):
        self.file = open(path, "a", buffering=1)

    def value(self, place, value):
        self.file.write(f"{time.time_ns()} {place} {value}\n")


def serve_line(path, receive):
    """Listens on a pseudo terminal at `path`. `receive` takes the bytes so far, and returns the rest and the answer."""
    controller, port = os.openpty()
    tty.setraw(port)
    link = pathlib.Path(path)
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(port))
    print("ready", flush=True)
    rest = b""
    while True:
        rest, answer = receive(rest + os.read(controller, 4096))
        if answer:
            os.write(controller, answer)


class Dynamixel:
    """Servos with protocol 2.0: 1 and 2 hold positions, 3 turns. Each jumps to its goal."""

    def __init__(self, log):
        self.log = log
        self.tables = {servo: bytearray(200) for servo in (1, 2, 3)}
        for servo, table in self.tables.items():
            table[11] = 1 if servo == 3 else 3
            table[48:52], table[132:136] = (4095).to_bytes(4, "little"), (1024).to_bytes(4, "little")
        self.lose = int(os.environ.get("LOSE", "0"))
        """Every nth answer is lost, or none if it is zero."""
        self.answers = 0

    def receive(self, data):
        answer = b""
        while (begin := data.find(b"\xff\xff\xfd\x00")) >= 0 and len(data) >= begin + 7:
            end = begin + 7 + int.from_bytes(data[begin + 5 : begin + 7], "little")
            if len(data) < end:
                break
            packet, data = data[begin:end], data[end:]
            if crc(packet[:-2]) == int.from_bytes(packet[-2:], "little"):
                answer += self.obey(packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"))
        return data, answer

    def obey(self, servo, instruction, parameters):
        address = int.from_bytes(parameters[:2], "little")
        if instruction == 0x83:
            size = int.from_bytes(parameters[2:4], "little")
            for at in range(4, len(parameters), 1 + size):
                self.put(parameters[at], address, parameters[at + 1 : at + 1 + size])
            return b""
        if servo not in self.tables:
            return b""
        if instruction == 1:
            return self.status(servo, b"\x06\x04\x01")
        if instruction == 2:
            size = int.from_bytes(parameters[2:4], "little")
            return self.status(servo, bytes(self.tables[servo][address : address + size]))
        self.put(servo, address, parameters[2:])
        return self.status(servo, b"")

    def put(self, servo, address, data):
        table = self.tables.get(servo)
        if table is None:
            return
        table[address : address + len(data)] = data
        if address == 116 and table[64]:
            table[132:136] = data
        if address in (64, 104, 116):
            self.log.value(f"{servo}.{address}", int.from_bytes(data, "little", signed=True))

    def status(self, servo, parameters):
        self.answers += 1
        if self.lose and self.answers % self.lose == 0:
            return b""
        head = b"\xff\xff\xfd\x00" + bytes([servo]) + (len(parameters) + 4).to_bytes(2, "little") + b"\x55\x00" + parameters
        return head + crc(head).to_bytes(2, "little")


def crc(data):
    """The checksum of protocol 2.0: CRC-16 with the polynomial 0x8005."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
    return value


class Maestro:
    """A servo controller that executes compact commands."""

    def __init__(self, log):
        self.log, self.targets = log, {}

    def receive(self, data):
        answer = b""
        while data:
            size = {MAESTRO_TARGET: 4, MAESTRO_POSITION: 2, MAESTRO_ERRORS: 1}[data[0]]
            if len(data) < size:
                break
            if data[0] == MAESTRO_TARGET:
                self.targets[data[1]] = data[2] | data[3] << 7
                self.log.value(data[1], self.targets[data[1]])
            elif data[0] == MAESTRO_POSITION:
                answer += self.targets.get(data[1], 0).to_bytes(2, "little")
            else:
                answer += b"\0\0"
            data = data[size:]
        return data, answer


class SerialLine:
    """A microcontroller that answers each line: `ok`, or the last value of a device."""

    def __init__(self, log):
        self.log, self.values = log, {}

    def receive(self, data):
        *lines, rest = data.split(b"\n")
        answer = b""
        for line in lines:
            name, _, value = line.decode().partition(" ")
            if name == "?":
                answer += b"ok\n"
            elif name.endswith("?"):
                answer += self.values.get(name[:-1], "error no value").encode() + b"\n"
            elif value == "66":
                answer += b"error too hot\n"
            else:
                self.values[name] = value
                self.log.value(name, value)
                answer += b"ok\n"
        return rest, answer


def joined_lines(path):
    """Two pseudo terminals that are connected with each other, one of them at `path`. Returns the name of the other."""
    (one, port), (other, server) = os.openpty(), os.openpty()
    for line in (port, server):
        tty.setraw(line)

    def copy(source, target):
        while True:
            os.write(target, os.read(source, 4096))

    for ends in ((one, other), (other, one)):
        threading.Thread(target=copy, args=ends, daemon=True).start()
    pathlib.Path(path).symlink_to(os.ttyname(port))
    return os.ttyname(server)


def serve_modbus(at, log):
    """The server of pymodbus with 100 registers: at a TCP port, or at the path of a serial line."""
    from pymodbus.server import StartSerialServer, StartTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    def logged(is_sent, pdu):
        if not is_sent and pdu.function_code in (5, 6, 16):
            written = pdu.bits[:1] if pdu.function_code == 5 else pdu.registers
            log.value(pdu.address, " ".join(map(str, map(int, written))))
        return pdu

    def connected(is_connected):
        pass

    blocks = [[SimData(0, count=100, datatype=DataType.BITS)], [SimData(0, count=100, datatype=DataType.BITS)],
              [SimData(0, count=100, datatype=DataType.REGISTERS)], [SimData(0, count=100, values=7, datatype=DataType.REGISTERS)]]
    device = SimDevice(1, simdata=tuple(blocks))
    if at.isdigit():
        print("ready", flush=True)
        StartTcpServer(device, address=("127.0.0.1", int(at)), trace_pdu=logged, trace_connect=connected)
    else:
        line = joined_lines(at)
        print("ready", flush=True)
        StartSerialServer(device, port=line, baudrate=19200, trace_pdu=logged, trace_connect=connected)


def serve_opcua(port, log):
    """The server of asyncua with two variables."""
    from asyncua.sync import Server
    from asyncua import ua

    server = Server()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    folder = server.nodes.objects
    variables = [folder.add_variable(ua.NodeId(name, 2), name, 0.0) for name in ("arm", "lamp")]
    for variable in variables:
        variable.set_writable()
    folder.add_variable(ua.NodeId("count", 2), "count", 3, ua.VariantType.Int32).set_writable()

    class Changes:
        def datachange_notification(self, node, value, data):
            log.value(node.nodeid.Identifier, value)

    server.start()
    server.create_subscription(1, Changes()).subscribe_data_change(variables)
    print("ready", flush=True)
    while True:
        time.sleep(1)


class Crazyflie:
    """A drone behind UDP that is at the position of its last setpoint, and reports it. The header has the port in its upper four bits."""

    VARIABLES = ["stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "stateEstimate.yaw", "pm.vbat"]
    CONSOLE, PARAM, COMMANDER, MEM, LOG, GENERIC, HIGH_LEVEL, SUPERVISOR, PLATFORM, LINK = 0, 2, 3, 4, 5, 7, 8, 9, 13, 15

    def __init__(self, log, port):
        self.log = log
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.position = [0.0, 0.0, 0.0, 0.0]
        self.blocks, self.started, self.peer = {}, set(), None

    def serve(self):
        threading.Thread(target=self.report, daemon=True).start()
        print("ready", flush=True)
        while True:
            packet, self.peer = self.socket.recvfrom(64)
            port, channel, data = packet[0] >> 4, packet[0] & 3, packet[1:]
            for answer in self.obey(port, channel, data):
                self.socket.sendto(packet[:1] + answer, self.peer)

    def report(self):
        while True:
            time.sleep(0.05)
            values = [*self.position, 4.1]
            for block in list(self.started):
                floats = b"".join(struct.pack("<f", values[variable]) for variable in self.blocks[block])
                self.socket.sendto(bytes([self.LOG << 4 | 2, block, 0, 0, 0]) + floats, self.peer)

    def obey(self, port, channel, data):
        if port == self.LINK and channel == 1:
            yield b"Bitcraze Crazyflie\0"
        elif port == self.PLATFORM and channel == 1:
            yield bytes([data[0], 12])
        elif port == self.MEM:
            yield bytes([data[0], 0])
        elif port in (self.LOG, self.PARAM) and channel == 0:
            yield self.contents(self.VARIABLES if port == self.LOG else [], data)
        elif port == self.LOG and channel == 1:
            if data[0] == 6:
                self.blocks[data[1]] = list(data[3::3])
            elif data[0] == 3:
                self.started.add(data[1])
            elif data[0] == 5:
                self.started.clear()
            yield bytes([data[0], data[1] if len(data) > 1 else 0, 0])
        elif port == self.GENERIC and channel == 0 and data[0] == 7:
            self.position = list(struct.unpack("<ffff", data[1:17]))
            for axis, value in zip(("x", "y", "z", "yaw"), self.position):
                self.log.value(axis, f"{value:.6g}")
        elif port == self.HIGH_LEVEL and data[0] == 7:
            self.position[2] = struct.unpack_from("<f", data, 2)[0]
            self.log.value("take_off", f"{self.position[2]:.6g}")
        elif port in (self.COMMANDER, self.HIGH_LEVEL) or port == self.SUPERVISOR and channel == 1:
            names = {self.COMMANDER: "setpoint", self.HIGH_LEVEL: "high_level", self.SUPERVISOR: "supervisor"}
            self.log.value(names[port], data[:2].hex())

    def contents(self, names, data):
        """An answer about a table of variables: their number, or one of them."""
        if data[0] == 3:
            return bytes([3]) + struct.pack("<HI", len(names), os.getpid())
        group, name = names[data[1]].split(".")
        return data[:3] + b"\x07" + group.encode() + b"\0" + name.encode() + b"\0"


class UrController:
    """The controller of an arm at its fixed ports: dashboard, scripts and real-time data. The arm is at the last target of servoJ."""

    DASHBOARD, SCRIPTS, DATA = 29999, 30003, 30004
    SERVOJ, STOP_SCRIPT, WATCHDOG, CONTINUOUS = 11, 255, 99, (0, 11, 99)
    READY, DONE = 1, 2
    TYPES = {"timestamp": "d", "actual_q": "6d", "target_q": "6d", "robot_status_bits": "I", "safety_status_bits": "I", "runtime_state": "I",
             "actual_digital_input_bits": "Q", "actual_digital_output_bits": "Q", "robot_mode": "i", "joint_mode": "6i", "safety_mode": "i",
             "actual_tool_accelerometer": "3d"}

    def __init__(self, log, host):
        self.log, self.host = log, host
        self.joints, self.is_running, self.state, self.answered = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0], False, self.READY, 0

    def serve(self):
        for port, serve in ((self.DASHBOARD, self.serve_dashboard), (self.SCRIPTS, self.serve_scripts), (self.DATA, self.serve_data)):
            listener = socket.create_server((self.host, port))
            threading.Thread(target=self.accept, args=(listener, serve), daemon=True).start()
        print("ready", flush=True)
        threading.Event().wait()

    @staticmethod
    def accept(listener, serve):
        while True:
            threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    def serve_dashboard(self, peer):
        peer.sendall(b"Connected: Universal Robots Dashboard Server\n")
        while line := peer.recv(1024):
            answers = {b"PolyscopeVersion": b"URSoftware 5.11.0.108249 (Jan 01 2022)", b"get serial number": b"20225500001"}
            peer.sendall(answers.get(line.strip(), b"true") + b"\n")

    def serve_scripts(self, peer):
        while peer.recv(65536):
            self.is_running, self.state = True, self.READY

    def serve_data(self, peer):
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream, inputs, outputs = peer.makefile("rb"), {}, []
        while head := read(stream, 3):
            size, kind = struct.unpack(">HB", head)
            data = stream.read(size - 3)
            if kind == ord("U"):
                self.obey(struct.unpack_from(">" + self.kinds(inputs[data[0]]), data, 1))
                continue
            answer = b"\x01"
            if kind == ord("v"):
                answer = struct.pack(">IIII", 5, 11, 0, 0)
            elif kind == ord("O"):
                frequency = struct.unpack_from(">d", data)[0]
                outputs = data[8:].decode().strip(",").split(",")
                answer += b"DOUBLE"
            elif kind == ord("I"):
                inputs[len(inputs) + 1] = data.decode().strip(",").split(",")
                answer = bytes([len(inputs)]) + b"DOUBLE"
            peer.sendall(struct.pack(">HB", 3 + len(answer), kind) + answer)
            if kind == ord("S"):
                threading.Thread(target=self.report, args=(peer, outputs, 1 / frequency), daemon=True).start()

    def kinds(self, names):
        integer = ("input_int", "output_int", "speed_slider_mask")
        return "".join("i" if name.startswith(integer) else "B" if "digital" in name else self.TYPES.get(name, "d") for name in names)

    def obey(self, values):
        command, self.answered = values[0], time.monotonic()
        if command == self.SERVOJ and self.is_running:
            self.joints = list(values[1:7])
            for joint, angle in enumerate(self.joints):
                self.log.value(joint, f"{angle:.6f}")
        elif command == self.STOP_SCRIPT:
            self.log.value("stopped", 1)
            self.is_running = False
        self.state = self.READY if command in self.CONTINUOUS else self.DONE

    def report(self, peer, outputs, period):
        kinds = {name: self.TYPES.get(name, "i" if "output_int" in name else "d" if "register" in name or name in SINGLE else "6d") for name in outputs}
        while True:
            packet = b"\x01"
            for name, kind in kinds.items():
                count = int(kind[:-1] or 1)
                known = {"timestamp": [time.monotonic()], "actual_q": self.joints, "target_q": self.joints, "robot_status_bits": [1 | self.is_running << 1],
                         "safety_status_bits": [1], "runtime_state": [1 + self.is_running], "output_int_register_0": [self.state]}
                packet += struct.pack(">" + kind, *known.get(name, [0] * count))
            try:
                peer.sendall(struct.pack(">HB", 3 + len(packet), ord("U")) + packet)
            except OSError:
                return
            time.sleep(period)


def read(stream, size):
    """The next bytes of a connection, or nothing once it has ended."""
    try:
        return stream.read(size)
    except OSError:
        return b""


SINGLE = {"actual_execution_time", "speed_scaling", "target_speed_fraction", "actual_momentum", "actual_main_voltage", "actual_robot_voltage",
          "actual_robot_current", "standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1"}
"""Real-time data that is a single number."""


def main():
    name, at, path = sys.argv[1:]
    log = Log(path)
    lines = {"dynamixel": Dynamixel, "maestro": Maestro, "serial_line": SerialLine}
    if name in lines:
        serve_line(at, lines[name](log).receive)
    elif name == "crazyflie":
        Crazyflie(log, int(at)).serve()
    elif name == "ur_rtde":
        UrController(log, at).serve()
    else:
        {"modbus": serve_modbus, "opcua": serve_opcua}[name](at, log)


if __name__ == "__main__":
    main()
