"""The threads on which a driver's plans are played."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from .plan import Plan, PlanEnded

#: How long a plan may take to end after its cancellation, in seconds: less than the edge waits for an answer.
_END_WAIT = 0.8


class Plans:
    """Plays each plan on its own thread."""

    def __init__(
        self,
        play: Callable[[Plan], None],
        say: Callable[[str], None],
        silence: Callable[[], float],
        log: logging.Logger,
    ) -> None:
        self._play, self._say, self._silence, self._log = play, say, silence, log
        self._lock = threading.Lock()
        self._playing: dict[int, tuple[Plan, threading.Thread]] = {}

    def take(self, told: dict[str, Any]) -> None:
        """Starts a plan, and returns at once."""
        plan = Plan(told, self._say, self._silence)
        thread = threading.Thread(target=self._run, args=(plan,), name=f"plan {plan.id}", daemon=True)
        with self._lock:
            self._playing[plan.id] = (plan, thread)
        thread.start()

    def take_more(self, told: dict[str, Any]) -> None:
        """Adds further steps to a plan; ignores them if the plan is over."""
        with self._lock:
            playing = self._playing.get(int(told["plan"]))
        if playing is not None:
            playing[0].add(told)

    def cancel(self, plan: int, then: str, why: str) -> bool:
        """Cancels a plan. Returns False if its thread has not ended in time, so that it may still move the device."""
        with self._lock:
            playing = self._playing.get(plan)
        if playing is None:
            return True
        playing[0].cancel(then, why)
        playing[1].join(_END_WAIT)
        return not playing[1].is_alive()

    def cancel_all(self, then: str, why: str) -> list[Plan]:
        """Ends all plans, because the edge has ended. Returns the plans that had started."""
        with self._lock:
            playing = list(self._playing.values())
        for plan, _ in playing:
            plan.cancel(then, why)
        for plan, thread in playing:
            thread.join(_END_WAIT)
            if thread.is_alive():
                self._log.error("plan %d of %s does not end", plan.id, plan.device)
        return [plan for plan, _ in playing if plan.is_started]

    def _run(self, plan: Plan) -> None:
        failed = None
        try:
            self._play(plan)
        except PlanEnded as ended:
            failed = None if plan.then is not None else str(ended)
        except Exception as error:  # Report every error to the edge.
            self._log.exception("plan %d of %s failed", plan.id, plan.device)
            failed = f"{type(error).__name__}: {error}"
        with self._lock:
            self._playing.pop(plan.id, None)
        try:
            plan.say_end(failed)
        except OSError:
            self._log.warning("the edge has gone")
