"""Publishes each value to a topic of an MQTT broker, and reads sensors from topics."""

from __future__ import annotations

import argparse
import json
import os
import threading
import time
import uuid
from collections.abc import Sequence
from typing import Any, Optional

from .driver import Refused
from .hardware import Hardware, Lost, main
from .robot import Device, Value


class Mqtt(Hardware):
    """Publishes each value to a topic of an MQTT broker, as a number or in a JSON object, and reads sensors from topics."""

    extra = "mqtt"
    package = "paho-mqtt"
    target_help = "HOST or HOST:PORT of the broker"
    place_help = "TOPIC, or TOPIC:KEY for JSON objects with this key; by default ROBOT/DEVICE"
    moves_per_second = 20.0

    @classmethod
    def add_options(cls, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--alive", metavar="TOPIC",
                            help="a topic to which the hardware publishes by itself; without it, only the broker is known to be alive")
        parser.add_argument("--silence-ms", type=float, default=1000,
                            help="longest time between two messages to the topic of --alive (default: 1000)")
        parser.add_argument("--user", help="name for the broker; the password is in the environment variable MQTT_PASSWORD")

    def wire(self, device: Device, place: Optional[str]) -> tuple[str, str]:
        topic, _, key = (place or f"{self.robot.id}/{device.id}").partition(":")
        if not topic or any(wildcard in topic for wildcard in "+#"):
            raise Refused(f"`{place}` is not a place for `{device.id}`, expected TOPIC or TOPIC:KEY, without wildcards")
        return topic, key

    def connect(self) -> None:
        mqtt = self.module("paho.mqtt.client")
        host, _, port = self.options.target.partition(":")
        # A client that reconnected would send values that are no longer due.
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        if self.options.user:
            self.client.username_pw_set(self.options.user, os.environ.get("MQTT_PASSWORD"))
        self.ready, self.asked = threading.Event(), threading.Event()
        self.refusal = "the broker does not answer"
        self.client.on_connect = self._connected
        self.client.on_disconnect = lambda *_: self._ended or self.fault("the broker has closed the connection")
        self.client.on_message = lambda _client, _data, message: self._received(message.topic, message.payload)
        self.client.on_unsubscribe = lambda *_: self.asked.set()
        self.client.connect(host, int(port or 1883))
        self.client.loop_start()
        if not self.ready.wait(5) or self.refusal:
            raise ConnectionError(self.refusal)
        if self.options.alive:
            self.hardware_silence_ms = self.options.silence_ms

    def _connected(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        self.refusal = str(reason) if reason.is_failure else ""
        topics = {topic for device, (topic, _) in self.wired.items() if self.robot.devices[device].is_sensor}
        for topic in topics | ({self.options.alive} if self.options.alive else set()):
            client.subscribe(topic)
        self.ready.set()

    def _received(self, topic: str, payload: bytes) -> None:
        if topic == self.options.alive:
            self.answered()
        for device, (of, key) in self.wired.items():
            if of == topic and self.robot.devices[device].is_sensor:
                try:
                    self.push_reading(device, float(json.loads(payload)[key] if key else payload))
                except (ValueError, TypeError, KeyError) as error:
                    self.log.warning("%s is not a reading of %s: %s", payload[:80], device, error)

    def write(self, values: Sequence[Value]) -> None:
        sent = [self.client.publish(self.wired[value.device][0], self._payload(value), qos=1) for value in values]
        until = time.monotonic() + 0.5
        for info in sent:
            info.wait_for_publish(max(0.0, until - time.monotonic()))
            if not info.is_published():
                raise ConnectionError("the broker did not confirm a value within 500 ms")
        if not self.options.alive:
            self.answered()

    def _payload(self, value: Value) -> str:
        numbers = [round(number, 9) for number in (value.value, *value.more)]
        key = self.wired[value.device][1]
        if key:
            return json.dumps({key: numbers if value.more else numbers[0]})
        return " ".join(f"{number:g}" if abs(number) < 1e5 else repr(number) for number in numbers)

    def ask(self) -> None:
        if self.options.alive:
            raise Lost(f"no message to {self.options.alive}")
        # The broker answers this request without informing other clients.
        self.asked.clear()
        self.client.unsubscribe(f"downbeat/{uuid.uuid4()}")
        if not self.asked.wait(0.3):
            raise Lost("the broker did not answer within 300 ms")

    def disconnect(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


if __name__ == "__main__":
    main(Mqtt)
