"""Order in which an approval decides requests that compete: policies of fairness between operators.

Without such a policy an approval decides each request when it arrives: first come, first served.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from skyrange.core.time import Time
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import EndBody
from skyrange.utm.request_book import OpenRequest


class WaitingRequest(NamedTuple):
    """What a policy knows of a request that waits."""

    operator: str
    arrived_ns: Time
    accepted: int
    """How many intents of the operator were accepted so far, those that have ended included."""
    tie: bytes
    """Digest of the request, which favours nobody."""


RequestOrder = Callable[[Sequence[WaitingRequest]], int]
"""A policy: the number of the request, of one or more that wait in order of arrival, that is decided next."""


def least_served(waiting: Sequence[WaitingRequest]) -> int:
    """Prefer the operator with the fewest accepted intents; of equal ones, the earliest request."""
    return min(range(len(waiting)), key=lambda row: (waiting[row].accepted, waiting[row].arrived_ns, waiting[row].tie))


class RequestQueue:
    """Requests for airspace that wait for others to compete with. Deep-copyable.

    The first one opens a window of time. At its end all that wait are decided, in the order of the policy.
    """

    def __init__(self, order: RequestOrder, window_ns: Time) -> None:
        self._order = order
        self._window_ns = window_ns
        self._waiting: list[tuple[Time, OpenRequest]] = []
        self.due: Time | None = None
        """When the window ends."""

    def add(self, now: Time, asked: OpenRequest) -> bool:
        """Let a request wait; False for one that does not claim airspace for a later flight, which cannot wait."""
        body = asked.request.body
        if isinstance(body, EndBody) or body.state is not IntentState.ACCEPTED:
            return False
        if not self._waiting:
            self.due = now + self._window_ns
        self._waiting.append((now, asked))
        return True

    def take(self, now: Time, accepted: Mapping[str, int]) -> OpenRequest | None:
        """The next request, if the window is over. `accepted`: how many intents of each operator were accepted."""
        if self.due is None or now < self.due:
            return None
        rows = [WaitingRequest(one.operator, at, accepted[one.operator], one.digest) for at, one in self._waiting]
        return self._remove(self._order(rows))

    def take_earlier(self, intent: str) -> OpenRequest | None:
        """The request for an intent that waits while another one for it arrives."""
        for row, (_, one) in enumerate(self._waiting):
            if one.request.body.id == intent:
                return self._remove(row)
        return None

    def _remove(self, row: int) -> OpenRequest:
        _, taken = self._waiting.pop(row)
        if not self._waiting:
            self.due = None
        return taken
