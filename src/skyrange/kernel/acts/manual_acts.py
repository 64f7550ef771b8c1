"""Starts and stops by hand of the acts of one run: those that wait for their time, and those that have happened."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from skyrange.contracts.links import ManualAct
from skyrange.core.errors import InputError
from skyrange.core.time import NEVER, Time, to_seconds
from skyrange.kernel.acts.act_states import ActState


class CarriedOut(NamedTuple):
    """A start or a stop by hand whose time has come."""

    act: ManualAct
    effective: bool
    """Whether it started or stopped the act, which it does unless the act had started, or had ended, before."""


class ManualActs:
    """Starts and stops by hand: each is carried out at the tick at which it happens, and not known to parts before."""

    def __init__(self, planned: Sequence[ManualAct], states: Mapping[str, ActState]) -> None:
        """`planned` are those of the scenario; of acts that are not in `states` another kernel takes care."""
        self._states = states
        self._waiting = sorted((act for act in planned if act.act in states), key=lambda act: act.at_ns)
        self.carried_out: list[CarriedOut] = []
        """In order of time."""

    @property
    def waiting(self) -> Sequence[ManualAct]:
        """Those that are still to come, in order of time."""
        return self._waiting

    @property
    def next_due(self) -> Time:
        """When the next one happens."""
        return self._waiting[0].at_ns if self._waiting else NEVER

    def request(self, act: ManualAct) -> None:
        """Have an act started or stopped. It replaces one that the scenario plans for later.

        Raises `InputError` for a start of an act that is not manual, that has started, or whose time is not then, and
        for a stop of one that does not act then; `KeyError` for an unknown id.
        """
        state = self._states[act.act]
        problem = _explain_start(state, act.at_ns) if act.action == "start" else _explain_stop(state, act.at_ns)
        same = [other for other in self._waiting if (other.act, other.action) == (act.act, act.action)]
        if not problem and any(other.at_ns <= act.at_ns for other in same):
            problem = f"{act.action}s at {_words(act.at_ns)}", "one request"
        if problem:
            value, expected = problem
            hint = _TWICE if act.action == "start" and state.start_ns != NEVER else ""
            raise InputError.one(f"{state.plan.role} {state.id}", act.action, value, expected, hint)
        self._waiting = sorted([*(other for other in self._waiting if other not in same), act], key=_time_of)

    def carry_out(self, now: Time) -> Iterator[ActState]:
        """Start and stop what is due at a tick; gives each act that has started."""
        while self.next_due <= now:
            act = self._waiting.pop(0)
            state = self._states[act.act]
            explain = _explain_start if act.action == "start" else _explain_stop
            effective = not explain(state, now)
            self.carried_out.append(CarriedOut(act, effective))
            if effective and act.action == "start":
                state.begin(now, by=act.by)
                yield state
            elif effective:
                state.end(now, by=act.by)


_TWICE = "An act starts once. Declare it twice, under two names."


def _time_of(act: ManualAct) -> Time:
    return act.at_ns


def _words(time: Time) -> str:
    return f"{to_seconds(time):g} s"


def _explain_start(state: ActState, at: Time) -> tuple[str, str] | None:
    """Why an act cannot be started by hand at a time, and what was expected."""
    plan = state.plan
    if not plan.manual:
        how = f"starts at {_words(plan.start_ns)}" if plan.trigger is None else "starts by its condition"
        return how, "an act that is declared with manual = true"
    if state.start_ns != NEVER:
        return f"has started at {_words(state.start_ns)}", "an act that has not started"
    if at < plan.start_ns:
        return f"at {_words(at)}", f"{_words(plan.start_ns)} or later, its start_s"
    if at >= plan.stop_ns:
        return f"at {_words(at)}", f"earlier than {_words(plan.stop_ns)}, its stop_s"
    return None


def _explain_stop(state: ActState, at: Time) -> tuple[str, str] | None:
    """Why an act cannot be stopped by hand at a time, and what was expected."""
    if state.start_ns >= at:
        return "has not started", "an act that acts"
    if state.stop_ns <= at:
        return f"ends at {_words(state.stop_ns)}", f"an act that acts at {_words(at)}"
    return None
