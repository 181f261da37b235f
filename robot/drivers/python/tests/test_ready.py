"""The ready drivers, each with its counterpart. A test whose package is missing is skipped: `pip install '.[NAME]'`."""

import importlib.util
import json
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import unittest

TESTS = pathlib.Path(__file__).parent
DEADLINE_S = 20


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def device(name, control_type, low, high, **keys):
    return {"id": name, "available_control_types": {control_type: {"min_value": low, "max_value": high}}, **keys}


class Program:
    """A driver as a process, to which lines are written as by an edge."""

    def __init__(self, module, *arguments, **environment):
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment}
        paths = [str(TESTS.parent), environment.get("PYTHONPATH", "")]
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        self.process = subprocess.Popen([sys.executable, "-m", f"downbeat_driver.{module}", *map(str, arguments)],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
        self.pushed, self.errors = [], []
        self.drain = threading.Thread(target=lambda: self.errors.extend(self.process.stderr), daemon=True)
        self.drain.start()

    def ask(self, line):
        """The answer to a line. Reports that come before it are kept in `pushed`."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        while True:
            answer = self.process.stdout.readline().strip()
            if not answer.startswith(("reading ", "fault ")):
                return answer
            self.pushed.append(answer)

    def init(self, *devices):
        return self.ask("init " + json.dumps({"block": {"id": "r", "devices": list(devices)}}))

    def end(self):
        self.process.stdin.close()
        rest = self.process.stdout.read().splitlines()
        self.pushed.extend(rest)
        self.process.stdout.close()
        code = self.process.wait(DEADLINE_S)
        self.drain.join(DEADLINE_S)
        self.process.stderr.close()
        return code


class Ready(unittest.TestCase):
    """Starts counterparts and drivers, and ends them."""

    package = None

    def setUp(self):
        if self.package is not None and importlib.util.find_spec(self.package) is None:
            self.skipTest(f"the package of the module `{self.package}` is not installed")
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.log = self.folder / "log"

    def counterpart(self, name, at, **environment):
        command = [sys.executable, TESTS / "counterparts.py", name, at, self.log]
        process = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, env={**os.environ, **environment})
        self.ended_at_the_end(process)
        self.assertEqual(process.stdout.readline(), b"ready\n")
        return process

    def ended_at_the_end(self, process):
        def end():
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()

        self.addCleanup(end)

    def driver(self, module, *arguments, **environment):
        driver = Program(module, *arguments, **environment)
        self.ended_at_the_end(driver.process)
        self.assertEqual(driver.ask("hello"), "ok 2")
        return driver

    def listening(self, port):
        until = time.monotonic() + DEADLINE_S
        while time.monotonic() < until:
            try:
                return socket.create_connection(("127.0.0.1", port)).close()
            except OSError:
                time.sleep(0.02)
        self.fail("the counterpart does not listen")

    def received(self):
        """The values that the counterpart has received, without their times."""
        return [line.split(" ", 1)[1] for line in self.log.read_text().splitlines()]

    def await_received(self, value):
        until = time.monotonic() + DEADLINE_S
        while value not in self.received():
            if time.monotonic() > until:
                self.fail(f"`{value}` was not received, but {self.received()}")
            time.sleep(0.01)

    def assert_fails_without(self, driver, lines=("ping",)):
        """The driver reports within the time of the edge that its counterpart is gone."""
        until = time.monotonic() + DEADLINE_S
        while time.monotonic() < until:
            for line in lines:
                answer = driver.ask(line)
                word, _, age = answer.partition(" ")
                if word == "error" or driver.pushed and driver.pushed[-1].startswith("fault") or word == "ok" and float(age or 0) > 1000:
                    return
            time.sleep(0.05)
        self.fail("the driver did not notice that its counterpart is gone")


class Serial(Ready):
    package = "serial"

    def test_lines_are_sent_and_answers_are_read(self):
        port = self.folder / "port"
        controller = self.counterpart("serial_line", port)
        driver = self.driver("serial_line", port, "arm=A")
        self.assertTrue(driver.init(device("arm", "position", 0, 90), device("arm_angle", "sensor", 0, 90)).startswith("ok {"))
        self.assertEqual(driver.ask("set arm position 12.5"), "ok")
        self.assertEqual(self.received(), ["A 12.5"])
        self.assertEqual(driver.ask("read arm_angle"), "error the controller answered `error no value` to `arm_angle?`")
        self.assertEqual(driver.ask("set arm position 66"), "error the controller answered `error too hot` to `A 66`")
        controller.kill()
        self.assert_fails_without(driver)

    def test_a_ramp_ends_at_its_target(self):
        port = self.folder / "port"
        self.counterpart("serial_line", port)
        driver = self.driver("serial_line", port)
        driver.init(device("arm", "position", 0, 90))
        driver.ask("set arm position 10")
        driver.ask("ramp arm position 20 100")
        self.await_received("arm 20")
        driver.end()
        self.assertEqual(self.received()[-1], "arm 20")

    def test_a_maestro_receives_quarters_of_microseconds(self):
        port = self.folder / "port"
        controller = self.counterpart("maestro", port)
        driver = self.driver("maestro", port, "pan=2:1000-2000", "tilt=3", "pan_angle=2:1000-2000")
        devices = [device("pan", "position", -90, 90), device("tilt", "position", 0, 100), device("pan_angle", "sensor", -90, 90)]
        self.assertTrue(driver.init(*devices).startswith("ok {"))
        self.assertEqual(driver.ask("read pan_angle"), "error the channel of `pan_angle` has no pulse yet")
        frame = [{"device": name, "control_type": "position", "values": [value]} for name, value in (("pan", 45), ("tilt", 0))]
        self.assertEqual(driver.ask("frame " + json.dumps(frame)), "ok")
        self.assertEqual(driver.ask("read pan_angle"), "45.0")
        self.assertEqual(self.received(), ["2 7000", "3 4000"])
        controller.kill()
        self.assert_fails_without(driver)


class Pca9685(Ready):
    def test_pulses_are_counted_in_ticks(self):
        path = os.pathsep.join([str(TESTS / "fakes")])
        driver = self.driver("pca9685", "1", "pan=4", I2C_LOG=str(self.log), PYTHONPATH=path)
        self.assertTrue(driver.init(device("pan", "position", 0, 180)).startswith("ok {"))
        self.assertEqual(driver.ask("set pan position 90"), "ok")
        # 1500 us of 4.88 us each, because the prescaler of 121 gives 50.03 pulses per second.
        self.assertEqual(self.received(), ["4 307"])
        (self.folder / "log.disconnected").touch()
        self.assert_fails_without(driver)


class Dynamixel(Ready):
    package = "dynamixel_sdk"
    devices = [device("shoulder", "position", -90, 90, unit="deg"), device("elbow", "position", -1, 1, unit="rad"),
               device("wheel", "speed", -5, 5, unit="rpm"), device("angle", "sensor", -180, 180, unit="deg")]
    places = ["shoulder=1", "elbow=2", "wheel=3", "angle=1"]

    def test_servos_receive_ticks_and_stay_where_they_are_at_first(self):
        port = self.folder / "port"
        bus = self.counterpart("dynamixel", port)
        driver = self.driver("dynamixel", port, *self.places)
        self.assertTrue(driver.init(*self.devices).startswith("ok {"))
        self.assertEqual(self.received(), ["1.116 1024", "1.64 1", "2.116 1024", "2.64 1", "3.64 1"])
        frame = [("shoulder", "position", 45), ("elbow", "position", 0.5), ("wheel", "speed", 2.29)]
        lines = [{"device": name, "control_type": kind, "values": [value]} for name, kind, value in frame]
        self.assertEqual(driver.ask("frame " + json.dumps(lines)), "ok")
        self.assertAlmostEqual(float(driver.ask("read angle")), 45, places=6)
        self.assertEqual(self.received()[5:], ["1.116 2560", "2.116 2374", "3.104 10"])
        self.assertEqual(driver.end(), 0)
        self.assertEqual(self.received()[8:], ["3.104 0"])
        bus.kill()

    def test_a_lost_answer_is_not_a_failure_but_a_dead_bus_is(self):
        port = self.folder / "port"
        bus = self.counterpart("dynamixel", port, LOSE="5")
        driver = self.driver("dynamixel", port, *self.places)
        self.assertTrue(driver.init(*self.devices).startswith("ok {"))
        for _ in range(10):
            time.sleep(0.1)
            word, age = driver.ask("ping").split()
            self.assertEqual(word, "ok")
            self.assertLess(float(age), 500)
        bus.kill()
        self.assert_fails_without(driver)

    def test_a_range_beyond_the_servo_is_refused(self):
        port = self.folder / "port"
        self.counterpart("dynamixel", port)
        driver = self.driver("dynamixel", port, "shoulder=1")
        self.assertIn("may go from -200 to 200 deg, but servo 1 from -180.0 to 179.9", driver.init(device("shoulder", "position", -200, 200)))
        self.assertEqual(self.received(), [])

    def test_a_servo_in_the_wrong_mode_is_refused(self):
        port = self.folder / "port"
        self.counterpart("dynamixel", port)
        driver = self.driver("dynamixel", port, "wheel=1")
        self.assertIn("has the operating mode 3, expected 1", driver.init(device("wheel", "speed", -5, 5)))


class Modbus(Ready):
    package = "pymodbus"

    def test_registers_and_coils_receive_values(self):
        port = free_port()
        server = self.counterpart("modbus", port)
        self.listening(port)
        driver = self.driver("modbus", f"127.0.0.1:{port}", "arm=40:int16*10", "level=50:float32", "lamp=c3", "back=40*10", "input=i9")
        devices = [device("arm", "position", -90, 90), device("level", "position", 0, 1), device("lamp", "position", 0, 1),
                   device("back", "sensor", -90, 90), device("input", "sensor", 0, 9)]
        self.assertTrue(driver.init(*devices).startswith("ok {"))
        for line in ("set arm position -12.5", "set level position 0.5", "set lamp position 1"):
            self.assertEqual(driver.ask(line), "ok")
        self.assertEqual(self.received(), ["40 65411", "50 16128 0", "3 1"])
        self.assertEqual([driver.ask("read back"), driver.ask("read input")], ["-12.5", "7.0"])
        server.kill()
        self.assert_fails_without(driver)

    def test_a_serial_line_is_used_as_a_port(self):
        if importlib.util.find_spec("serial") is None:
            self.skipTest("the package pyserial is not installed")
        port = self.folder / "port"
        server = self.counterpart("modbus", port)
        driver = self.driver("modbus", port, "arm=40:int16*10", "back=40*10")
        answer = driver.init(device("arm", "position", -90, 90), device("back", "sensor", -90, 90))
        self.assertTrue(answer.startswith("ok {"), answer)
        self.assertEqual((driver.ask("set arm position -12.5"), driver.ask("read back")), ("ok", "-12.5"))
        self.assertEqual(self.received(), ["40 65411"])
        server.kill()
        self.assert_fails_without(driver)

    def test_a_missing_register_is_refused_before_the_start(self):
        port = free_port()
        self.counterpart("modbus", port)
        self.listening(port)
        driver = self.driver("modbus", f"127.0.0.1:{port}", "arm=4000")
        self.assertIn("the device refuses the request for address 4000", driver.init(device("arm", "position", -90, 90)))

    def test_an_invalid_place_is_explained(self):
        driver = self.driver("modbus", "127.0.0.1:1", "arm=40:int17")
        self.assertEqual(driver.init(device("arm", "position", -90, 90)),
                         "error `40:int17` is not a place for `arm`, expected [h|i|c]ADDRESS[:TYPE][*SCALE], with a type of int16, uint16, "
                         "int32, uint32, float32; input registers can only be read")


class OpcUa(Ready):
    package = "asyncua"

    def test_variables_receive_values_of_their_type(self):
        port = free_port()
        server = self.counterpart("opcua", port)
        driver = self.driver("opcua", f"opc.tcp://127.0.0.1:{port}/", "arm=ns=2;s=arm", "lamp=ns=2;s=lamp", "count=ns=2;s=count", "seen=ns=2;s=count")
        devices = [device("arm", "position", -90, 90), device("lamp", "position", 0, 1), device("count", "position", 0, 9), device("seen", "sensor", 0, 9)]
        self.assertTrue(driver.init(*devices).startswith("ok {"))
        frame = [{"device": name, "control_type": "position", "values": [value]} for name, value in (("arm", 45.5), ("lamp", 1), ("count", 4))]
        self.assertEqual(driver.ask("frame " + json.dumps(frame)), "ok")
        self.await_received("arm 45.5")
        self.await_received("lamp 1.0")
        self.assertEqual(driver.ask("read seen"), "4.0")
        server.kill()
        self.assert_fails_without(driver)

    def test_a_missing_variable_is_refused_before_the_start(self):
        port = free_port()
        self.counterpart("opcua", port)
        driver = self.driver("opcua", f"opc.tcp://127.0.0.1:{port}/", "arm=ns=2;s=leg")
        self.assertIn("the server has no variable `ns=2;s=leg` for `arm`", driver.init(device("arm", "position", -90, 90)))


class Mqtt(Ready):
    package = "paho"

    def broker(self, port):
        mosquitto = shutil.which("mosquitto", path=os.environ["PATH"] + ":/usr/sbin")
        if mosquitto is None:
            self.skipTest("mosquitto is not installed: apt-get install mosquitto mosquitto-clients")
        broker = subprocess.Popen([mosquitto, "-p", str(port)], stderr=subprocess.DEVNULL)
        self.ended_at_the_end(broker)
        self.listening(port)
        with open(self.log, "a") as log:
            listener = subprocess.Popen(["mosquitto_sub", "-p", str(port), "-t", "stage/#", "-F", "%U %t %p"], stdout=log)
        self.ended_at_the_end(listener)
        # The listener has subscribed as soon as it receives this retained message.
        subprocess.run(["mosquitto_pub", "-p", str(port), "-t", "stage/ready", "-m", "1", "-r"], check=True)
        self.await_received("stage/ready 1")
        return broker

    def test_values_are_published_and_readings_are_received(self):
        port = free_port()
        broker = self.broker(port)
        driver = self.driver("mqtt", f"127.0.0.1:{port}", "lamp=stage/lamp:brightness", "arm=stage/arm", "heat=stage/heat:celsius")
        devices = [device("lamp", "position", 0, 254), device("arm", "position", -90, 90), device("heat", "sensor", 0, 90)]
        self.assertTrue(driver.init(*devices).startswith("ok {"))
        self.assertEqual([driver.ask("set lamp position 120"), driver.ask("set arm position -12.5")], ["ok", "ok"])
        self.await_received('stage/lamp {"brightness": 120.0}')
        self.await_received("stage/arm -12.5")
        subprocess.run(["mosquitto_pub", "-p", str(port), "-t", "stage/heat", "-m", '{"celsius": 21.5}'], check=True)
        until = time.monotonic() + DEADLINE_S
        while "reading heat 21.5" not in driver.pushed and time.monotonic() < until:
            self.assertTrue(driver.ask("ping").startswith("ok"))
        self.assertIn("reading heat 21.5", driver.pushed)
        broker.kill()
        self.assert_fails_without(driver)

    def test_hardware_that_publishes_nothing_is_not_alive(self):
        port = free_port()
        self.broker(port)
        driver = self.driver("mqtt", f"127.0.0.1:{port}", "--alive", "stage/alive", "--silence-ms", "300")
        self.assertIn('"hardware_silence_ms": 300', driver.init(device("arm", "position", -90, 90)))
        time.sleep(0.2)
        self.assertGreater(float(driver.ask("ping").split()[1]), 150)
        subprocess.run(["mosquitto_pub", "-p", str(port), "-t", "stage/alive", "-m", ""], check=True)
        until = time.monotonic() + DEADLINE_S
        while float(driver.ask("ping").split()[1]) > 100:
            self.assertLess(time.monotonic(), until)


class Crazyflie(Ready):
    package = "cflib"
    axes = [device("x", "position", -2, 2), device("height", "position", 0, 1.5, unit="m"), device("battery", "sensor", 0, 5)]
    places = ["height=z", "battery=pm.vbat"]

    def test_the_drone_is_armed_flies_to_positions_and_lands_at_the_end(self):
        port = free_port()
        self.counterpart("crazyflie", port)
        driver = self.driver("crazyflie", f"udp://127.0.0.1:{port}", *self.places)
        self.assertTrue(driver.init(*self.axes).startswith("ok {"))
        self.assertEqual(self.received(), [])
        driver.ask("ramp height position 0.8 200")
        self.await_received("z 0.8")
        driver.ask("set x position 0.5")
        self.await_received("x 0.5")
        self.assertIn("supervisor 0101", self.received())
        driver.end()
        self.assertIn("reading battery 4.", " ".join(driver.pushed))
        received = self.received()
        # The setpoint that would switch the motors off is not sent.
        self.assertFalse([line for line in received if line.startswith("setpoint")])
        self.assertTrue(received[-1].startswith("high_level"), received[-1])

    def test_the_drone_hovers_before_it_is_measured_and_lands_afterwards(self):
        port = free_port()
        self.counterpart("crazyflie", port)
        driver = self.driver("crazyflie", f"udp://127.0.0.1:{port}", *self.places, "--take-off", "0.5")
        self.assertTrue(driver.init(*self.axes).startswith("ok {"))
        self.assertEqual(self.received(), ["supervisor 0101", "take_off 0.5"])
        driver.end()
        self.assertTrue(self.received()[-1].startswith("high_level 08"), self.received())

    def test_a_dead_drone_is_noticed(self):
        port = free_port()
        drone = self.counterpart("crazyflie", port)
        driver = self.driver("crazyflie", f"udp://127.0.0.1:{port}", *self.places)
        driver.init(*self.axes)
        drone.kill()
        self.assert_fails_without(driver)


class UrRtde(Ready):
    package = "rtde_control"

    def test_joints_follow_ramps_and_jumps_are_refused(self):
        host = f"127.0.0.{os.getpid() % 200 + 20}"
        controller = self.counterpart("ur_rtde", host)
        driver = self.driver("ur_rtde", host)
        devices = [device("elbow", "position", 0, 150, unit="deg"), device("angle", "sensor", -360, 360, unit="deg")]
        self.assertIn("`angle` is not a joint for `angle`", driver.init(*devices))
        driver = self.driver("ur_rtde", host, "angle=elbow")
        self.assertTrue(driver.init(*devices).startswith("ok {"))
        self.assertEqual(self.received(), [])
        self.assertIn("`elbow` is 80 deg away from 10, expected at most 20", driver.ask("set elbow position 10"))
        driver.ask("ramp elbow position 100 300")
        self.await_received("2 1.745329")
        until = time.monotonic() + DEADLINE_S
        while abs(float(driver.ask("read angle")) - 100) > 0.01:
            self.assertLess(time.monotonic(), until)
        self.assertIn("0 0.000000", self.received())
        driver.end()
        self.assertEqual(self.received()[-1], "stopped 1")
        controller.kill()

    def test_a_dead_controller_is_noticed(self):
        host = f"127.0.1.{os.getpid() % 200 + 20}"
        controller = self.counterpart("ur_rtde", host)
        driver = self.driver("ur_rtde", host)
        self.assertTrue(driver.init(device("elbow", "position", 0, 150)).startswith("ok {"))
        controller.kill()
        self.assert_fails_without(driver)


if __name__ == "__main__":
    unittest.main()
