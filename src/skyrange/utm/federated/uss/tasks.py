"""Tasks of a USS: requests of its operators, one after the other; what cannot wait goes before the rest."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from uas_standards.astm.f3548.v21.api import OperationID

from skyrange.codec.f3548.values import ConstraintReference
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, Time
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.intent_states import OFF_NOMINAL, IntentState
from skyrange.utm.request_book import OpenRequest


@dataclass(slots=True)
class Task:
    """A request of an operator, or the end of an intent that was overruled, in progress."""

    intent: OperationalIntent
    request: OpenRequest | None
    causes: tuple[FrameId, ...]
    due: Time = 0
    """When it may begin."""
    relevant: dict[str, None] = field(default_factory=dict)
    """Intents whose OVNs the key has to have."""
    calls: set[int] = field(default_factory=set)
    """Exchanges with the DSS that belong to it."""
    listed: dict[OperationID, Sequence[ConstraintReference]] = field(default_factory=dict)
    """What the DSS has answered to queries."""
    awaited: dict[int, ConstraintReference] = field(default_factory=dict)
    """Intents and constraints whose details are asked for, by exchange."""
    conflicts: int = 0
    """How often the DSS knew more."""
    is_new: bool = False
    """Whether the DSS has accepted the first version of the intent for it."""
    outranked: int = 0
    """How many intents of lower priority the intent overlaps."""
    refusal: str = ""
    """Why the DSS has refused a version, while it is asked for the version that it has."""

    @property
    def ends(self) -> bool:
        """Whether it ends the intent."""
        return self.intent.state is IntentState.ENDED

    def takes(self, exchange: int) -> bool:
        """Whether an exchange belongs to it, which may have one answer."""
        if exchange in self.awaited:
            return True
        if exchange in self.calls:
            self.calls.discard(exchange)
            return True
        return False

    @property
    def is_urgent(self) -> bool:
        """Whether it goes before others: an end, and an aircraft that is outside its volumes."""
        return self.ends or self.intent.state in OFF_NOMINAL


class TaskQueue:
    """Tasks that wait: urgent ones first, otherwise in order of arrival. Deep-copyable."""

    def __init__(self) -> None:
        self._tasks: deque[Task] = deque()

    @property
    def due(self) -> Time:
        """When the next one may begin."""
        return min((task.due for task in self._tasks), default=NEVER)

    def add(self, task: Task) -> None:
        """Add a task."""
        if task.is_urgent:
            self._tasks.insert(sum(1 for queued in self._tasks if queued.is_urgent), task)
        else:
            self._tasks.append(task)

    def take(self, now: Time) -> Task | None:
        """Take the first task that may begin."""
        for task in self._tasks:
            if task.due <= now:
                self._tasks.remove(task)
                return task
        return None
