"""Replanning of flights by what their ground station learns itself: where it loses links, and what batteries give.

An aircraft whose link is lost may be in a jammed area: the others are led around it. One whose battery would end below
a reserve skips the points between, or returns, whichever takes less. Both ask the approval for the new way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Turn
from skyrange.core.elementary_python import add_up
from skyrange.core.time import Time, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.gcs.flight.lifecycle import FlightState
from skyrange.gcs.flight.sequencer import FlightSequencer
from skyrange.gcs.plan.rerouting import is_met, rest_duration_s
from skyrange.gcs.plan.routes import return_legs
from skyrange.gcs.plan.volumes import around

_TOP_M: Final = 1_000.0
"""A jammed area reaches up to here."""
_LEAST_USED: Final = 3
"""Percent of the battery that have to be used before the use of the rest is estimated; readings are whole percents."""


@dataclass(frozen=True, slots=True)
class Replanning:
    """What flights are replanned for; `None` for nothing."""

    battery_reserve: float | None = None
    """Share of the battery, 0 to 1, that is to be left at the end of a flight."""
    jammed_radius_m: float | None = None
    """How far around the place where a link was lost others do not fly."""
    jammed_ns: Time = 0
    """For how long."""


@dataclass(slots=True)
class Replanner:
    """The replanning of all flights of a station.

    Notes: `decision.area_jammed` about the aircraft whose link was lost, {east_m, north_m}; `decision.battery_short`
    about one whose battery will end below the reserve, {left, at_end}, in percent.
    """

    rules: Replanning
    sequencers: Sequence[FlightSequencer]
    latest_status: Callable[[int], Any]
    """The last SYS_STATUS of the aircraft with an index, or `None`."""
    _jammed: list[Volume4D] = field(default_factory=list)
    _lost: set[int] = field(default_factory=set)
    _avoided: dict[int, int] = field(default_factory=dict)
    """How many of the jammed areas each flight has been checked for."""
    _begun: dict[int, tuple[Time, int]] = field(default_factory=dict)
    """When each flight began, and with how many percent."""
    _short: set[int] = field(default_factory=set)

    def check(self, turn: Turn) -> list[int]:
        """Replan what has to be; returns the indices of flights that were. It is called once a second."""
        changed = []
        if self.rules.jammed_radius_m is not None:
            self._look_for_jamming(turn, self.rules.jammed_radius_m)
        for place, sequencer in enumerate(self.sequencers):
            if sequencer.state is not FlightState.FLYING or not sequencer.claim.tracked or sequencer.link_lost:
                continue
            if self._avoid(turn, place, sequencer) or self._save_battery(turn, place, sequencer):
                changed.append(place)
        return changed

    def _look_for_jamming(self, turn: Turn, radius_m: float) -> None:
        for place, sequencer in enumerate(self.sequencers):
            if not sequencer.link_lost:
                self._lost.discard(place)
            elif place not in self._lost:
                self._lost.add(place)
                if sequencer.state is FlightState.FLYING and sequencer.claim.seen is not None:
                    plan = sequencer.flight.plan
                    position = sequencer.claim.position(plan)
                    area = around(plan.origin, position, radius_m, _TOP_M, turn.now, turn.now + self.rules.jammed_ns)
                    self._jammed.append(area)
                    data: dict[str, Scalar] = {"east_m": position.east_m, "north_m": position.north_m}
                    turn.note("decision.area_jammed", sequencer.flight.vehicle, data)

    def _avoid(self, turn: Turn, place: int, sequencer: FlightSequencer) -> bool:
        """Lead a flight around the areas that it has not been checked for, if it would meet one; where there is no way,
        it flies on.
        """
        areas = [area for area in self._jammed[self._avoided.get(place, 0) :] if area.end_ns > turn.now]
        self._avoided[place] = len(self._jammed)
        plan, claim = sequencer.flight.plan, sequencer.claim
        if not areas or not is_met(areas, plan, sequencer.progress, claim.position(plan), turn.now, claim.margins):
            return False
        closed = [area for area in self._jammed if area.end_ns > turn.now]
        return not sequencer.request_reroute(turn, closed, "a jammed area")

    def _save_battery(self, turn: Turn, place: int, sequencer: FlightSequencer) -> bool:
        """Make a flight shorter whose battery will not last."""
        status = None if self.rules.battery_reserve is None else self.latest_status(place)
        if status is None or status["battery_remaining"] < 0 or self.rules.battery_reserve is None:
            return False
        left = int(status["battery_remaining"])
        since, full = self._begun.setdefault(place, (turn.now, left))
        if full - left < _LEAST_USED or place in self._short:
            return False
        per_s = (full - left) / to_seconds(turn.now - since)
        plan, here = sequencer.flight.plan, sequencer.claim.position(sequencer.flight.plan)
        rest_s = rest_duration_s(plan, sequencer.progress, here)
        if rest_s is None or left - per_s * rest_s >= 100.0 * self.rules.battery_reserve:
            return False
        self._short.add(place)
        turn.note("decision.battery_short", sequencer.flight.vehicle, {"left": left, "at_end": left - per_s * rest_s})
        return_s = add_up(leg.duration_s for leg in return_legs(plan, here))
        direct_s = rest_duration_s(plan, sequencer.progress, here, direct=True)
        if direct_s is not None and direct_s < min(return_s, rest_s):
            return not sequencer.request_reroute(turn, (), "the battery", direct=True)
        if return_s < rest_s:
            sequencer.give_up(turn, "the battery would end below its reserve")
            return True
        return False
