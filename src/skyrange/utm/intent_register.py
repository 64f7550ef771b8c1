"""Register of operational intents: what is known to claim airspace, and what is in the way of another intent."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace.claimed_airspace import ANY_RANK, MAX_RANK, Airspace, Overlap, Query
from skyrange.utm.airspace.solids import find_invalid
from skyrange.utm.alternatives import Limits, find_alternatives
from skyrange.utm.contract import Alternative, OperationalIntent
from skyrange.utm.intent_states import MAX_HORIZON_NS, MAX_VERTICES, OFF_NOMINAL, IntentState, may_follow

KEPT_NS: Final = 3_600 * NS_PER_S
"""How long an intent that nobody has ended is known after its last volume."""


@dataclass(frozen=True, slots=True)
class Examination:
    """What is in the way of an intent."""

    reason: str = ""
    """Why it cannot be accepted; empty if it can."""
    alternatives: tuple[Alternative, ...] = ()
    outranked: tuple[OperationalIntent, ...] = ()
    """Intents of lower priority that it overlaps, by id."""


class IntentRegister:
    """Operational intents by id, with their airspace. Deep-copyable.

    An intent is in the way of another if a volume of the one overlaps one of the other, and it has the same or a higher
    priority, or its aircraft does not keep to its volumes. An activated intent may be changed in spite of a conflict
    that it has already (F3548-21, SCD0030 and SCD0050).
    """

    def __init__(self, limits: Limits) -> None:
        """`limits` of the alternatives that are offered."""
        self._limits = limits
        self._airspace = Airspace()
        self._intents: dict[str, OperationalIntent] = {}
        self._ends: list[tuple[Time, str]] = []

    def get(self, intent: str) -> OperationalIntent | None:
        """The intent with an id, if it is known."""
        return self._intents.get(intent)

    def put(self, intent: OperationalIntent) -> None:
        """Add an intent, or its next version."""
        self._airspace.put(intent.id, intent.volumes, _rank_of(intent))
        self._intents[intent.id] = intent
        heappush(self._ends, (max(volume.end_ns for volume in intent.volumes) + KEPT_NS, intent.id))

    def remove(self, intent: str) -> None:
        """Release the airspace of an intent, if it is known."""
        self._airspace.remove(intent)
        self._intents.pop(intent, None)

    def forget(self, now: Time) -> list[str]:
        """Remove intents that are long over; returns their ids."""
        forgotten = []
        while self._ends and self._ends[0][0] < now:
            _, id_ = heappop(self._ends)
            intent = self._intents.get(id_)
            if intent is not None and max(volume.end_ns for volume in intent.volumes) + KEPT_NS < now:
                self.remove(id_)
                forgotten.append(id_)
        return forgotten

    def overlapping(self, volumes: Sequence[Volume4D], ignored: str = "") -> list[str]:
        """The ids of the intents that some volumes overlap, in order."""
        return sorted({overlap.intent for overlap in self._airspace.find_overlaps(volumes, ignored=ignored)})

    def examine(self, request: OperationalIntent, *, offers: bool = True) -> Examination:
        """What is in the way of `request`, and with `offers` alternatives to it, which take time to find."""
        overlaps = self._airspace.find_overlaps(request.volumes, ignored=request.id)
        blocking = [overlap for overlap in overlaps if self._blocks(overlap, request)]
        if blocking and request.state is IntentState.ACTIVATED:
            present = self._conflicts_of(request.id)
            blocking = [overlap for overlap in blocking if overlap.intent not in present]
        if blocking:
            return Examination(self._describe(blocking), tuple(self._offer(request)) if offers else ())
        return Examination(outranked=tuple(self._lower(overlaps, request)))

    def find_lower(self, intent: OperationalIntent) -> list[OperationalIntent]:
        """The intents that an intent overlaps and outranks, by id."""
        return self._lower(self._airspace.find_overlaps(intent.volumes, ignored=intent.id), intent)

    def _lower(self, overlaps: Sequence[Overlap], request: OperationalIntent) -> list[OperationalIntent]:
        lower = sorted({overlap.intent for overlap in overlaps if not self._blocks(overlap, request)})
        return [self._intents[id_] for id_ in lower]

    def _blocks(self, overlap: Overlap, request: OperationalIntent) -> bool:
        return _rank_of(self._intents[overlap.intent]) >= _lowest_rank(request)

    def _conflicts_of(self, id_: str) -> Container[str]:
        """The intents that an activated one overlaps as it is."""
        intent = self._intents.get(id_)
        if intent is None or intent.state is not IntentState.ACTIVATED:
            return ()
        return self.overlapping(intent.volumes, ignored=id_)

    def _offer(self, request: OperationalIntent) -> list[Alternative]:
        def search(queries: Sequence[Query]) -> list[Time | None]:
            return self._airspace.find_least_delays(queries, request.id, _lowest_rank(request))

        return find_alternatives(request.volumes, search, self._limits)

    def _describe(self, blocking: Sequence[Overlap]) -> str:
        vehicles = list(dict.fromkeys(self._intents[overlap.intent].vehicle for overlap in blocking))
        others = f" and {len(vehicles) - 1} others" if len(vehicles) > 1 else ""
        return f"volume {blocking[0].place + 1} overlaps a volume of {vehicles[0]}{others}"


def _lowest_rank(request: OperationalIntent) -> int:
    """The lowest rank of intents that are in the way of a request."""
    return min(max(request.priority, ANY_RANK), MAX_RANK)


def _rank_of(intent: OperationalIntent) -> int:
    """A higher rank is in the way of more: it is the priority, but nobody may overlap an off-nominal intent."""
    return MAX_RANK if intent.state in OFF_NOMINAL else _lowest_rank(intent)


def find_problem(now: Time, request: OperationalIntent, state: IntentState | None) -> str:
    """What is wrong with a request by itself, whatever others claim; `state` is that of the intent so far."""
    if not may_follow(state, request.state):
        return f"an intent that is {state.value if state else 'unknown'} cannot become {request.state.value}"
    if max(volume.end_ns for volume in request.volumes) <= now:
        return "all its volumes are over"
    if max(volume.end_ns for volume in request.volumes) > now + MAX_HORIZON_NS:
        return f"it ends more than {MAX_HORIZON_NS // (86_400 * NS_PER_S)} days ahead"
    vertices = sum(len(volume.outline) for volume in request.volumes)
    if vertices > MAX_VERTICES:
        return f"its outlines have {vertices} vertices, at most {MAX_VERTICES} are allowed"
    invalid = find_invalid(request.volumes)
    if invalid is not None:
        return f"the outline of volume {invalid + 1} crosses itself, or has no area"
    return ""
