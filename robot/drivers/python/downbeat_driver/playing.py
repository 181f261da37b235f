"""The threads on which a driver's plans are played."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Optional

from .plan import Plan, PlanEnded

#: How long a plan may take to end after its cancellation, in seconds: less than the edge waits for an answer.
_END_WAIT = 0.8
#: How long the other plans of a group wait for their cancellation after the first one was cancelled, in seconds.
_CANCELS_WAIT = 0.25


class Plans:
    """Plays each plan on its own thread, or all plans that start at the same instant on one."""

    def __init__(
        self,
        play: Callable[[Plan], None],
        say: Callable[[str], None],
        silence: Callable[[], float],
        log: logging.Logger,
    ) -> None:
        self._play, self._say, self._silence, self._log = play, say, silence, log
        self._lock = threading.Lock()
        self._playing: dict[int, Plan] = {}
        self._gathering: dict[int, list[Plan]] = {}
        self._changed = threading.Condition()
        self._play_group: Optional[Callable[[list[Plan]], None]] = None
        self._gather = 0.0

    def gather(self, play_group: Callable[[list[Plan]], None], seconds: float) -> None:
        """Plays plans that start at the same instant together, and begins this many seconds before their start."""
        self._play_group, self._gather = play_group, seconds

    def take(self, told: dict[str, Any]) -> None:
        """Starts a plan, and returns at once."""
        is_together = self._play_group is not None
        plan = Plan(told, self._say, self._silence, self._changed if is_together else None)
        with self._lock:
            self._playing[plan.id] = plan
            together = self._gathering.get(plan.start_ns)
            if together is not None:
                together.append(plan)
                return
            if is_together:
                self._gathering[plan.start_ns] = [plan]
        run, name = (self._run_group, "group") if is_together else (self._run, "plan")
        threading.Thread(target=run, args=(plan,), name=f"{name} {plan.id}", daemon=True).start()

    def take_more(self, told: dict[str, Any]) -> None:
        """Adds further steps to a plan; ignores them if the plan is over."""
        with self._lock:
            plan = self._playing.get(int(told["plan"]))
        if plan is not None:
            plan.add(told)

    def cancel(self, plan: int, then: str, why: str) -> bool:
        """Cancels a plan. Returns False if it has not ended in time, so that it may still move the device."""
        with self._lock:
            playing = self._playing.get(plan)
        if playing is None:
            return True
        playing.cancel(then, why)
        return playing.released.wait(_END_WAIT)

    def cancel_all(self, then: str, why: str) -> list[Plan]:
        """Ends all plans, because the edge has ended. Returns the plans that had started."""
        with self._lock:
            playing = list(self._playing.values())
        for plan in playing:
            plan.cancel(then, why)
        for plan in playing:
            if not plan.released.wait(_END_WAIT):
                self._log.error("plan %d of %s does not end", plan.id, plan.device)
        return [plan for plan in playing if plan.is_started]

    def _run(self, plan: Plan) -> None:
        self._end(plan, self._failure(lambda: self._play(plan), plan))

    def _run_group(self, first: Plan) -> None:
        """Waits until shortly before the start, plays the plans, and reports the end of each."""
        while (left := first.start - self._gather - time.monotonic()) > 0:
            with self._changed:
                self._changed.wait(min(left, 0.05))
            self._drop_cancelled(first.start_ns)
        with self._lock:
            plans = self._gathering.pop(first.start_ns)
        if not plans:
            return
        play_group = self._play_group
        assert play_group is not None
        error = self._failure(lambda: play_group(plans), *plans)
        # Of a stop, each plan is cancelled by itself.
        until = time.monotonic() + (_CANCELS_WAIT if any(plan.then is not None for plan in plans) else 0.0)
        while plans:
            over = [plan for plan in plans if plan.then is not None or time.monotonic() >= until]
            for plan in over:
                plans.remove(plan)
                self._end(plan, error)
            with self._changed:
                if plans and not any(plan.then is not None for plan in plans):
                    self._changed.wait(0.01)

    def _drop_cancelled(self, start_ns: int) -> None:
        """Ends the plans of a group that were cancelled before their start."""
        with self._lock:
            together = self._gathering[start_ns]
            over = [plan for plan in together if plan.is_cancelled]
            together[:] = [plan for plan in together if plan not in over]
        for plan in over:
            self._end(plan, None)

    def _failure(self, play: Callable[[], None], *plans: Plan) -> Optional[Exception]:
        """Plays, and returns the error if it ended early."""
        try:
            play()
        except PlanEnded as ended:
            return ended
        except Exception as error:  # Report every error to the edge.
            self._log.exception("plan %d of %s failed", plans[0].id, plans[0].device)
            return error
        return None

    def _end(self, plan: Plan, error: Optional[Exception]) -> None:
        """Reports the end of a plan."""
        failed = None if error is None else f"{type(error).__name__}: {error}"
        if isinstance(error, PlanEnded):
            failed = None if plan.then is not None else str(error)
        with self._lock:
            self._playing.pop(plan.id, None)
        try:
            plan.say_end(failed)
        except OSError:
            self._log.warning("the edge has gone")
        finally:
            plan.released.set()

