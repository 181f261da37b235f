"""Scripts that a driver receives ahead of their time, to time them itself."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Optional

from .robot import Value

#: A wait checks this often whether the edge still exists, in seconds.
_LOOK_EVERY = 0.05
#: The next step of a plan that is handed over in parts may arrive at most this late, in seconds.
_STEP_LATE_MAX = 0.25


class PlanEnded(Exception):
    """The plan ended early: it was cancelled, the edge has ended, or it would begin too late."""


@dataclass(frozen=True)
class Step:
    """A step of a plan."""

    index: int
    at: float
    """When its value is due, in seconds of `time.monotonic()`. A device that moves linearly arrives at this time."""
    at_ns: int
    """The same in nanoseconds of `time.time_ns()`, by the setting of that clock when the plan arrived."""
    value: Value


class Plan:
    """A script of one device. `Driver.play` receives it before it starts."""

    def __init__(
        self,
        told: dict[str, Any],
        say: Callable[[str], None],
        silence: Callable[[], float],
        changed: Optional[threading.Condition] = None,
    ) -> None:
        """Plans of a group have a condition in common."""
        self.id = int(told["plan"])
        self.device: str = told["device"]
        self.is_linear: bool = told["interpolation"] == "linear"
        """Whether the device moves linearly from step to step. Otherwise each value is set at its time and held."""
        self._clock = _Clock()
        self.start_ns = int(told["start"])
        """When it starts, in nanoseconds of `time.time_ns()`, by the setting of that clock when the plan arrived."""
        self.start = self._clock.monotonic(self.start_ns)
        """When it starts, in seconds of `time.monotonic()`."""
        self.begin_by = self._clock.monotonic(int(told["begin_by"]))
        """It must not begin after this time."""
        self.then: Optional[str] = None
        """How the device ends the plan after a cancellation: `keep`, `hold`, `rest` or `slow`. `None` before a cancellation."""
        allowed = told.get("silence_ms", {})
        self._silence_at_start = float(allowed.get("start", 400)) / 1000
        self._silence_running = float(allowed.get("running", 3000)) / 1000
        self._say, self._silence = say, silence
        self._changed = threading.Condition() if changed is None else changed
        self.released = threading.Event()
        """Set when the hardware no longer follows the plan."""
        self._steps: list[Step] = []
        self._is_whole = False
        self._ended: Optional[str] = None
        self._started = False
        self._finished_ns: Optional[int] = None
        self._finish_assumed = False
        self.add(told)

    # Methods for `play`.

    def begin(self, *, assumed: bool = False) -> None:
        """Waits for the start. If the device moves linearly, reports that the plan has started, because the device then begins to move to
        the first value. On a device that holds, a plan starts with its first value: call `started` or `reached` at that time. Pass
        `assumed=True` if the hardware begins by its own clock. Raises `PlanEnded` if the plan must not begin."""
        self.wait_until(self.start)
        silence = self._silence()
        if silence > self._silence_at_start:
            raise PlanEnded(f"no message from the edge for {silence * 1000:.0f} ms before the start")
        late = time.monotonic() - self.begin_by
        if late > 0:
            raise PlanEnded(f"it is {late * 1000:.0f} ms too late to begin")
        with self._changed:
            self._raise_if_ended()
            if self.is_linear or assumed:
                self.started(assumed=assumed)

    def started(self, at_ns: Optional[int] = None, *, assumed: bool = False) -> None:
        """Reports that the first value was set, or that the device began to move to it linearly, at `at_ns` or now. Pass `assumed=True`
        if you only know this from the clock, not from the hardware or from your own code that set the value."""
        self._started = True
        self._report("started", self._now_ns() if at_ns is None else at_ns, assumed)

    def reached(self, step: Step, at_ns: Optional[int] = None, *, assumed: bool = False) -> None:
        """Reports that a step and all previous steps are done, at `at_ns` or now. Assumed steps are not counted."""
        at_ns = self._now_ns() if at_ns is None else at_ns
        if not self._started:
            self.started(at_ns, assumed=assumed)
        self._report("step", at_ns, assumed, step.index)

    def finished(self, at_ns: Optional[int] = None, *, assumed: bool = False) -> None:
        """Records when all steps were done. By default, this is when `play` returns, which reports it to the edge. An assumed end is
        reported as a failure, because the result of the script is unknown."""
        self._finished_ns = self._now_ns() if at_ns is None else at_ns
        self._finish_assumed = assumed

    def _report(self, word: str, at_ns: int, assumed: bool, *step: int) -> None:
        words = [word, self.id, *step, at_ns, *(["assumed"] if assumed else [])]
        self._say(" ".join(map(str, words)))

    def __iter__(self) -> Iterator[Step]:
        """The steps in the order of their times, including steps that are handed over later. Raises `PlanEnded`."""
        index = 0
        while (step := self._step(index)) is not None:
            yield step
            index += 1

    def steps(self) -> list[Step]:
        """All steps that have been handed over so far: the whole script, if the driver asked for whole scripts."""
        with self._changed:
            return list(self._steps)

    def wait_until(self, at: float) -> None:
        """Waits until an instant of `time.monotonic()`. Raises `PlanEnded` as soon as the plan is over."""
        self.wait_with([self], at)

    def wait_with(self, plans: Sequence[Plan], at: float) -> None:
        """Waits like `wait_until` on behalf of all plans of a group."""
        with self._changed:
            while True:
                for plan in plans:
                    plan._raise_if_ended()
                left = at - time.monotonic()
                if left <= 0:
                    return
                self._changed.wait(min(left, _LOOK_EVERY))

    @property
    def is_started(self) -> bool:
        """Whether its start has been reported."""
        return self._started

    @property
    def is_cancelled(self) -> bool:
        """Whether it ended early."""
        with self._changed:
            return self._ended is not None

    # Methods for the driver.

    def add(self, told: dict[str, Any]) -> None:
        """Adds further steps."""
        with self._changed:
            for step in told["steps"]:
                values = step["values"]
                value = Value(self.device, step["control_type"], values[0], tuple(values[1:]))
                at_ns = int(step["at"])
                self._steps.append(Step(int(step["step"]), self._clock.monotonic(at_ns), at_ns, value))
            self._is_whole = bool(told["last"])
            self._changed.notify_all()

    @property
    def is_whole(self) -> bool:
        """Whether all steps have been handed over."""
        return self._is_whole

    def cancel(self, then: str, why: str) -> None:
        """Cancels the plan."""
        with self._changed:
            self.then = then
            self._ended = self._ended or why
            self._changed.notify_all()

    def say_end(self, failed: Optional[str] = None) -> None:
        """Reports the end of the plan, successful or not."""
        now = self._now_ns()
        if failed is not None:
            self._say(f"failed {self.id} {now} {failed}")
        elif self.then is not None:
            self._say(f"cancelled {self.id} {now}")
        else:
            if not self._started:
                self.started(now, assumed=self._finish_assumed)
            self._report("done", now if self._finished_ns is None else self._finished_ns, self._finish_assumed)

    def _step(self, index: int) -> Optional[Step]:
        with self._changed:
            while index >= len(self._steps):
                if self._is_whole:
                    return None
                self._raise_if_ended()
                if index > 0 and time.monotonic() > self._steps[index - 1].at + _STEP_LATE_MAX:
                    raise PlanEnded(f"step {index + 1} was not handed over in time")
                self._changed.wait(_LOOK_EVERY)
            return self._steps[index]

    def _raise_if_ended(self) -> None:
        silence = self._silence()
        if self._ended is None and silence > self._silence_running:
            self._ended = f"no message from the edge for {silence:.1f} s"
        if self._ended is not None:
            raise PlanEnded(self._ended)

    def _now_ns(self) -> int:
        return self._clock.system_ns(time.monotonic())


class _Clock:
    """Relates the system clock to the monotonic clock, only once, so that setting the system clock does not move any times."""

    def __init__(self) -> None:
        readings = []
        for _ in range(5):
            before = time.monotonic_ns()
            system = time.time_ns()
            after = time.monotonic_ns()
            readings.append((after - before, system - (before + after) // 2))
        self._ahead = min(readings)[1]

    def monotonic(self, system_ns: int) -> float:
        return (system_ns - self._ahead) / 1e9

    def system_ns(self, monotonic: float) -> int:
        return round(monotonic * 1e9) + self._ahead
