"""The base of the ready drivers, with hardware that records its values."""

import argparse
import io
import json
import pathlib
import sys
import threading
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))

from downbeat_driver import Refused, Robot  # noqa: E402
from downbeat_driver.hardware import Hardware, Lost  # noqa: E402
from downbeat_driver.output import Lines  # noqa: E402
from downbeat_driver.robot import Device  # noqa: E402
from downbeat_driver.servos import servo  # noqa: E402
from downbeat_driver.units import ANGLES, bounds, factor  # noqa: E402

BLOCK = {
    "id": "r",
    "devices": [
        {"id": "arm", "unit": "deg", "default_value": 3, "available_control_types": {"position": {"min_value": 0, "max_value": 90}}},
        {"id": "wheel", "available_control_types": {"speed": {"min_value": -5, "max_value": 5}}},
    ],
}
INIT = "init " + json.dumps({"block": BLOCK})


class Recorder(Hardware):
    def __init__(self, *places, silent=False):
        super().__init__(argparse.Namespace(places=list(places)))
        self.frames, self.asked, self.silent, self.is_connected = [], 0, silent, False
        self.ask_s = 0.0

    def connect(self):
        self.is_connected = True

    def write(self, values):
        self.frames.append({value.device: value.value for value in values})

    def ask(self):
        self.asked += 1
        if self.silent:
            raise Lost("no answer")

    def disconnect(self):
        self.is_connected = False


def answers(driver, *lines):
    """The answers of a driver to these lines. A number is a pause in seconds."""

    def spoken():
        yield INIT
        for line in lines:
            if isinstance(line, str):
                yield line
            else:
                time.sleep(line)

    output = io.StringIO()
    driver.run(spoken(), Lines(output))
    return output.getvalue().splitlines()[1:]


class Places(unittest.TestCase):
    def test_places_are_those_of_the_command_line(self):
        driver = Recorder("arm=3", "wheel=a=b")
        answers(driver)
        self.assertEqual(driver.wired, {"arm": "3", "wheel": "a=b"})

    def test_a_place_of_an_unknown_device_is_refused_before_the_hardware_is_connected(self):
        for place, expected in (("leg=3", "no device `leg`, expected one of arm, wheel"), ("arm", "expected DEVICE=PLACE")):
            driver = Recorder(place)
            with self.assertRaisesRegex(Refused, expected):
                driver.robot = Robot.of(BLOCK)
                driver.start(driver.robot)
            self.assertFalse(driver.is_connected)

    def test_a_missing_package_is_named_with_its_installation(self):
        driver = Recorder()
        driver.package = "dynamixel-sdk"
        with self.assertRaisesRegex(Refused, "No module named 'no_such_module'; install the package: pip install dynamixel-sdk"):
            driver.module("no_such_module")


class Movements(unittest.TestCase):
    def test_values_of_an_instant_are_written_together(self):
        driver = Recorder()
        frame = [{"device": device, "control_type": "position", "values": [2]} for device in ("arm", "wheel")]
        answers(driver, "frame " + json.dumps(frame))
        self.assertEqual(driver.frames[0], {"arm": 2, "wheel": 2})

    def test_a_ramp_begins_at_the_last_value_and_ends_at_its_target_in_time(self):
        driver = Recorder()
        begun = time.monotonic()
        answers(driver, "set arm position 10", "ramp arm position 20 200", 0.4)
        reached = [frame["arm"] for frame in driver.frames]
        self.assertEqual((reached[0], reached[-1]), (10, 20))
        self.assertEqual(reached, sorted(reached))
        self.assertGreater(len(reached), 5)
        self.assertLess(time.monotonic() - begun, 20)

    def test_a_first_ramp_begins_where_the_edge_assumes_the_device(self):
        driver = Recorder()
        answers(driver, "ramp arm position 90 100000", 0.05)
        self.assertLess(driver.frames[0]["arm"], 4)
        self.assertGreaterEqual(driver.frames[0]["arm"], 3)

    def test_a_value_replaces_a_ramp(self):
        driver = Recorder()
        answers(driver, "ramp arm position 90 100", "set arm position 5", 0.2)
        self.assertEqual(driver.frames[-1], {"arm": 5})

    def test_last_values_are_repeated_only_on_request(self):
        once, steady = Recorder(), Recorder()
        steady.repeat_s = 0.01
        for driver in (once, steady):
            answers(driver, "set arm position 5", 0.2)
        self.assertEqual(len(once.frames), 1)
        self.assertGreater(len(steady.frames), 3)
        self.assertEqual(set(frame["arm"] for frame in steady.frames), {5})


class Ends(unittest.TestCase):
    def test_a_lost_edge_leaves_speeds_at_zero_and_ends_ramps_where_they_are(self):
        driver = Recorder()
        answers(driver, "set wheel speed 4", "set arm position 0", "ramp arm position 90 60000", 0.1)
        self.assertEqual(driver.frames[-1], {"wheel": 0})
        self.assertLess(max(frame.get("arm", 0) for frame in driver.frames), 10)

    def test_nothing_is_written_after_the_end(self):
        driver = Recorder()
        driver.repeat_s = 0.01
        answers(driver, "set arm position 5", "ramp arm position 90 60000", 0.05)
        self.assertFalse(driver.is_connected)
        written = len(driver.frames)
        time.sleep(0.1)
        self.assertEqual(len(driver.frames), written)
        self.assertNotIn("moves", [thread.name for thread in threading.enumerate()])

    def test_a_failing_movement_is_a_fault(self):
        driver = Recorder()
        driver.write = lambda values: (_ for _ in ()).throw(OSError("the port has gone"))
        answered = answers(driver, "ramp arm position 90 1000", 0.2)
        self.assertIn("fault OSError: the port has gone", answered)


class Life(unittest.TestCase):
    def test_an_answer_is_a_sign_of_life(self):
        driver = Recorder()
        self.assertLess(float(answers(driver, 0.05, "ping")[0].split()[1]), 40)
        self.assertEqual(driver.asked, 1)

    def test_a_lost_answer_makes_the_last_sign_older_and_is_no_error(self):
        word, age = answers(Recorder(silent=True), 0.05, "ping")[0].split()
        self.assertEqual(word, "ok")
        self.assertGreaterEqual(float(age), 50)

    def test_the_hardware_is_asked_at_most_at_its_rate(self):
        driver = Recorder()
        driver.ask_s = 10
        answers(driver, "ping", "ping")
        self.assertEqual(driver.asked, 0)


class Units(unittest.TestCase):
    def test_angles_are_converted_by_their_unit(self):
        self.assertAlmostEqual(factor(Device("arm", "rad"), ANGLES), 57.29577951)
        self.assertEqual((factor(Device("arm", "turn"), ANGLES), factor(Device("arm"), ANGLES)), (360, 1))
        with self.assertRaisesRegex(Refused, "`arm` has the unit `kg`, expected one of deg"):
            factor(Device("arm", "kg"), ANGLES)

    def test_a_missing_range_is_named(self):
        with self.assertRaisesRegex(Refused, "`arm` has no range, expected `min_value` and `max_value` of `position`"):
            bounds(Device("arm"), "position")

    def test_pulses_follow_the_range(self):
        arm = Device("arm", "deg", None, {"position": {"min_value": -90, "max_value": 90}})
        wired = servo(arm, "3:500-2500", 16)
        self.assertEqual([wired.pulse(value) for value in (-90, 0, 90)], [500, 1500, 2500])
        self.assertEqual((wired.channel, wired.value(2000)), (3, 45))
        for place in (None, "16", "1:500", "1:500-500"):
            with self.assertRaisesRegex(Refused, "with a channel of 0 to 15"):
                servo(arm, place, 16)


if __name__ == "__main__":
    unittest.main()
