"""States of an operational intent, and the transitions between them that ASTM F3548-21 allows."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from skyrange.core.time import NS_PER_S, Time


class IntentState(StrEnum):
    """State of an operational intent (F3548-21, OperationalIntentState), and its end."""

    ACCEPTED = "Accepted"
    """Planned and free of conflicts; the aircraft has not taken off."""
    ACTIVATED = "Activated"
    """In use; the aircraft stays within the volumes."""
    NONCONFORMING = "Nonconforming"
    """The aircraft has left the volumes for a while and is expected to return into them."""
    CONTINGENT = "Contingent"
    """The aircraft will not return into the volumes; it flies its contingency."""
    ENDED = "Ended"
    """Withdrawn, or flown."""


S = IntentState
TRANSITIONS: Mapping[IntentState | None, frozenset[IntentState]] = MappingProxyType(
    {
        None: frozenset({S.ACCEPTED, S.ACTIVATED, S.NONCONFORMING, S.CONTINGENT}),
        S.ACCEPTED: frozenset({S.ACCEPTED, S.ACTIVATED, S.NONCONFORMING, S.CONTINGENT, S.ENDED}),
        S.ACTIVATED: frozenset({S.ACTIVATED, S.NONCONFORMING, S.CONTINGENT, S.ENDED}),
        S.NONCONFORMING: frozenset({S.NONCONFORMING, S.ACTIVATED, S.CONTINGENT, S.ENDED}),
        S.CONTINGENT: frozenset({S.CONTINGENT, S.ENDED}),
        S.ENDED: frozenset(),
    }
)
"""State → the states that may follow; the same state again is another version of its volumes. `None` is an intent that
the service does not know: an aircraft that flies without one is off-nominal from the beginning."""

OFF_NOMINAL = frozenset({S.NONCONFORMING, S.CONTINGENT})
"""States that are reported and never refused: the aircraft is where it is."""

EXCURSION_NS: Time = 10 * NS_PER_S
"""An aircraft outside its volumes for longer is nonconforming (F3548-21, OiMaxDurationPerExcursion)."""
RECOVERY_NS: Time = 60 * NS_PER_S
"""One that is nonconforming for longer is contingent (F3548-21, MaxRecoverableTimeInNonconformingState)."""
MAX_HORIZON_NS: Time = 30 * 86_400 * NS_PER_S
"""How far ahead an intent may lie (F3548-21, OiMaxPlanHorizon)."""
MAX_VERTICES = 10_000
"""Vertices of all outlines of an intent (F3548-21, OiMaxVertices)."""


def may_follow(state: IntentState | None, after: IntentState) -> bool:
    """Whether `after` may follow `state`; `None` is an unknown intent."""
    return after in TRANSITIONS[state]
