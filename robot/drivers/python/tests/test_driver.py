"""Drivers, driven with the lines that the edge sends."""

import io
import json
import os
import pathlib
import subprocess
import sys
import textwrap
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))

from downbeat_driver import Driver, Reading, Refused, Value  # noqa: E402
from downbeat_driver.output import Lines  # noqa: E402

PACKAGE = str(pathlib.Path(__file__).parent.parent)
BLOCK = {
    "id": "r",
    "devices": [
        {"id": "arm", "unit": "deg", "default_value": 3, "available_control_types": {"position": {"max_value": 9}}},
        {"id": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}},
    ],
}
INIT = "init " + json.dumps({"block": BLOCK})


def said(driver, *lines):
    """The answers of a driver to these lines."""
    output = io.StringIO()
    driver.run(lines, Lines(output))
    return output.getvalue().splitlines()


class Recorder(Driver):
    latency_ms = 42

    def __init__(self):
        super().__init__()
        self.calls = []

    def set(self, device, control_type, value, *more):
        if value == 66:
            raise Refused("too hot")
        if value == 77:
            raise ValueError("of\nthe library")
        self.calls.append((device, control_type, value, *more))

    def read(self, sensor):
        return 12.5


class Framed(Driver):
    def __init__(self):
        super().__init__()
        self.frames = []

    def set_frame(self, values):
        self.frames.append(list(values))


class Spoken(unittest.TestCase):
    def test_a_driver_says_its_version_and_declares_what_it_can_do(self):
        hello, init = said(Recorder(), "hello\n", INIT)
        self.assertEqual(hello, "ok 2")
        declared = {"frames": False, "ramps": False, "latency_ms": {"arm": 42}}
        self.assertEqual(json.loads(init[len("ok ") :]), declared)

    def test_a_reading_may_have_an_age(self):
        class Stamped(Recorder):
            def read(self, sensor):
                self.push_reading(sensor, 3, age=0.02)
                return Reading(12.5, 0.0305)

        self.assertEqual(said(Stamped(), INIT, "read eye")[1:], ["reading eye 3.0 20.000", "12.5 30.500"])

    def test_a_driver_knows_its_robot_with_units(self):
        driver = Recorder()
        said(driver, "hello", INIT)
        self.assertEqual((driver.robot.id, driver.robot.devices["arm"].unit), ("r", "deg"))
        self.assertTrue(driver.robot.devices["eye"].is_sensor)

    def test_values_are_set_and_sensors_are_read(self):
        driver = Recorder()
        answers = said(driver, INIT, "set arm position 1.64", "set arm custom_1 1 2 3", "read eye", "ping")
        self.assertEqual(answers[1:], ["ok", "ok", "12.5", "ok"])
        self.assertEqual(driver.calls, [("arm", "position", 1.64), ("arm", "custom_1", 1.0, 2.0, 3.0)])

    def test_values_of_one_instant_are_one_frame(self):
        driver = Framed()
        one = {"device": "arm", "control_type": "position", "values": [1]}
        two = {"device": "leg", "control_type": "custom_1", "values": [2, 3]}
        answers = said(driver, INIT, "frame " + json.dumps([one, two]))
        self.assertTrue(json.loads(answers[0][len("ok ") :])["frames"])
        self.assertEqual(driver.frames, [[Value("arm", "position", 1), Value("leg", "custom_1", 2, (3,))]])

    def test_what_a_driver_refuses_or_what_fails_in_it_is_one_line(self):
        with self.assertLogs(level="ERROR"):
            answers = said(Recorder(), INIT, "set arm position 66", "set arm position 77", "dance")
        expected = ["error too hot", "error ValueError: of the library", "error unknown command `dance`"]
        self.assertEqual(answers[1:], expected)

    def test_a_driver_that_sets_nothing_says_so(self):
        with self.assertLogs(level="ERROR"):
            answers = said(Driver(), INIT, "set arm position 1")
        self.assertEqual(answers[1], "error NotImplementedError: write `set` or `set_frame`")

    def test_readings_and_faults_are_pushed(self):
        class Pushing(Recorder):
            def ping(self):
                self.push_reading("eye", 7)
                self.fault("emergency\nstop")

        answers = said(Pushing(), INIT, "ping")
        self.assertEqual(answers[1:], ["reading eye 7.0", "fault emergency stop", "ok"])

    def test_a_reading_that_is_no_number_is_not_pushed(self):
        driver = Recorder()
        said(driver, INIT)
        self.assertRaises(ValueError, driver.push_reading, "eye", float("nan"))
        self.assertRaises(RuntimeError, Recorder().fault, "too early")

    def test_a_ramp_that_would_take_milliseconds_is_refused_before_anything_moves(self):
        class Wrong(Recorder):
            def ramp(self, device, control_type, value, milliseconds):
                self.calls.append(value)

        driver = Wrong()
        answers = said(driver, "hello", INIT, "set arm position 4")
        self.assertIn("expected device, control_type, value, seconds", answers[1])

    def test_a_driver_that_has_not_started_is_not_stopped(self):
        stopped = []

        class Absent(Recorder):
            def start(self, robot):
                raise OSError("no such port")

            def stop(self):
                stopped.append(self)

        self.assertEqual(said(Absent(), "hello", INIT)[1], "error OSError: no such port")
        self.assertEqual(stopped, [])

    def test_what_libraries_print_does_not_reach_the_edge(self):
        program = textwrap.dedent(
            """
            import os
            from downbeat_driver import Driver
            class Loud(Driver):
                def start(self, robot):
                    print("welcome to the SDK")
                    os.write(1, b"from C\\n")
                    os.system("echo from a child")
            Loud().run()
            """
        )
        environment = {**os.environ, "PYTHONPATH": PACKAGE}
        ran = subprocess.run(
            [sys.executable, "-c", program], input=f"hello\n{INIT}\n", capture_output=True, text=True, env=environment,
            timeout=60, check=True,
        )
        self.assertEqual(len(ran.stdout.splitlines()), 2, ran.stdout)
        for loud in ("welcome to the SDK", "from C", "from a child"):
            self.assertIn(loud, ran.stderr)


if __name__ == "__main__":
    unittest.main()
