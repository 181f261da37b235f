"""Scripts that a driver times itself, sent to it as the edge does."""

import io
import json
import pathlib
import sys
import time
import unittest
import unittest.mock

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))

from downbeat_driver import Driver, PlanEnded, Refused  # noqa: E402
from downbeat_driver.output import Lines  # noqa: E402
from downbeat_driver.simulated import SimulatedDriver  # noqa: E402

POSITION = {"position": {"min_value": 0, "max_value": 99}}
BLOCK = {
    "id": "r",
    "devices": [
        {"id": "arm", "default_value": 3, "available_control_types": POSITION},
        {"id": "leg", "available_control_types": POSITION},
        {"id": "wheel", "available_control_types": {"speed": {"min_value": -9, "max_value": 9}}},
    ],
}
INIT = "init " + json.dumps({"version": 2, "block": BLOCK})


def milliseconds(number):
    return round(number * 1_000_000)


def plan(device="arm", *, steps, start_ms=60.0, last=True, linear=False, control_type="position", number=1, **more):
    """A plan that starts this many milliseconds from now, with the offsets and values of its steps."""
    start = time.time_ns() + milliseconds(start_ms)
    told = {
        "plan": number,
        "device": device,
        "start": start,
        # Busy machines are late.
        "begin_by": start + milliseconds(30_000),
        "interpolation": "linear" if linear else "hold",
        "silence_ms": {"start": 30_000, "running": 30_000},
        "steps": [
            {"step": i, "at": start + milliseconds(at), "control_type": control_type, "values": [value]}
            for i, (at, value) in enumerate(steps)
        ],
        "last": last,
        **more,
    }
    return "plan " + json.dumps(told), told


class Reporting(Driver):
    """Its hardware begins by its own clock. The test chooses whether it reports its end."""

    lookahead = "script"
    hardware_silence_ms = 3_000

    def __init__(self, shows_end):
        super().__init__()
        self.shows_end = shows_end

    def ping(self):
        return 0.0405

    def play(self, plan):
        plan.begin(assumed=True)
        for step in plan:
            plan.wait_until(step.at)
            plan.reached(step, assumed=True)
        plan.finished(assumed=not self.shows_end)


def cancel(number=1, then="rest"):
    return "cancel " + json.dumps({"plan": number, "then": then, "why": "stopped"})


def said(driver, *lines):
    """The answers of a driver to these lines. A tuple waits until the driver has sent all its items; a number is a pause in seconds."""
    output = io.StringIO()

    def spoken():
        for line in lines:
            if isinstance(line, float):
                time.sleep(line)
            elif isinstance(line, tuple):
                until = time.monotonic() + 60
                while not all(awaited in output.getvalue() for awaited in line) and time.monotonic() < until:
                    time.sleep(0.002)
            else:
                yield line

    driver.run(spoken(), Lines(output))
    return output.getvalue().splitlines()


def words(lines):
    """The lines without their times."""
    return [" ".join(word for word in line.split() if len(word) < 15) for line in lines]


class Recorder(Driver):
    lookahead = "script"

    def __init__(self):
        super().__init__()
        self.sets = []

    def set(self, device, control_type, value, *more):
        if value == 66:
            raise Refused("too hot")
        self.sets.append((time.time_ns(), device, value))

    def values(self):
        return [value for _, _, value in self.sets]


class Played(unittest.TestCase):
    def test_a_driver_declares_how_far_ahead_it_is_told_and_its_rates(self):
        class Declaring(Recorder):
            lookahead = {"arm": "script", "leg": 500}
            samples_per_second = {"arm": 100}
            pings_per_second = 20
            readings_per_second = 5

        declared = json.loads(said(Declaring(), INIT)[0][len("ok ") :])
        self.assertEqual((declared["lookahead"], declared["lookahead_ms"]), ({"arm": "script"}, {"leg": 500}))
        self.assertEqual(declared["samples_per_second"], {"arm": 100})
        self.assertEqual((declared["pings_per_second"], declared["readings_per_second"]), (20, 5))
        self.assertEqual(json.loads(said(Recorder(), INIT)[0][len("ok ") :])["lookahead"], "script")

    def test_what_only_the_clock_says_is_reported_as_assumed(self):
        for shows_end, end in [(False, "done 1 assumed"), (True, "done 1")]:
            line, _ = plan(steps=[(0, 1), (20, 2)])
            lines = said(Reporting(shows_end), INIT, line, ("done 1",), "ping")
            steps = ["step 1 0 assumed", "step 1 1 assumed"]
            self.assertEqual(words(lines[2:]), ["started 1 assumed", *steps, end, "ok 40.500"])
            self.assertEqual(json.loads(lines[0][len("ok ") :])["hardware_silence_ms"], 3_000)

    def test_a_plan_is_played_at_its_times_and_told_as_it_was(self):
        driver = Recorder()
        line, told = plan(steps=[(0, 1), (80, 2), (160, 3)])
        lines = said(driver, INIT, line, ("done 1",))
        told_back = [line for line in lines[1:] if line != "ok"]
        self.assertEqual(words(told_back), ["started 1", "step 1 0", "step 1 1", "step 1 2", "done 1"])
        self.assertEqual(driver.values(), [1, 2, 3])
        for (at, _, _), step, word in zip(driver.sets, told["steps"], told_back[1:]):
            self.assertGreaterEqual(at, step["at"])
            self.assertGreaterEqual(int(word.split()[3]), at)

    def test_a_plan_has_started_with_its_first_value_or_when_the_device_begins_to_move_to_it(self):
        for linear in [False, True]:
            line, told = plan(steps=[(400, 1), (450, 2)], linear=linear)
            lines = said(Recorder(), INIT, line, ("done 1",))
            started = next(int(line.split()[2]) for line in lines if line.startswith("started 1 "))
            first = told["steps"][0]["at"]
            self.assertEqual(started < first, linear, lines)

    def test_plans_of_several_devices_are_played_at_the_same_time(self):
        driver = Recorder()
        arm, leg = plan(steps=[(0, 1), (90, 2)])[0], plan("leg", steps=[(0, 3), (90, 4)], number=2)[0]
        said(driver, INIT, arm, leg, ("done 1", "done 2"))
        self.assertEqual(sorted(driver.values()[:2]), [1, 3])

    def test_after_a_cancellation_is_answered_nothing_of_a_plan_is_set(self):
        driver = Recorder()
        line = plan(steps=[(i * 10, i) for i in range(2000)])[0]
        lines = said(driver, INIT, line, ("step 1 3",), cancel(), "set arm position 99", 0.2)
        self.assertEqual(driver.values()[-1], 99)
        end = words(lines)
        self.assertEqual(end[-3:], ["cancelled 1", "ok", "ok"])
        self.assertEqual(sum(word.startswith("step") for word in end), len(driver.values()) - 1)

    def test_a_plan_that_is_cancelled_before_its_start_does_not_begin(self):
        driver = Recorder()
        lines = said(driver, INIT, plan(steps=[(0, 1)], start_ms=10_000)[0], cancel(then="keep"))
        self.assertEqual((words(lines[1:]), driver.values()), (["ok", "cancelled 1", "ok"], []))

    def test_a_plan_that_comes_too_late_does_not_begin(self):
        driver = Recorder()
        line = plan(steps=[(0, 1)], start_ms=-80, begin_by=time.time_ns() - milliseconds(30))[0]
        lines = said(driver, INIT, line, ("failed 1",))
        self.assertEqual(driver.values(), [])
        self.assertTrue(any("too late to begin" in line for line in lines), lines)

    def test_a_plan_does_not_begin_if_the_edge_has_fallen_silent(self):
        driver = Recorder()
        silence = {"start": 50, "running": 30_000}
        lines = said(driver, INIT, plan(steps=[(0, 1)], start_ms=200, silence_ms=silence)[0], ("failed 1",))
        self.assertEqual(driver.values(), [])
        self.assertTrue(any(line.startswith("failed 1 ") and "no message from the edge" in line for line in lines), lines)

    def test_a_plan_ends_if_the_edge_falls_silent(self):
        driver = Recorder()
        silence = {"start": 30_000, "running": 200}
        steps = [(i * 20, i) for i in range(2000)]
        lines = said(driver, INIT, plan(steps=steps, silence_ms=silence)[0], ("failed 1",))
        self.assertLess(len(driver.values()), 1000)
        self.assertTrue(any(line.startswith("failed 1 ") for line in lines), lines)

    def test_plans_end_with_the_edge_and_speeds_go_to_zero(self):
        driver = Recorder()
        arm = plan(steps=[(i * 10, i) for i in range(2000)])[0]
        wheel = plan("wheel", steps=[(0, 5), (50_000, 6)], control_type="speed", number=2)[0]
        said(driver, INIT, arm, wheel, ("step 1 5", "step 2 0"))
        self.assertEqual(driver.sets[-1][1:], ("wheel", 0.0))
        before = len(driver.sets)
        time.sleep(0.1)
        self.assertEqual(len(driver.sets), before)

    def test_steps_may_be_handed_over_while_a_plan_runs(self):
        driver = Recorder()
        line, told = plan(steps=[(0, 1), (50, 2)], last=False)
        more = {"plan": 1, "steps": [{**told["steps"][0], "step": 2, "at": told["start"] + milliseconds(200)}], "last": True}
        with unittest.mock.patch("downbeat_driver.plan._STEP_LATE_MAX", 30):
            lines = said(driver, INIT, line, ("step 1 1",), "more " + json.dumps(more), ("done 1",))
        self.assertEqual(driver.values(), [1, 2, 1])
        self.assertIn("done 1", words(lines))

    def test_a_plan_whose_next_step_does_not_come_fails(self):
        driver = Recorder()
        lines = said(driver, INIT, plan(steps=[(0, 1)], last=False)[0], ("failed 1",))
        self.assertTrue(any("step 2 was not handed over in time" in line for line in lines), lines)

    def test_what_fails_in_a_plan_is_told_with_its_reason(self):
        with self.assertLogs(level="ERROR"):
            lines = said(Recorder(), INIT, plan(steps=[(0, 1), (50, 66), (90, 2)])[0], ("failed 1",))
        self.assertEqual(words(lines)[-2:], ["step 1 0", "failed 1 Refused: too hot"])

    def test_a_device_that_moves_linearly_is_told_where_to_be_in_between(self):
        driver = SimulatedDriver(lookahead="script")
        told = []
        driver.set = lambda device, control_type, value, *more: told.append(value)
        said(driver, INIT, plan(steps=[(0, 0), (1000, 10)], linear=True)[0], ("done 1",))
        self.assertEqual((told[0], told[-1]), (0, 10))
        self.assertTrue(len(told) > 4 and told == sorted(told), told)

    def test_hardware_that_takes_trajectories_says_itself_what_happened(self):
        class Controller(Recorder):
            def play(self, plan):
                self.sent = [(step.at_ns, step.value.value) for step in plan.steps()]
                plan.started(plan.start_ns)
                for step in plan:
                    plan.wait_until(step.at)
                    plan.reached(step, step.at_ns)
                plan.finished(step.at_ns)

        driver = Controller()
        line, told = plan(steps=[(0, 1), (50, 2)])
        start, at = told["start"], told["steps"][1]["at"]
        lines = said(driver, INIT, line, ("done 1",))
        self.assertEqual(driver.sent, [(start, 1), (at, 2)])
        expected = [f"started 1 {start}", f"step 1 0 {start}", f"step 1 1 {at}", f"done 1 {at}"]
        self.assertEqual([line for line in lines[1:] if line != "ok"], expected)

    def test_a_plan_that_does_not_end_is_not_confirmed(self):
        class Stuck(Recorder):
            def play(self, plan):
                plan.begin()
                time.sleep(1.5)

        lines = said(Stuck(), INIT, plan(steps=[(0, 1)], start_ms=10, linear=True)[0], ("started 1",), cancel())
        self.assertIn("error plan 1 does not end", lines)

    def test_waiting_in_a_plan_that_is_over_raises(self):
        class Waiting(Recorder):
            def play(self, plan):
                try:
                    plan.wait_until(plan.start + 60)
                except PlanEnded:
                    self.stopped_because = plan.then
                    raise

        driver = Waiting()
        said(driver, INIT, plan(steps=[(0, 1)])[0], cancel(then="hold"))
        self.assertEqual(driver.stopped_because, "hold")


if __name__ == "__main__":
    unittest.main()
