"""Packet captures of a run for Wireshark, of MAVLink and of Remote ID, and the broadcasts that were received.

`remote_id` writes the broadcasts that receivers decoded, in their Wi-Fi or Bluetooth framing. `mavlink` writes the
frames that were delivered on `gcs` links as UDP datagrams. Times are the scenario's `start_utc` plus simulated time.
Memory is bounded.

Broadcasts are what the radios decoded; what a tap altered, delayed or added behind the antenna is not among them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from heapq import heappop, heappush
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import pyarrow.compute as pc

from skyrange.codec import capture
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, unpack
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import atomic_write
from skyrange.core.ids import FrameId, endpoint, link_name
from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import operators, start_utc_ns, vehicles
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
    return sort_in_window(_recorded(record, wanted), lambda broadcast: broadcast.frame.header.time_ns)


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


REMOTE_ID: Final = "remote_id.pcapng"
MAVLINK: Final = "mavlink.pcapng"

STATION_PORT: Final = 14550
"""The port of ground stations, at which Wireshark's MAVLink plugin (generated by pymavlink) expects MAVLink."""
AIRCRAFT_PORT: Final = 14555
_AIRCRAFT: Final = 10 << 24
"""10.0.0.1, 10.0.0.2 …: addresses of the aircraft, in the manifest's order."""
_STATIONS: Final = 10 << 24 | 255 << 16
"""10.255.0.1 …: addresses of the ground stations."""


class Capture(NamedTuple):
    """A capture that was written: its number of packets, in all and by receiver or link."""

    path: Path
    packets: int
    by: Mapping[str, int]


def remote_id(record: RunRecord, path: Path | None = None, receivers: Sequence[str] = ()) -> Capture:
    """Write the receptions of some receivers (default: all), one packet each, to `path` (default: in the run's folder).

    Each receiver has two interfaces, `NAME wifi` and `NAME ble`, with radiotap and BLE radio headers. A comment on each
    packet names its receiver. Raises `InputError` for a run without a radio medium and for an unknown receiver, and
    `OSError` if the file cannot be written; no incomplete file is left behind.
    """
    names = select_receivers(record, receivers)
    start = start_utc_ns(record)
    first = {name: place * len(capture.INTERFACES) for place, name in enumerate(names)}
    interfaces = [(f"{name} {kind}", link_type) for name in names for kind, link_type in capture.INTERFACES]

    def packets() -> Iterator[tuple[str, bytes]]:
        for broadcast in received_broadcasts(record, names):
            comment = f"received by {broadcast.receiver}"
            yield (
                broadcast.receiver,
                capture.reception_block(broadcast.frame, start, comment, first[broadcast.receiver]),
            )

    return _write(path or record.path / REMOTE_ID, capture.file_header(interfaces), packets(), names)


def mavlink(record: RunRecord, path: Path | None = None) -> Capture:
    """Write every frame delivered on a `gcs` link, at its time of delivery, to `path` (default: in the run's folder).

    Each frame is a UDP datagram between artificial addresses, for which the file has a name table. A comment on each
    packet states its link and, if the claimed source is false, the true sender. Raises `OSError` as `remote_id` does.
    """
    start = start_utc_ns(record)
    stations = {
        endpoint(name, "gcs"): capture.SocketAddress(_STATIONS + place, STATION_PORT)
        for place, name in enumerate(operators(record), start=1)
    }
    aircraft = {
        link_name("gcs", vehicle.id): capture.SocketAddress(_AIRCRAFT + place, AIRCRAFT_PORT)
        for place, vehicle in enumerate(vehicles(record), start=1)
    }
    ends = {link_name("gcs", vehicle.id): stations[endpoint(vehicle.operator, "gcs")] for vehicle in vehicles(record)}
    called = {socket.address: name for name, socket in stations.items()}
    called |= {socket.address: link.removeprefix("gcs:") for link, socket in aircraft.items()}

    def packets() -> Iterator[tuple[str, bytes]]:
        for frame in sort_in_window(_delivered(record), lambda delivered: delivered.at_ns):
            if frame.link not in aircraft:
                expected = f"a link of {', '.join(list(aircraft)[:10]) or 'no aircraft'}, as in the manifest"
                raise InputError.one(str(record.path), "frames: link", ascii(frame.link)[:80], expected)
            station, vehicle = ends[frame.link], aircraft[frame.link]
            path = (station, vehicle) if frame.direction == "fwd" else (vehicle, station)
            comment = frame.link if frame.sender == frame.src else f"{frame.link}, sent by {frame.sender}"
            yield (
                frame.link,
                capture.packet_block(0, start + frame.at_ns, capture.encode_datagram(*path, frame.payload), comment),
            )

    head = capture.file_header([("gcs", capture.IPV4)]) + capture.name_block(called)
    return _write(path or record.path / MAVLINK, head, packets(), list(aircraft))


class _Delivered(NamedTuple):
    link: str
    direction: str
    sender: str
    src: str
    at_ns: int
    payload: bytes


def _delivered(record: RunRecord) -> Iterator[_Delivered]:
    """Frames delivered on `gcs` links that fit into a datagram, in the order recorded."""
    columns = ["link", "direction", "sender", "src", "arrived_ns"]
    for table in record.tables.frames_with_payloads(columns):
        keep = pc.and_(pc.starts_with(table.column("link"), "gcs:"), pc.is_valid(table.column("arrived_ns")))
        rows = table.filter(
            pc.and_(keep, pc.less_equal(pc.binary_length(table.column("payload")), capture.MAX_PAYLOAD))
        )
        yield from map(_Delivered, *(rows.column(name).to_pylist() for name in (*columns, "payload")))


def _write(path: Path, head: bytes, packets: Iterator[tuple[str, bytes]], keys: Sequence[str]) -> Capture:
    """Write packets to `path`, and count those of each of `keys`."""
    counts = Counter(dict.fromkeys(keys, 0))
    with atomic_write(path) as file:
        file.write(head)
        for key, packet in packets:
            counts[key] += 1
            file.write(packet)
    return Capture(path, counts.total(), dict(counts))
