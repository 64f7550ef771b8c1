"""Benchmark of the live range's transports: rate and latency between two processes on loopback.

First frames one by one, each with the time at which it was sent, on the clock that both share; then as many as
possible, back to back. The measurement includes a node's transports, but not its kernel.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import socket
import statistics
import struct
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, Final

import zmq

from skyrange.bench.isolation import run_in_process
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.deframer import Piece
from skyrange.contracts.links import LinkEnds
from skyrange.core.errors import ComponentError
from skyrange.io.http import frames as http_frames
from skyrange.runtime.live.deployment import LOOPBACK
from skyrange.runtime.live.transport.addresses import KINDS, Credentials, Crossing, TransportKind, issue_credentials
from skyrange.runtime.live.transport.links import Transport, connect, listen

TRANSPORTS: Final[tuple[TransportKind, ...]] = ("udp", "tcp", "zmq", "http")
ONE_BY_ONE: Final = 500
"""Frames that are timed, `APART_S` after each other: about as fast as an aircraft's telemetry comes."""
APART_S: Final = 0.005
WINDOW: Final = 128
"""Frames in transit at most when they are sent back to back, fewer than a UDP socket's buffer holds."""
CREDIT: Final = 32
"""The listener answers every 32nd frame with one, which opens the window again; over HTTP each, as it must."""
PATIENCE_S: Final = 60.0
_PATH: Final = "/bench/frame"
_TIMESYNC: Final = mav.MAVLink(None, srcSystem=1, srcComponent=1)
_HEADER: Final = 10


def frame(transport: TransportKind, at_ns: int, number: int) -> bytes:
    """A frame of that transport: a MAVLink TIMESYNC, or a request, with a time and a number in it."""
    if transport == "http":
        return http_frames.request_frame("PUT", _PATH, json.dumps({"at_ns": at_ns, "number": number}).encode())
    return bytes(mav.MAVLink_timesync_message(at_ns, number).pack(_TIMESYNC))


def sent_at(transport: TransportKind, data: bytes) -> int:
    """The time in a `frame`."""
    if transport == "http":
        return int(json.loads(data)["body"]["at_ns"])
    (at_ns,) = struct.unpack_from("<q", data, _HEADER)  # the first field: MAVLink sorts by size, both are of 8 bytes
    return int(at_ns)


def measure(transport: TransportKind, frames: int = 50_000) -> dict[str, Any]:
    """One row: `ONE_BY_ONE` frames, then `frames` back to back, from one new process to another.

    `added_ms` and `added_p99_ms` are from the call of a transport's `send` to the delivery of the payload by the other.
    `frames_per_s` is received frames by the wall clock, `frames_per_core_s` by the processor time of both processes
    together, all their threads: what one core sends and receives. Over HTTP a request and its answer are two frames.
    Raises `ComponentError` if frames do not arrive.
    """
    return run_in_process(f"bench of {transport}", _measured, transport, frames)


def _measured(transport: TransportKind, frames: int) -> dict[str, Any]:
    kind = socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as tried:
        tried.bind((LOOPBACK, 0))
        crossing = _crossing(transport, int(tried.getsockname()[1]))
    context = multiprocessing.get_context("spawn")
    parent_end, child_end = context.Pipe()
    listener = context.Process(target=_listen, args=(child_end, crossing, frames))
    listener.start()
    child_end.close()
    try:
        parent_end.recv()  # it listens
        cpu_s = asyncio.run(_call(crossing, frames))
        if not parent_end.poll(PATIENCE_S):
            raise ComponentError(f"bench of {transport}", f"not all frames came within {PATIENCE_S:g} s")
        answer = parent_end.recv()
    except EOFError:
        raise ComponentError(f"bench of {transport}", "its listener ended") from None
    finally:
        listener.terminate()
        listener.join()
    crossed = 2 * frames if transport == "http" else frames
    cpu_s += answer["cpu_s"]
    return {
        "transport": transport,
        "links": _carried(transport),
        "frames": crossed,
        "frame_bytes": len(frame(transport, time.monotonic_ns(), 1)),
        "frames_per_s": round(crossed / answer["took_s"]),
        "frames_per_core_s": round(crossed / cpu_s),
        "added_ms": answer["added_ms"],
        "added_p99_ms": answer["added_p99_ms"],
    }


def _carried(transport: TransportKind) -> list[str]:
    """The kinds of links that use a transport."""
    return [name for name, kind in KINDS.items() if kind.transport == transport]


def _crossing(transport: TransportKind, port: int) -> Crossing:
    return Crossing(
        LinkEnds(f"{_carried(transport)[0]}:bench", "caller", "listener"), transport, "listener", (LOOPBACK, port)
    )


def _credentials() -> Credentials:
    return issue_credentials(zmq.curve_keypair()[0])  # not asked for on loopback


# --- the listener's process ------------------------------------------------------------------------


def _listen(answer: Connection, crossing: Crossing, frames: int) -> None:
    answer.send(asyncio.run(_Listener(answer, crossing, frames).run()))


class _Listener:
    """Measures the delay of the first frames and counts the others."""

    def __init__(self, answer: Connection, crossing: Crossing, frames: int) -> None:
        self._answer = answer
        self._crossing = crossing
        self._last = ONE_BY_ONE + frames
        self._count = 0
        self._added_ns: list[int] = []
        self._began = (0.0, 0.0)
        self._transport: Transport | None = None
        self._done = asyncio.Event()

    async def run(self) -> dict[str, Any]:
        self._transport = await listen(self._crossing, self._receive, LOOPBACK, _credentials())
        self._answer.send("listening")
        await self._done.wait()
        took_s, cpu_s = time.monotonic() - self._began[0], time.process_time() - self._began[1]
        await asyncio.sleep(APART_S)  # the last answer has to go out
        self._transport.close()
        added_ms = sorted(ns / 1e6 for ns in self._added_ns)
        return {
            "took_s": took_s,
            "cpu_s": cpu_s,
            "added_ms": round(statistics.median(added_ms), 3),
            "added_p99_ms": round(added_ms[int(0.99 * len(added_ms))], 3),
        }

    def _receive(self, piece: Piece) -> None:
        self._count += 1
        transport = self._crossing.transport
        if self._count <= ONE_BY_ONE:
            self._added_ns.append(time.monotonic_ns() - sent_at(transport, piece.data))
        elif self._count == ONE_BY_ONE + 1:
            self._began = time.monotonic(), time.process_time()
        assert self._transport is not None
        if transport == "http":
            self._transport.send(http_frames.response_frame(200, _PATH, b"{}"))
        elif self._count % CREDIT == 0:
            self._transport.send(frame(transport, 1, self._count))
        if self._count == self._last:
            self._done.set()


# --- the caller's process --------------------------------------------------------------------------


async def _call(crossing: Crossing, frames: int) -> float:
    """Send everything; the processor seconds of the frames back to back."""
    transport = crossing.transport
    opened = asyncio.Event()
    credits = 0

    def heard(_: Piece) -> None:
        nonlocal credits
        credits += 1
        opened.set()

    sender = await connect(crossing, heard, LOOPBACK, _credentials())
    per_credit = 1 if transport == "http" else CREDIT
    try:
        async with asyncio.timeout(PATIENCE_S):
            for number in range(1, ONE_BY_ONE + 1):
                while not sender.send(
                    frame(transport, time.monotonic_ns(), number)
                ):  # the first, until they are joined
                    await asyncio.sleep(APART_S)
                await asyncio.sleep(APART_S)
            whole: Sequence[bytes] = [frame(transport, 1, number) for number in range(1, WINDOW + 1)]
            before, sent = time.process_time(), 0
            while sent < frames:
                room = WINDOW - (ONE_BY_ONE + sent - credits * per_credit)
                if room <= 0:
                    opened.clear()
                    await opened.wait()
                    continue
                for _ in range(min(room, frames - sent)):
                    if not sender.send(whole[sent % WINDOW]):
                        break
                    sent += 1
                await asyncio.sleep(0)
            while (ONE_BY_ONE + frames) // per_credit > credits:
                opened.clear()
                await opened.wait()
            return time.process_time() - before
    except TimeoutError:
        raise ComponentError(f"bench of {transport}", f"no answer within {PATIENCE_S:g} s") from None
    finally:
        sender.close()
        await asyncio.sleep(APART_S)
