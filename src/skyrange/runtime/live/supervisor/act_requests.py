"""Starts and stops by hand that other threads ask of a live range, and the answers of the world's node."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any, Literal, NamedTuple

from skyrange.core.errors import InputError

Answer = Mapping[str, Any]


class ActRequest(NamedTuple):
    """One start or stop by hand."""

    number: int
    action: Literal["start", "stop"]
    act: str
    """Id of the attack, fault or defence."""
    by: str


class ActRequests:
    """Requests that wait for the supervisor, or for the answer of the world's node."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0
        self._new: list[ActRequest] = []
        self._open: dict[int, tuple[ActRequest, Future[Answer]]] = {}
        self._ended = False

    def submit(self, action: Literal["start", "stop"], act: str, by: str) -> Future[Answer]:
        """Have an act started or stopped, from any thread. The result has `at_s`, when it is, in seconds of the range's
        time; or it is the `InputError` that refuses the request, which can be cancelled until it is sent.
        """
        answer: Future[Answer] = Future()
        with self._lock:
            if self._ended:
                raise _ended_error(act)
            self._count += 1
            request = ActRequest(self._count, action, act, by)
            self._new.append(request)
            self._open[request.number] = (request, answer)
        return answer

    @property
    def ended(self) -> bool:
        """Whether nothing is started or stopped any more."""
        return self._ended

    def take(self) -> list[ActRequest]:
        """Those that are to be sent to the world's node now."""
        with self._lock:
            new, self._new = self._new, []
        return [request for request in new if self._open[request.number][1].set_running_or_notify_cancel()]

    def answer(self, number: int, at_s: float | None, error: str) -> bool:
        """Take an answer of the world's node; whether anybody waits for it."""
        request, answer = self._open.pop(number, (None, None))
        if request is None or answer is None:
            return False
        if at_s is not None:
            answer.set_result({"at_s": at_s})
        else:
            expected = "an act that can be started or stopped then"
            answer.set_exception(InputError.one(request.act, request.action, error, expected))
        return True

    def end(self) -> None:
        """Refuse all that waits, and all that comes."""
        with self._lock:
            self._ended = True
            left, self._open, self._new = dict(self._open), {}, []
        for request, answer in left.values():
            if not answer.done() and (answer.running() or answer.set_running_or_notify_cancel()):
                answer.set_exception(_ended_error(request.act))


def _ended_error(act: str) -> InputError:
    return InputError.one("live", act, "the range has ended", "a range that flies")
