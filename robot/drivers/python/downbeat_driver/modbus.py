"""Writes values into the registers and coils of a Modbus device, over TCP or a serial line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value

TYPES = {"int16": 1, "uint16": 1, "int32": 2, "uint32": 2, "float32": 2}
"""The number of registers of each type."""
_PLACE = re.compile(r"([chi]?)(\d+)(?::(\w+))?(?:\*([0-9.]+))?")


@dataclass(frozen=True)
class Register:
    """A holding register `h`, an input register `i` or a coil `c`."""

    kind: str
    address: int
    type: str
    scale: float


class Modbus(Hardware):
    """Writes values into the registers and coils of a Modbus device, over TCP or a serial line."""

    extra = "modbus"
    package = "pymodbus"
    target_help = "HOST or HOST:PORT for Modbus TCP, or the serial port for Modbus RTU, such as /dev/ttyUSB0"
    place_help = "ADDRESS:TYPE*SCALE of a register, such as 40:int16*10; h40 is a holding register, i40 an input register, c40 a coil"

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--unit", type=int, default=1, help="number of the device at this address (default: 1)")
        parser.add_argument("--baud", type=int, default=19200, help="bits per second of a serial line (default: 19200)")
        parser.add_argument("--word-order", choices=["big", "little"], default="big", help="order of the registers of a 32-bit value (default: big)")

    def wire(self, device: Device, place: Optional[str]) -> Register:
        match = _PLACE.fullmatch(place or "")
        kind = match[1] or "h" if match else "h"
        if match is None or (match[3] or "int16") not in TYPES or (kind == "i" and not device.is_sensor):
            writable = "" if device.is_sensor else "; input registers can only be read"
            raise Refused(f"`{place}` is not a place for `{device.id}`, expected [h|i|c]ADDRESS[:TYPE][*SCALE], "
                          f"with a type of {', '.join(TYPES)}{writable}")
        return Register(kind, int(match[2]), match[3] or "int16", float(match[4] or 1))

    def connect(self) -> None:
        target = self.options.target
        client = self.module("pymodbus.client")
        if "/" in target:
            self.client = client.ModbusSerialClient(target, baudrate=self.options.baud, timeout=0.2, retries=1)
        else:
            host, _, port = target.partition(":")
            self.client = client.ModbusTcpClient(host, port=int(port or 502), timeout=0.5, retries=0)
        if not self.client.connect():
            raise ConnectionError(f"{target} accepts no connection")
        for device in self.wired:
            self._read(device)

    def _request(self, call: Any, *arguments: Any, **options: Any) -> Any:
        from pymodbus.exceptions import ModbusException

        try:
            answer = call(*arguments, device_id=self.options.unit, **options)
        except ModbusException as error:
            raise Lost(str(error)) from error
        if answer.isError():
            raise Refused(f"the device refuses the request for address {arguments[0]}: {answer}")
        self.answered()
        return answer

    def write(self, values: Sequence[Value]) -> None:
        for value in values:
            register = self.wired[value.device]
            if register.kind == "c":
                self._request(self.client.write_coil, register.address, value.value * register.scale >= 0.5)
                continue
            number = value.value * register.scale
            whole = number if register.type == "float32" else round(number)
            kind = self.client.DATATYPE[register.type.upper()]
            words = self.client.convert_to_registers(whole, kind, word_order=self.options.word_order)
            if len(words) == 1:
                self._request(self.client.write_register, register.address, words[0])
            else:
                self._request(self.client.write_registers, register.address, words)

    def _read(self, device: str) -> float:
        register = self.wired[device]
        if register.kind == "c":
            return float(self._request(self.client.read_coils, register.address, count=1).bits[0]) / register.scale
        call = self.client.read_input_registers if register.kind == "i" else self.client.read_holding_registers
        words = self._request(call, register.address, count=TYPES[register.type]).registers
        kind = self.client.DATATYPE[register.type.upper()]
        return float(self.client.convert_from_registers(words, kind, word_order=self.options.word_order)) / register.scale

    def read(self, sensor: str) -> float:
        with self._setting:
            return self._read(sensor)

    def position(self, device: str) -> Optional[float]:
        return self._read(device)

    def ask(self) -> None:
        self._read(next(iter(self.wired)))

    def disconnect(self) -> None:
        self.client.close()


if __name__ == "__main__":
    main(Modbus)
