"""Writes values into the variables of an OPC UA server."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import Any, Optional

from .driver import Refused
from .hardware import Hardware, main
from .robot import Device, Value

SERVER_TIME = "i=2258"
"""The variable that every server updates by itself."""


class OpcUa(Hardware):
    """Writes values into the variables of an OPC UA server; values that are due at the same instant in one request."""

    extra = "opcua"
    package = "asyncua"
    target_help = "address of the server, such as opc.tcp://plc.local:4840"
    place_help = "id of the variable, such as ns=2;s=Arm.Target; quote it, because the shell splits commands at `;`"
    moves_per_second = 50.0

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--user", help="name for the server; the password is in the environment variable OPCUA_PASSWORD")
        parser.add_argument("--security", metavar="TEXT", help="security string of asyncua: POLICY,MODE,CERTIFICATE,KEY")

    def wire(self, device: Device, place: Optional[str]) -> str:
        if place is None:
            raise Refused(f"device `{device.id}` has no place, expected {device.id}=NODE, for example '{device.id}=ns=2;s=Arm.Target'")
        return place

    def connect(self) -> None:
        self.ua = self.module("asyncua.ua")
        self.client = self.module("asyncua.sync").Client(self.options.target, timeout=0.8)
        if self.options.user:
            self.client.set_user(self.options.user)
            self.client.set_password(os.environ.get("OPCUA_PASSWORD", ""))
        if self.options.security:
            self.client.set_security_string(self.options.security)
        self.client.connect()
        self.nodes: dict[str, Any] = {device: self.client.get_node(place) for device, place in self.wired.items()}
        self.types: dict[str, Any] = {}
        for device, node in self.nodes.items():
            try:
                self.types[device] = node.read_data_type_as_variant_type()
            except self.ua.UaStatusCodeError as error:
                raise Refused(f"the server has no variable `{self.wired[device]}` for `{device}`: {error}") from error
        self.clock = self.client.get_node(SERVER_TIME)

    def write(self, values: Sequence[Value]) -> None:
        # Without times of its own: many servers refuse values that have one.
        data = [self.ua.DataValue(self.ua.Variant(self._typed(value), self.types[value.device])) for value in values]
        self.client.write_values([self.nodes[value.device] for value in values], data)
        self.answered()

    def _typed(self, value: Value) -> Any:
        kind = self.types[value.device]
        if kind == self.ua.VariantType.Boolean:
            return value.value >= 0.5
        is_float = kind in (self.ua.VariantType.Float, self.ua.VariantType.Double)
        numbers = [number if is_float else round(number) for number in (value.value, *value.more)]
        return numbers if value.more else numbers[0]

    def read(self, sensor: str) -> float:
        with self._setting:
            value = float(self.nodes[sensor].read_value())
            self.answered()
            return value

    def position(self, device: str) -> Optional[float]:
        return float(self.nodes[device].read_value())

    def ask(self) -> None:
        self.clock.read_value()

    def disconnect(self) -> None:
        self.client.disconnect()


if __name__ == "__main__":
    main(OpcUa)
