"""Agent of a UTM service in real time: each step takes the frames that have arrived, and is durable before it is
answered.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Final

from skyrange.contracts.components import Agent
from skyrange.contracts.mailboxes import Arrival, Departure, Inbox, Note
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Epoch, Time

UNIX: Final = Epoch(0)
"""The clock of a service is Unix time, so that what it has stored means the same after a restart."""


class AgentHost:
    """Steps an agent whenever frames arrive or its time comes.

    Frames that arrive while it is busy are handled in one step, so that one commit serves them all.
    """

    def __init__(
        self,
        agent: Agent,
        send: Callable[[Departure], None],
        *,
        commit: Callable[[], None] = lambda: None,
        note: Callable[[Time, Note], None] = lambda now, note: None,
    ) -> None:
        """`send` gets what it sends, after `commit` has returned; `note` its decisions."""
        self._agent = agent
        self._send = send
        self._commit = commit
        self._note = note
        self._arrivals: list[Arrival] = []
        self._serial = 0
        self._now: Time = 0
        self._scheduled = False
        self._timer: asyncio.TimerHandle | None = None
        self._failure: Exception | None = None
        self.failed = asyncio.Event()
        """Set when the agent or its database has raised, which ends the service."""

    @property
    def failure(self) -> Exception | None:
        """What the agent or its database has raised."""
        return self._failure

    def deliver(self, port: Port, payload: bytes, sender: str) -> None:
        """Give the agent a frame at its next step."""
        self._serial += 1
        ref = FrameId(port.link, "fwd", sender, self._serial)
        self._arrivals.append(Arrival(port, self.now(), payload, sender, ref))
        self._schedule()

    def start(self) -> None:
        """Let the agent go on with what it had in progress."""
        self._schedule()

    def close(self) -> None:
        """Step the agent no more."""
        if self._timer is not None:
            self._timer.cancel()
        self._scheduled = True

    def now(self) -> Time:
        """Nanoseconds since 1970, never less than before."""
        self._now = max(self._now, time.time_ns() - UNIX.unix_ns)
        return self._now

    def _schedule(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            asyncio.get_running_loop().call_soon(self._step)

    def _step(self) -> None:
        arrivals, self._arrivals = self._arrivals, []
        self._scheduled = False
        now = self.now()
        try:
            out = self._agent.step(now, Inbox(arrivals))
            self._commit()
        except Exception as error:
            self._failure = error
            self.failed.set()
            self.close()
            return
        for departure in out.departures:
            self._send(departure)
        for note in out.notes:
            self._note(now, note)
        self._wait()

    def _wait(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        due = self._agent.next_wakeup()
        if due is not None:
            delay_s = max(due - self.now(), 0) / NS_PER_S
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._schedule)
