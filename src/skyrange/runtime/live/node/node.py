"""One node of a live range: a kernel of its own endpoints, paced by the range's clock, on transports to other nodes.

What the kernel hands out for other nodes is written to the link's transport when it would have come out of the link's
channel; what a transport hands in arrives when it was read. Only payloads cross, so a peer may be any program.

A node takes in from its links all that a range sends itself, and of a flood what it can bear. What comes from one link
beyond that is dropped and counted, so that a flood on one link harms no other, and nothing that waits grows without
end.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from heapq import heappop, heappush
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.assembly.build import BuiltScenario
from skyrange.codec.mavlink.deframer import Piece
from skyrange.contracts.components import Observer
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import MIN_LATENCY_NS
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.io.mavlink.transports import OnPiece
from skyrange.kernel import Kernel
from skyrange.kernel.directed_link import Transit
from skyrange.record import Recorder
from skyrange.runtime.acts import describe_manual_acts, list_acts
from skyrange.runtime.event_reports import MAX_STATES, EventCollector, describe_report
from skyrange.runtime.live.clock import RangeClock
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.node.viewers import LiveViewers
from skyrange.runtime.live.system import System
from skyrange.runtime.live.taps.tap_server import TapServer
from skyrange.runtime.live.transport.addresses import Credentials, Crossing
from skyrange.runtime.live.transport.links import Transport

FRAMES_HZ: Final = 2_000.0
"""Sustained frame rate of one link; an aircraft at operator load has 105."""
BYTES_HZ: Final = float(1 << 21)
"""Sustained byte rate of one link."""
BURST_S: Final = 2.0
"""So many seconds of both rates may come at once: five seconds of telemetry after a pause, what a hundred ground
receivers received."""
MAX_WAITING_BYTES: Final = 1 << 26
"""Of all links together."""


@dataclass(slots=True)
class _TokenBucket:
    """What a link may still hand in."""

    at_ns: Time
    frames: float = FRAMES_HZ * BURST_S
    bytes: float = BYTES_HZ * BURST_S


@dataclass(slots=True)
class IngressRateLimiter:
    """Payloads that were received and wait for the node's next turn."""

    dropped: int = 0
    waiting: list[tuple[Time, str, bytes]] = field(default_factory=list)
    """When each was read, on which directed link, and its bytes."""
    _bytes: int = 0
    _buckets: dict[str, _TokenBucket] = field(default_factory=dict)

    def admit(self, at: Time, link: str, data: bytes) -> None:
        """Keep what was read at `at` on the directed link `link`, or drop it."""
        left = self._buckets.get(link)
        if left is None:
            left = self._buckets[link] = _TokenBucket(at)
        past_s = max(at - left.at_ns, 0) / NS_PER_S
        left.at_ns = at
        left.frames = min(left.frames + past_s * FRAMES_HZ, FRAMES_HZ * BURST_S)
        left.bytes = min(left.bytes + past_s * BYTES_HZ, BYTES_HZ * BURST_S)
        if left.frames < 1 or left.bytes < len(data) or self._bytes + len(data) > MAX_WAITING_BYTES:
            self.dropped += 1
            return
        left.frames -= 1
        left.bytes -= len(data)
        self._bytes += len(data)
        self.waiting.append((at, link, data))

    def drain(self) -> list[tuple[Time, str, bytes]]:
        """Take all that waits, in order."""
        waiting, self.waiting = self.waiting, []
        self._bytes = 0
        return waiting


SLICE_NS: Final[Time] = 50 * NS_PER_MS
"""The most that a node catches up at once, so that its transports are served while it is behind."""
PAUSE_NS: Final[Time] = NS_PER_S
"""A node that is later than this was not slow but stood still: what it did not do then it does once, and not as often
as it was due, as a program that was stopped has no old heartbeats to send. The world alone makes good every tick."""
FLUSH_NS: Final = NS_PER_S
"""Between two times at which recorded rows are handed to the disk."""
_Open = Callable[[Crossing, OnPiece, str, Credentials], Awaitable[Transport]]


@dataclass(slots=True)
class Counts:
    """What has crossed between this node and others, since the start."""

    sent: int = 0
    received: int = 0
    unheard: int = 0
    """Payloads that no peer took."""
    dropped: int = 0
    """Payloads that came faster than any link of a range carries (see `IngressRateLimiter`)."""
    garbage: int = 0
    """Of those received, runs of bytes and messages that are nothing the link carries."""
    refused: int = 0
    """Connections and requests that were not let in."""
    early: int = 0
    """Payloads that came before time 0 was known."""
    late_ns: Time = 0
    """The most that something was done after it was due."""
    paused_ns: Time = 0
    """In all, how long it stood still."""


class ActChange(NamedTuple):
    """That an act has begun, and perhaps was stopped, in the process of the world."""

    act: str
    start_ns: Time
    stop_ns: Time | None = None


class Node:
    """One process's part of the range."""

    def __init__(self, config: NodeConfig, built: BuiltScenario, recorder: Recorder, system: System) -> None:
        """`built` has what lives at the endpoints of `config`; `recorder` is told all that happens."""
        self.counts = Counts()
        self._config = config
        self._system = system
        self._viewing = LiveViewers(config.watched) if config.watched else None
        self._events = EventCollector() if config.reports_events else None
        observers: list[Observer] = [one for one in (recorder, self._viewing, self._events) if one is not None]
        self._kernel = Kernel(replace(built.wiring, fuse=False), observers)
        self._medium = built.oracle.medium if built.oracle is not None else None
        self._recorder = recorder
        self._flush_due_ns = 0
        self._can_pause = built.wiring.world is None
        self._duration_ns = built.duration_ns
        self._clock: RangeClock | None = None
        self._transports: dict[str, Transport] = {}
        self._taps = TapServer(config.crossings, frozenset(config.endpoints), recorder)
        self._ingress = IngressRateLimiter()
        self._resting: asyncio.Future[None] | None = None
        self._pending: list[tuple[Time, int, Transit]] = []
        self._pushed = 0
        self._arrived: dict[str, int] = {}
        self._began_cpu_s = time.process_time()
        self._awaits = {act.id for act in built.wiring.acts if act.trigger is not None or act.manual}
        self._acts = list_acts(self._kernel, built, 0)
        self._told = 0
        """Of the starts and stops by hand, how many others have been told."""
        self.changes: asyncio.Queue[ActChange] = asyncio.Queue()
        """Acts whose trigger has held here, and those that were started or stopped by hand."""
        self._stopped = ""
        """Why it ends early, such as "interrupted"; "" while it does not."""

    async def bind(self) -> None:
        """Hold the addresses to which others connect."""
        await self._open(self._system.listen, listens=True)

    async def open_taps(self, folder: Path) -> None:
        """Let tap processes in, by a socket in `folder`."""
        await self._taps.open(folder, lambda: None if self._clock is None else self._clock.now(), self._wake)

    async def connect(self) -> None:
        """Connect to the others."""
        await self._open(self._system.connect, listens=False)

    async def _open(self, how: _Open, *, listens: bool) -> None:
        endpoints = frozenset(self._config.endpoints)
        for crossing in self._config.crossings:
            spec = crossing.link
            if (crossing.listener in endpoints) is not listens:
                continue
            incoming = f"{spec.name}:{'rev' if spec.a in endpoints else 'fwd'}"
            try:
                on_piece = partial(self._receive, incoming)
                transport = await how(crossing, on_piece, self._config.host, self._config.credentials)
                self._transports[spec.name] = transport
            except OSError as error:
                host, port = crossing.address
                raise ComponentError(
                    self._config.name,
                    f"{spec.name} at {host}:{port}: {error.strerror or error}",
                    "Move all ports with --port-offset",
                ) from error

    def _receive(self, link: str, piece: Piece) -> None:
        if self._clock is None:
            self.counts.early += 1  # a stranger's: no node of the range sends before it
            return
        self.counts.garbage += piece.garbage
        self._ingress.admit(self._clock.now(), link, piece.data)
        self._wake()

    def boot(self) -> None:
        """Run everything before time 0."""
        if self._kernel.now < -1 and not self._config.restarted:
            self._kernel.advance(-1)

    def stop(self, why: str) -> None:
        """End before the scenario does."""
        self._stopped = self._stopped or why
        self._wake()

    def set_zero(self, zero_ns: int) -> None:
        """Set the range's time 0 on this machine's clock, known better than before; time reached stays reached."""
        if self._clock is not None:
            self._clock.zero_ns = zero_ns

    def change_act(self, change: ActChange) -> None:
        """Let an act begin, and end, as where the world is: its trigger has held, or somebody started or stopped it."""
        self._kernel.begin(change.act, change.start_ns)
        if change.stop_ns is not None:
            self._kernel.end_act(change.act, change.stop_ns)

    def request_act(self, act: str, action: str, by: str) -> float:
        """Start or stop an act by hand; when that happens, in seconds. Raises as `RunAct.start` and `RunAct.stop`."""
        found = self._acts[act]
        return found.start(by=by) if action == "start" else found.stop(by=by)

    async def run(self, zero_ns: int) -> str:
        """Run until the scenario's end, or until it is stopped; the status of the record."""
        clock = self._clock = RangeClock(self._system.clock, zero_ns)
        if self._viewing is not None:
            self._viewing.open()
        self._began_cpu_s = time.process_time()
        if self._config.restarted:
            self._kernel.skip(clock.now())
        while not self._stopped:
            now = clock.now()
            if now >= 0:
                self._advance(min(now, self._duration_ns))
                self._flush()
                if self._kernel.now >= self._duration_ns:
                    return "complete"
            due = self._pending[0][0] if self._pending else self._duration_ns
            due = max(min(self._kernel.due, due, self._taps.due, self._duration_ns), 0)
            await self._rest((due - clock.now()) / NS_PER_S)
        return self._stopped

    def _flush(self) -> None:
        now_ns = self._system.clock.monotonic_ns()
        if now_ns >= self._flush_due_ns:
            self._flush_due_ns = now_ns + FLUSH_NS
            self._recorder.flush()

    async def _rest(self, seconds: float) -> None:
        """Wait so long, or until something is received; transports are served at least once."""
        if self._ingress.waiting or seconds <= 0.0:
            await asyncio.sleep(0)
            return
        # a future and a timer: an Event within asyncio.timeout does the same for half as much again
        loop = asyncio.get_running_loop()
        resting = self._resting = loop.create_future()
        timer = loop.call_later(seconds, self._wake)
        try:
            await resting
        finally:
            timer.cancel()

    def _wake(self) -> None:
        if self._resting is not None and not self._resting.done():
            self._resting.set_result(None)

    def _advance(self, now: Time) -> None:
        """Take in what was received, run on to `now`, and send what is due."""
        kernel = self._kernel
        now = max(now, kernel.now)  # where the clock was set back
        late_ns = now - kernel.due
        self.counts.late_ns = max(self.counts.late_ns, late_ns)
        if late_ns > PAUSE_NS and self._can_pause:
            self.counts.paused_ns += late_ns
            kernel.skip(now)
        until = min(now, max(kernel.now, min(kernel.due, now)) + SLICE_NS)
        received = self._ingress.drain()
        inbound = [self._transit(link, data, max(at, kernel.now + 1)) for at, link, data in received]
        inbound = self._through_taps(now, inbound)
        for transit in kernel.advance(until, inbound):
            self._pushed += 1
            heappush(self._pending, (transit.arrival, self._pushed, transit))
        self._tell_changes()
        while self._pending and self._pending[0][0] <= now:
            frame = heappop(self._pending)[2].frame
            if self._taps.holds(frame.link):
                self._taps.take(now, frame, outgoing=True)
            else:
                self._send(frame)

    def _tell_changes(self) -> None:
        """Tell of acts that have begun by a trigger or by hand, and of those that were stopped by hand."""
        kernel = self._kernel
        if self._awaits:
            for act in self._awaits & kernel.triggered.keys():
                self._awaits.remove(act)
                self.changes.put_nowait(ActChange(act, kernel.triggered[act]))
        if kernel.manual_acts_done > self._told:
            done, _ = kernel.list_manual_acts()
            for manual, effective in done[self._told :]:
                if effective and manual.action == "stop":
                    state = kernel.list_acts()[manual.act]
                    self.changes.put_nowait(ActChange(manual.act, state.start_ns, state.stop_ns))
            self._told = len(done)

    def _through_taps(self, now: Time, inbound: list[Transit]) -> list[Transit]:
        """What comes in after those taps that are processes of their own; what they let out is sent."""
        free = []
        for transit in inbound:
            if self._taps.holds(transit.frame.link):
                self._taps.take(now, transit.frame, outgoing=False)
            else:
                free.append(transit)
        for frame, outgoing in self._taps.turn(now):
            if outgoing:
                self._send(frame)
            else:
                arrival = max(now, self._kernel.now + 1, frame.sent_ns + MIN_LATENCY_NS)
                free.append(Transit(arrival, f"{frame.link}:{frame.direction}", frame))
        return free

    def _transit(self, link: str, data: bytes, arrival: Time) -> Transit:
        """What was received, as the kernel takes it: who truly sent it, and when, is known where it was sent."""
        self.counts.received += 1
        serial = self._arrived.get(link, 0)
        self._arrived[link] = serial + 1
        name, _, direction = link.rpartition(":")
        src, dst = self._kernel.link_ends(link)
        return Transit(arrival, link, Frame(name, direction, src, serial, src, dst, sent_ns=arrival, payload=data))

    def _send(self, frame: Frame) -> None:
        self._recorder.on_frame(frame)  # in flight, as far as is known here
        if self._viewing is not None:
            self._viewing.show_outgoing(frame)
        transport = self._transports.get(frame.link)
        if transport is not None and transport.send(frame.payload):
            self.counts.sent += 1
        else:
            self.counts.unheard += 1

    @property
    def status(self) -> Mapping[str, Any]:
        """For the supervisor's table and the manifest: numbers, and the programs of the radio medium."""
        now = self._clock.now() if self._clock is not None else 0
        self.counts.dropped = self._ingress.dropped
        self.counts.refused = sum(transport.refused for transport in self._transports.values())
        return {
            **asdict(self.counts),
            **(self._viewing.status if self._viewing is not None else {}),
            **({} if self._can_pause else self._describe_acts()),
            "now_ns": self._kernel.now,
            "lag_ns": max(min(now, self._duration_ns) - self._kernel.due, 0),
            "cpu_s": time.process_time() - self._began_cpu_s,
            "programs": [program._asdict() for program in (self._medium.programs if self._medium is not None else ())],
        }

    def _describe_acts(self) -> dict[str, Any]:
        """What acts here, where the world is, and what was started and stopped by hand."""
        return {
            "acts": [act.describe() for act in self._acts.values()],
            "manual_acts": describe_manual_acts(self._kernel, 0),
        }

    def take_events(self) -> Mapping[str, Any]:
        """What happened since the last time, for the supervisor's display; nothing without one."""
        return {} if self._events is None else {"events": describe_report(self._events.take(MAX_STATES))}

    def close(self) -> None:
        """Give sockets and programs back; what still waits to be sent is in flight."""
        for _, _, transit in sorted(self._pending, key=lambda entry: entry[:2]):
            self._recorder.on_frame(transit.frame)
        self._pending.clear()
        self._taps.close(self._kernel.now)
        for transport in self._transports.values():
            transport.close()
        if self._viewing is not None:
            self._viewing.close()
        self._kernel.finish()
