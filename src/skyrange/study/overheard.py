"""What came in at each receiver of a run, byte for byte? Receptions of aircraft, attackers and ground receivers.

Of aircraft and attackers they are the oracle's own frames on `rid_down:*`, of ground receivers what stands in its
reports on `oracle:*`. What a tap altered, held back or added behind the antenna is not among them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Final, NamedTuple, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.codec.rid_link import RidFrame, unpack
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.time import NS_PER_S
from skyrange.radio import ground
from skyrange.radio.oracle import ENDPOINT
from skyrange.record.run import RunRecord

T = TypeVar("T")

_UP: Final = "rid_up:"
_DOWN: Final = "rid_down:"
_REPORTS: Final = "oracle:"
HELD_NS: Final = NS_PER_S
"""Things are put in order over so much of the run: what the record has later than that after the fact (a link was that
slow) comes out of its turn."""


class Overheard(NamedTuple):
    """One reception: its header has the signal strength, the channel, the claimed address and the end of reception."""

    receiver: str
    frame: RidFrame


def has_radio(record: RunRecord) -> bool:
    """Whether anything could be broadcast in a run."""
    names = (str(link["name"]) for link in record.manifest.get("links") or [])
    return any(name.startswith((_UP, _DOWN, _REPORTS)) for name in names)


def receivers_of(record: RunRecord) -> list[str]:
    """Who could receive: aircraft and attackers that listen by their ids, then ground receivers.

    `InputError` for a run without a radio medium.
    """
    if not has_radio(record):
        hint = "Add [radio] to its scenario and fly it again."
        raise InputError.one(str(record.path), "links", "no radio", "a run with a radio medium", hint)
    links = [str(link["name"]) for link in record.manifest.get("links") or []]
    grounds = [str(row["id"]) for row in record.manifest.get("receivers") or []]
    return [name.removeprefix(_DOWN) for name in links if name.startswith(_DOWN)] + grounds


def chosen(record: RunRecord, names: Iterable[str]) -> list[str]:
    """`names` once each, all receivers for none; `InputError` for one that is no receiver of the run."""
    known = receivers_of(record)
    wanted = list(dict.fromkeys(names)) or known
    faults = [
        Fault("receiver", name, "a receiver of the run", nearest(name, known)) for name in wanted if name not in known
    ]
    if faults:
        raise InputError(str(record.path), faults)
    return wanted


def overheard(record: RunRecord, receivers: Sequence[str] = ()) -> Iterator[Overheard]:
    """All receptions of some receivers (of all: none named) by the end of reception, read batch by batch.

    `InputError` for an unknown receiver and for a run without a radio medium, at once.
    """
    wanted = frozenset(chosen(record, receivers))
    return in_order(_recorded(record, wanted), lambda one: one.frame.header.time_ns)


def _recorded(record: RunRecord, wanted: frozenset[str]) -> Iterator[Overheard]:
    """In the order of the record."""
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
                yield Overheard(name.removeprefix(_DOWN), unpack(payload))
                continue
            for reception in ground.decode(payload).body:
                if reception.receiver in grounds:
                    yield Overheard(reception.receiver, reception.frame())


def in_order(items: Iterable[T], at_ns: Callable[[T], int]) -> Iterator[T]:
    """By time, those of one time in the order given; holds what lies within `HELD_NS`."""
    waiting: list[tuple[int, int, T]] = []
    newest = 0
    for number, item in enumerate(items):
        at = at_ns(item)
        heappush(waiting, (at, number, item))
        newest = max(newest, at)
        while waiting[0][0] < newest - HELD_NS:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]
