"""Broadcasts received in a run, by aircraft, attackers and ground receivers, each with the frame that was transmitted.

They are what the radios decoded; what a tap altered, delayed or added behind the antenna is not among them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from typing import Final, NamedTuple, TypeVar

from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, unpack
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.record.read.observations import RADIO_LINK, read_decoded_receptions
from skyrange.record.read.run import RunRecord

T = TypeVar("T")

_DOWN: Final = "rid_down:"
_REPORTS: Final = "oracle:"
WINDOW_NS: Final = NS_PER_S
"""Length of the sorting window. An item that is recorded later than this after its time, because a link was that slow,
is yielded out of order."""
_BATCH_ROWS: Final = 1_024


class ReceivedBroadcast(NamedTuple):
    """One reception. `receiver` and `frame` are what the receiver knows; the rest is truth, to judge a detector by."""

    receiver: str
    frame: RidFrame
    """Body as transmitted; header with signal strength, channel, claimed address and end of reception."""
    frame_id: str
    """Id of the frame that was transmitted, as in `frames`, `labels` and `observations`."""
    radio: str
    """The radio that transmitted it: a vehicle or an attack's radio."""
    sender: str
    """The endpoint, or the tap, that truly sent the frame to the radio."""
    serial: int
    """That sender's serial number of the frame."""


def has_radio(record: RunRecord) -> bool:
    """Whether a run has a radio medium."""
    names = (str(link["name"]) for link in record.manifest.get("links") or [])
    return any(name.startswith((RADIO_LINK, _DOWN, _REPORTS)) for name in names)


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
    problems = [
        Problem("receiver", name, "a receiver of the run", nearest(name, known)) for name in wanted if name not in known
    ]
    if problems:
        raise InputError(str(record.path), problems)
    return wanted


def received_broadcasts(record: RunRecord, receivers: Sequence[str] = ()) -> Iterator[ReceivedBroadcast]:
    """The receptions of some receivers (all if none are named) in order of their end, read batch by batch.

    A reception whose frame the record lacks, as after a crash, is left out. Raises `InputError` immediately for an
    unknown receiver and for a run without a radio medium.
    """
    wanted = select_receivers(record, receivers)
    return sort_in_window(_recorded(record, wanted), lambda one: one.frame.header.time_ns)


def _recorded(record: RunRecord, wanted: Sequence[str]) -> Iterator[ReceivedBroadcast]:
    """The receptions in the order recorded."""
    names = ("time_ns", "receiver", "channel", "rssi_dbm", "link", "direction", "sender", "serial")
    for received in read_decoded_receptions(record.tables, wanted, _BATCH_ROWS):
        sent = [unpack(payload) for payload in received.payloads]
        columns = [received.rows.column(name).to_pylist() for name in names]
        for place, *row in zip(received.place.tolist(), *columns, strict=True):
            if place < 0:
                continue
            time_ns, receiver, channel, rssi_dbm, link, direction, sender, serial = row
            rssi_cdbm = min(max(round(rssi_dbm * 100.0), NO_RSSI + 1), 32_767)
            header = sent[place].header._replace(channel=channel, rssi_cdbm=rssi_cdbm, time_ns=time_ns)
            frame_id = str(FrameId(link, direction, sender, serial))
            radio = link.removeprefix(RADIO_LINK)
            yield ReceivedBroadcast(receiver, RidFrame(header, sent[place].body), frame_id, radio, sender, serial)


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
