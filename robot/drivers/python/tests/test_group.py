"""Plans of several devices, played as one trajectory."""

import json
import pathlib
import sys
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))
sys.path.insert(0, str(pathlib.Path(__file__).parent))

from test_plans import INIT, cancel, milliseconds, plan, said, words  # noqa: E402

from downbeat_driver import Driver, PlanEnded  # noqa: E402


class Controller(Driver):
    """Takes one trajectory for all joints."""

    lookahead = "script"
    gather_ms = 200.0

    def __init__(self):
        super().__init__()
        self.trajectories, self.cancelled = [], 0

    def where(self, device, control_type):
        return 4.0

    def play_group(self, group):
        frames = group.frames()
        self.trajectories.append(
            [((frame.at_ns - group.start_ns) / 1e6, {device: value.value for device, value in frame.values.items()}) for frame in frames]
        )
        try:
            group.begin()
            for frame in frames:
                group.wait_until(frame.at)
                group.reached(frame)
        except PlanEnded:
            self.cancelled += 1
            raise


def lines(*plans, start_ms=500.0):
    """Lines for plans that start at the same instant. Each is a device, its offsets and values, and whether it moves linearly."""
    start = time.time_ns() + milliseconds(start_ms)
    written = []
    for number, (device, steps, linear) in enumerate(plans, 1):
        _, told = plan(device, steps=[(at, value) for at, value in steps], linear=linear, number=number)
        for step, (at, _) in zip(told["steps"], steps):
            step["at"] = start + milliseconds(at)
        told.update(start=start, begin_by=start + milliseconds(30_000))
        written.append("plan " + json.dumps(told))
    return written


class Together(unittest.TestCase):
    def test_plans_of_one_instant_are_one_trajectory(self):
        driver = Controller()
        both = lines(("arm", [(50, 10), (150, 30)], True), ("leg", [(0, 1), (100, 2)], False))
        answers = words(said(driver, "hello", INIT, *both, ("done 1", "done 2")))
        self.assertEqual(driver.trajectories, [[
            (0, {"arm": 4.0, "leg": 1}),
            (50, {"arm": 10, "leg": 1}),
            (100, {"arm": 20, "leg": 2}),
            (150, {"arm": 30, "leg": 2}),
        ]])
        reports = [answer for answer in answers if answer.split()[0] in ("started", "step", "done")]
        self.assertEqual(reports, ["started 1", "started 2", "step 2 0", "step 1 0", "step 2 1", "step 1 1", "done 1", "done 2"])

    def test_plans_of_different_instants_are_different_trajectories(self):
        driver = Controller()
        (first,) = lines(("arm", [(0, 10)], False))
        (second,) = lines(("leg", [(0, 10)], False), start_ms=600.0)
        second = second.replace('"plan": 1', '"plan": 2')
        said(driver, "hello", INIT, first, second, ("done 1", "done 2"))
        self.assertEqual(driver.trajectories, [[(0, {"arm": 10})], [(0, {"leg": 10})]])

    def test_a_stop_ends_the_trajectory_once_and_each_plan_reports_its_own_cancellation(self):
        driver = Controller()
        both = lines(("arm", [(0, 10), (60_000, 30)], False), ("leg", [(0, 1), (60_000, 2)], False))
        answers = words(said(driver, "hello", INIT, *both, ("step 1", "step 2"), cancel(1), cancel(2)))
        ends = [answer for answer in answers if answer.split()[0] in ("cancelled", "failed", "done")]
        self.assertEqual((ends, driver.cancelled), (["cancelled 1", "cancelled 2"], 1))

    def test_one_cancelled_plan_fails_the_others(self):
        driver = Controller()
        both = lines(("arm", [(0, 10), (60_000, 30)], False), ("leg", [(0, 1), (60_000, 2)], False))
        answers = words(said(driver, "hello", INIT, *both, ("step 1", "step 2"), cancel(1), ("failed 2",)))
        self.assertIn("cancelled 1", answers)
        self.assertIn("failed 2 stopped", answers)

    def test_a_plan_that_is_cancelled_before_is_no_part_of_the_trajectory(self):
        driver = Controller()
        both = lines(("arm", [(0, 10)], False), ("leg", [(0, 1)], False), start_ms=600.0)
        answers = words(said(driver, "hello", INIT, *both, cancel(1), ("done 2",)))
        self.assertIn("cancelled 1", answers)
        self.assertEqual(driver.trajectories, [[(0, {"leg": 1})]])

    def test_groups_need_whole_scripts(self):
        class Partly(Controller):
            lookahead = 500

        answers = said(Partly(), "hello", INIT)
        self.assertIn("`play_group` needs whole scripts, but `lookahead` is 500; expected 'script'", answers[1])


if __name__ == "__main__":
    unittest.main()
