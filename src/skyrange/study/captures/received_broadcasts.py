"""Broadcasts received in a run, byte for byte, by aircraft, attackers and ground receivers.

For aircraft and attackers they are the frames that the oracle sends on `rid_down:*`; for ground receivers they are the
contents of its reports on `oracle:*`. They do not include what a tap altered, delayed or added behind the antenna.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Final, NamedTuple, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.codec.remote_id.link_payload import RidFrame, unpack
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import NS_PER_S
from skyrange.radio import ground_receptions
from skyrange.radio.oracle import ENDPOINT
from skyrange.record.read.run import RunRecord

T = TypeVar("T")

_UP: Final = "rid_up:"
_DOWN: Final = "rid_down:"
_REPORTS: Final = "oracle:"
WINDOW_NS: Final = NS_PER_S
"""Length of the sorting window. An item that is recorded later than this after its time, because a link was that slow,
is yielded out of order."""


class ReceivedBroadcast(NamedTuple):
    """One reception; the frame's header has signal strength, channel, claimed address and end of reception."""

    receiver: str
    frame: RidFrame


def has_radio(record: RunRecord) -> bool:
    """Whether a run has a radio medium."""
    names = (str(link["name"]) for link in record.manifest.get("links") or [])
    return any(name.startswith((_UP, _DOWN, _REPORTS)) for name in names)


def receivers_of(record: RunRecord) -> list[str]:
    """Names of the receivers of a run: the ids of aircraft and attackers that listen, then ground receivers.

    Raises `InputError` for a run without a radio medium.
    """
    if not has_radio(record):
        hint = "Add [radio] to its scenario and run it again."
        raise InputError.one(str(record.path), "links", "no radio", "a run with a radio medium", hint)
    links = [str(link["name"]) for link in record.manifest.get("links") or []]
    grounds = [str(row["id"]) for row in record.manifest.get("receivers") or []]
    return [name.removeprefix(_DOWN) for name in links if name.startswith(_DOWN)] + grounds


def select_receivers(record: RunRecord, names: Iterable[str]) -> list[str]:
    """`names` without duplicates, or all receivers if empty; `InputError` for a name that is not a receiver."""
    known = receivers_of(record)
    wanted = list(dict.fromkeys(names)) or known
    faults = [
        Problem("receiver", name, "a receiver of the run", nearest(name, known)) for name in wanted if name not in known
    ]
    if faults:
        raise InputError(str(record.path), faults)
    return wanted


def received_broadcasts(record: RunRecord, receivers: Sequence[str] = ()) -> Iterator[ReceivedBroadcast]:
    """The receptions of some receivers (all if none are named) in order of their end, read batch by batch.

    Raises `InputError` immediately for an unknown receiver and for a run without a radio medium.
    """
    wanted = frozenset(select_receivers(record, receivers))
    return sort_in_window(_recorded(record, wanted), lambda one: one.frame.header.time_ns)


def _recorded(record: RunRecord, wanted: frozenset[str]) -> Iterator[ReceivedBroadcast]:
    """The receptions in the order recorded."""
    downs = [_DOWN + name for name in wanted]
    grounds = {str(row["id"]) for row in record.manifest.get("receivers") or []} & wanted
    for table in record.tables.frames_with_payloads(["link", "sender"]):
        link = table.column("link")
        keep = pc.is_in(link, value_set=pa.array(downs, pa.string()))
        if grounds:
            keep = pc.or_(keep, pc.starts_with(link, _REPORTS))
        rows = table.filter(pc.and_(keep, pc.equal(table.column("sender"), ENDPOINT)))
        for name, payload in zip(rows.column("link").to_pylist(), rows.column("payload").to_pylist(), strict=True):
            if name.startswith(_DOWN):
                yield ReceivedBroadcast(name.removeprefix(_DOWN), unpack(payload))
                continue
            for reception in ground_receptions.decode(payload).body:
                if reception.receiver in grounds:
                    yield ReceivedBroadcast(reception.receiver, reception.frame())


def sort_in_window(items: Iterable[T], at_ns: Callable[[T], int]) -> Iterator[T]:
    """Items sorted by time within a window of `WINDOW_NS`; items of the same time keep their order."""
    waiting: list[tuple[int, int, T]] = []
    newest = 0
    for number, item in enumerate(items):
        at = at_ns(item)
        heappush(waiting, (at, number, item))
        newest = max(newest, at)
        while waiting[0][0] < newest - WINDOW_NS:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]
