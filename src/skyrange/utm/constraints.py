"""Constraints: areas that a constraint manager closes to flight, and when it publishes them.

An approval treats one as an activated intent of the highest priority: nothing is accepted into it, intents that have
not been activated are taken back, and those in flight are told.
"""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.core.time import Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import CONSTRAINT_PRIORITY, Constraint, OperationalIntent
from skyrange.utm.intent_states import IntentState


def claim_of(id_: str, name: str, volumes: Sequence[Volume4D]) -> OperationalIntent:
    """The intent as which an approval treats a constraint."""
    return OperationalIntent(id_, "", f"constraint {name}", tuple(volumes), CONSTRAINT_PRIORITY, IntentState.ACTIVATED)


class Publication:
    """Constraints in the order of their publication. Deep-copyable."""

    def __init__(self, constraints: Sequence[Constraint] = ()) -> None:
        self._waiting = sorted(constraints, key=lambda one: (one.published_ns, one.name))

    @property
    def due(self) -> Time | None:
        """When the next one is published."""
        return self._waiting[0].published_ns if self._waiting else None

    def take(self, now: Time) -> list[Constraint]:
        """Those that are published by `now`, each once."""
        count = sum(one.published_ns <= now for one in self._waiting)
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        return taken
