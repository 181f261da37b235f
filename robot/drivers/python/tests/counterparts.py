"""Simulated counterparts of the ready drivers: programs that log each value that they receive.

`counterparts.py NAME AT LOG`: AT is the port or the path at which the counterpart listens. Each line of LOG is the time in nanoseconds, the
place of a value, and the value as the hardware receives it. The program prints `ready` as soon as it listens.
"""

import os
import pathlib
import socket
import struct
import sys
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


def serve_modbus(port, log):
    """The server of pymodbus with 100 registers."""
    from pymodbus.server import StartTcpServer
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
    print("ready", flush=True)
    StartTcpServer(SimDevice(1, simdata=tuple(blocks)), address=("127.0.0.1", port), trace_pdu=logged, trace_connect=connected)


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


def main():
    name, at, path = sys.argv[1:]
    log = Log(path)
    lines = {"dynamixel": Dynamixel, "maestro": Maestro, "serial_line": SerialLine}
    if name in lines:
        serve_line(at, lines[name](log).receive)
    else:
        {"modbus": serve_modbus, "opcua": serve_opcua}[name](int(at), log)


if __name__ == "__main__":
    main()
