"""How does a run get into Wireshark? Its broadcasts and its MAVLink as captures, written as they are read.

`remote_id` writes what receivers heard as the frames that were in the air, `mavlink` what was delivered on the `gcs`
links as UDP. Times are those of the scenario's `start_utc` plus simulated time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow.compute as pc

from skyrange.codec import datagrams, pcapng, rid_capture
from skyrange.codec.datagrams import Socket
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.ids import endpoint, link_name
from skyrange.record.run import RunRecord
from skyrange.study.overheard import chosen, in_order, overheard
from skyrange.study.series import operators, vehicles

REMOTE_ID: Final = "remote_id.pcapng"
MAVLINK: Final = "mavlink.pcapng"

STATION_PORT: Final = 14550
"""What ground stations listen on, and where Wireshark's MAVLink plugin (made by pymavlink) looks for MAVLink."""
AIRCRAFT_PORT: Final = 14555
_AIRCRAFT: Final = 10 << 24
"""10.0.0.1, 10.0.0.2 …: the aircraft in the manifest's order."""
_STATIONS: Final = 10 << 24 | 255 << 16
"""10.255.0.1 …: the ground stations."""


class Capture(NamedTuple):
    """A capture that was written: how many packets, and how many of each receiver or link."""

    path: Path
    packets: int
    by: Mapping[str, int]


def remote_id(record: RunRecord, path: Path | None = None, receivers: Sequence[str] = ()) -> Capture:
    """Write all receptions of some receivers (default: of all), a packet each, to `path` (in the run's folder).

    Each receiver has two interfaces, `NAME wifi` and `NAME ble`, with radiotap and BLE radio headers; each packet is
    commented with who received it. `InputError` for a run without a radio medium and for an unknown receiver,
    `OSError` where the file cannot be written, with no half a file left behind.
    """
    names = chosen(record, receivers)
    start = _start_utc_ns(record)
    first = {name: place * len(rid_capture.INTERFACES) for place, name in enumerate(names)}
    interfaces = [(f"{name} {kind}", link_type) for name in names for kind, link_type in rid_capture.INTERFACES]

    def packets() -> Iterator[tuple[str, bytes]]:
        for receiver, frame in overheard(record, names):
            yield receiver, rid_capture.packet(frame, start, f"received by {receiver}", first[receiver])

    return _write(path or record.path / REMOTE_ID, pcapng.head(interfaces), packets(), names)


def mavlink(record: RunRecord, path: Path | None = None) -> Capture:
    """Write every frame that was delivered on a `gcs` link, when it was, to `path` (default: in the run's folder).

    Each is a UDP datagram between made-up addresses, which the file names; each packet is commented with its link and,
    where that is not who it claims to be from, with who truly sent it. `OSError` as for `remote_id`.
    """
    start = _start_utc_ns(record)
    stations = {
        endpoint(name, "gcs"): Socket(_STATIONS + place, STATION_PORT)
        for place, name in enumerate(operators(record), start=1)
    }
    aircraft = {
        link_name("gcs", vehicle.id): Socket(_AIRCRAFT + place, AIRCRAFT_PORT)
        for place, vehicle in enumerate(vehicles(record), start=1)
    }
    ends = {link_name("gcs", vehicle.id): stations[endpoint(vehicle.operator, "gcs")] for vehicle in vehicles(record)}
    called = {socket.address: name for name, socket in stations.items()}
    called |= {socket.address: link.removeprefix("gcs:") for link, socket in aircraft.items()}

    def packets() -> Iterator[tuple[str, bytes]]:
        for frame in in_order(_delivered(record), lambda one: one.at_ns):
            station, vehicle = ends[frame.link], aircraft[frame.link]
            path = (station, vehicle) if frame.direction == "fwd" else (vehicle, station)
            said = frame.link if frame.sender == frame.src else f"{frame.link}, sent by {frame.sender}"
            yield frame.link, pcapng.packet(0, start + frame.at_ns, datagrams.udp(*path, frame.payload), said)

    head = pcapng.head([("gcs", pcapng.IPV4)]) + pcapng.names(called)
    return _write(path or record.path / MAVLINK, head, packets(), list(aircraft))


class _Delivered(NamedTuple):
    link: str
    direction: str
    sender: str
    src: str
    at_ns: int
    payload: bytes


def _delivered(record: RunRecord) -> Iterator[_Delivered]:
    """What arrived on `gcs` links and fits a datagram, in the order of the record."""
    columns = ["link", "direction", "sender", "src", "arrived_ns"]
    for table in record.tables.frames_with_payloads(columns):
        keep = pc.and_(pc.starts_with(table.column("link"), "gcs:"), pc.is_valid(table.column("arrived_ns")))
        rows = table.filter(pc.and_(keep, pc.less_equal(pc.binary_length(table.column("payload")), datagrams.MOST)))
        yield from map(_Delivered, *(rows.column(name).to_pylist() for name in (*columns, "payload")))


def _start_utc_ns(record: RunRecord) -> int:
    found = record.manifest.get("start_unix_ns")
    if not isinstance(found, int) or isinstance(found, bool) or found < 0:
        raise InputError.one(str(record.path), "manifest.json: start_unix_ns", repr(found), "ns since 1970, 0 or later")
    return found


def _write(path: Path, head: bytes, packets: Iterator[tuple[str, bytes]], keys: Sequence[str]) -> Capture:
    """Write packets to `path`, and count those of each of `keys`."""
    counts = Counter(dict.fromkeys(keys, 0))
    with atomic_write(path) as file:
        file.write(head)
        for key, packet in packets:
            counts[key] += 1
            file.write(packet)
    return Capture(path, counts.total(), dict(counts))
