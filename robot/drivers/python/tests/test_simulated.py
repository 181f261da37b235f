"""Simulated devices, in virtual time."""

import pathlib
import statistics
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))

from downbeat_driver import Robot  # noqa: E402
from downbeat_driver.simulated import SimulatedDevice, SimulatedDriver  # noqa: E402


class Simulated(unittest.TestCase):
    def test_it_stays_until_its_delay_is_over_and_is_there_without_a_time_constant(self):
        device = SimulatedDevice(1.0, delay=0.04)
        device.set(5.0, now=10.0)
        self.assertEqual([device.position(now) for now in (10.0, 10.039, 10.041)], [1.0, 1.0, 5.0])

    def test_it_follows_by_its_time_constant(self):
        device = SimulatedDevice(0.0, time_constant=0.1)
        device.set(10.0, now=0.0)
        self.assertAlmostEqual(device.position(0.1), 6.321, places=3)
        device.set(0.0, now=0.1)
        self.assertAlmostEqual(device.position(0.2), 6.321 * 0.36788, places=3)

    def test_its_readings_have_the_noise_that_was_asked_for(self):
        device = SimulatedDevice(2.0, noise=0.5, seed=1)
        readings = [device.read(float(i)) for i in range(2000)]
        self.assertAlmostEqual(statistics.mean(readings), 2.0, delta=0.05)
        self.assertAlmostEqual(statistics.stdev(readings), 0.5, delta=0.05)

    def test_a_delay_below_zero_is_refused(self):
        self.assertRaises(ValueError, SimulatedDevice, delay=-1)

    def test_its_driver_drives_the_devices_of_any_robot(self):
        driver = SimulatedDriver()
        sensor = {"sensor": {"min_value": 0, "max_value": 8}}
        devices = [{"id": "arm", "default_value": 3}, {"id": "eye", "available_control_types": sensor}]
        driver.start(Robot.of({"id": "r", "devices": devices}))
        driver.set("arm", "position", 7.0)
        self.assertEqual((driver.read("arm"), driver.read("eye")), (7.0, 4.0))


if __name__ == "__main__":
    unittest.main()
