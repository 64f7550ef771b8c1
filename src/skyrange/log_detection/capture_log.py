"""Captures (`.pcapng`, `.pcap`) as frames at link ends: MAVLink in UDP and TCP, and Remote ID as receivers heard it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.capture_reading import CaptureCounts, Packet, read_packets
from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.internet_packets import Address, Segment, find_segment, has_internet
from skyrange.codec.remote_id.captured_broadcasts import has_broadcasts, read_broadcast
from skyrange.codec.remote_id.link_payload import RidFrame, pack
from skyrange.contracts.frames import Payloads
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.files import open_input
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import Epoch, Time
from skyrange.log_detection.capture_flows import Flow, FlowReader, FlowSurvey, Pair
from skyrange.log_detection.frame_log import FrameLog, SeenFrame
from skyrange.log_detection.log_clock import LogClock
from skyrange.log_detection.mavlink_systems import LinkFinder, SystemCounts, read_head
from skyrange.log_detection.observed_log import LogLink, Remark
from skyrange.log_detection.telemetry_log import EXPECTED, Side, Window, WindowClock

_KINDS: Final = (" wifi", " ble")
"""Ends of the names of interfaces, of which each receiver has two in an exported capture."""
_MOST_RECEIVERS: Final = 1024
_MOST_LINKS: Final = 1024
_MOST_BODIES: Final = 1001
"""Broadcasts by whose claims the origin is chosen."""
ORACLE: Final = "oracle"


@dataclass(slots=True)
class _Survey:
    """What one pass over a capture finds."""

    packets: CaptureCounts = field(default_factory=CaptureCounts)
    clock: LogClock = field(default_factory=LogClock)
    flows: FlowSurvey = field(default_factory=FlowSurvey)
    reader: FlowReader = field(default_factory=FlowReader)
    receivers: Counter[str] = field(default_factory=Counter)
    bodies: list[bytes] = field(default_factory=list)
    last_ns: Time = 0
    segments: int = 0
    radio_packets: int = 0
    """Packets of radio interfaces that have no Remote ID."""
    link_types: Counter[int] = field(default_factory=Counter)
    """Packets of link types that are not read."""


class _Link(NamedTuple):
    """What the frames of a pair of sockets become."""

    station: Address
    places: Sequence[int]
    """Numbers of its links' ends, one for each of its vehicles; -1 for one that was not asked for."""
    vehicles: Sequence[int]
    """Their system ids; empty for one link of all frames."""
    numbers_each_link: bool
    stations: frozenset[int]


class CaptureLog(FrameLog):
    """A capture at one place of a network, or of receivers of Remote ID, or of both."""

    format = "capture"

    def __init__(
        self, path: Path, systems: Sequence[int] = (), side: Side = "gcs", window: Window | None = None
    ) -> None:
        """Read a capture once for what is in it; `systems` are the vehicles to judge, or all.

        Raises `InputError` for a capture with neither MAVLink nor Remote ID.
        """
        self.path, self.side = path, side
        self._window = Window() if window is None else window
        self._systems = set(systems)
        survey = self._survey()
        if not survey.flows.directions and not survey.receivers:
            raise InputError.one(
                str(path), "packets", _say_packets(survey), "some of MAVLink over UDP or TCP, or of Remote ID"
            )
        self._links: dict[Pair, _Link] = {}
        self._receivers: dict[str, int] = {}
        links, ends, remarks = self._name_links(survey)
        order = sorted(range(len(ends)), key=lambda number: (ends[number].link, ends[number].endpoint))
        moved = {number: place for place, number in enumerate(order)}
        self._links = {
            pair: link._replace(places=[moved.get(number, -1) for number in link.places])
            for pair, link in self._links.items()
        }
        self._receivers = {name: moved[number] for name, number in self._receivers.items()}
        epoch = Epoch(survey.clock.start_unix_ns or 0)
        super().__init__(path, links, [ends[number] for number in order], epoch, survey.last_ns)
        self.origin = _choose_origin(survey.bodies)
        self._remarks = [*_list_damage(survey), *survey.clock.remarks(), *remarks]

    def _survey(self) -> _Survey:
        survey = _Survey()
        for at, packet, segment, broadcast in self._packets(survey):
            survey.last_ns = at
            if broadcast is not None:
                name = _receiver(packet)
                if name in survey.receivers or len(survey.receivers) < _MOST_RECEIVERS:
                    survey.receivers[name] += 1
                if len(survey.bodies) < _MOST_BODIES:
                    survey.bodies.append(broadcast.body)
            elif segment is not None:
                flow = Flow(segment.is_tcp, segment.source, segment.target)
                for data, is_frame in survey.reader.read(segment):
                    if is_frame:
                        survey.flows.add(flow, data)
        return survey

    def _packets(self, survey: _Survey) -> Iterator[tuple[Time, Packet, Segment | None, RidFrame | None]]:
        """The packets with a UDP datagram, a TCP segment or a broadcast, in order of time."""
        whole = WindowClock(self._window, survey.clock)
        with open_input(self.path, str(self.path), "file", expected=EXPECTED) as file:
            for packet in read_packets(file, survey.packets):
                kind = packet.interface.link_type
                segment = broadcast = None
                if has_internet(kind):
                    segment = find_segment(kind, packet.data)
                    survey.segments += segment is not None
                elif has_broadcasts(kind):
                    try:
                        broadcast = read_broadcast(kind, packet.data)
                    except DecodeError:
                        survey.radio_packets += 1
                else:
                    survey.link_types[kind] += 1
                if segment is None and broadcast is None:
                    continue
                at = whole.read(packet.time_ns)
                if at is not None:
                    yield at, packet, segment, broadcast

    def read(self) -> Iterator[SeenFrame]:
        """See `FrameLog`."""
        survey = _Survey()
        finders = {
            pair: LinkFinder(
                link.vehicles,
                link.stations,
                next((number for number, place in enumerate(link.places) if place >= 0), 0),
                numbers_each_link=link.numbers_each_link,
            )
            for pair, link in self._links.items()
        }
        at_station = self.side == "gcs"
        for at, packet, segment, broadcast in self._packets(survey):
            if broadcast is not None:
                place = self._receivers.get(_receiver(packet))
                if place is not None:
                    payload = pack(broadcast.header._replace(time_ns=at), broadcast.body)
                    yield SeenFrame(at, place, received=True, payload=payload)
                continue
            if segment is None:
                continue
            pair = Flow(segment.is_tcp, segment.source, segment.target).pair
            link = self._links.get(pair)
            if link is None:
                continue
            received = (segment.source == link.station) != at_station
            for data, is_frame in survey.reader.read(segment):
                for number in self._find_numbers(link, finders[pair], data, is_frame=is_frame):
                    if link.places[number] >= 0:
                        yield SeenFrame(at, link.places[number], received, data)

    def _find_numbers(self, link: _Link, finder: LinkFinder, data: bytes, *, is_frame: bool) -> Sequence[int]:
        if not link.vehicles:
            return (0,)
        return finder.find(read_head(data)) if is_frame else ()

    def _name_links(self, survey: _Survey) -> tuple[list[LogLink], list[Port], list[Remark]]:
        """The links and ends of all pairs of sockets and receivers, and what was guessed of them."""
        names = _Names(survey.packets.names)
        links: list[LogLink] = []
        remarks: list[Remark] = []
        for pair in survey.flows.pairs():
            station, why = survey.flows.find_station(pair)
            vehicle = pair.b if station == pair.a else pair.a
            there, back = survey.flows.counts(pair)
            up, down = (there, back) if station == pair.a else (back, there)
            systems = self._choose_systems(down)
            if systems is None:
                remarks.append(Remark("systems", f"{vehicle}: none of those asked for; its frames are left out"))
                continue
            if len(links) + max(len(systems), 1) > _MOST_LINKS:
                remarks.append(Remark("flows", f"{vehicle}: left out, because the capture has too many vehicles"))
                continue
            owners = names.owners(station, vehicle, systems)
            first = len(links)
            links += [LogLink(link_name("gcs", owner), names.station(station), endpoint(owner, "companion"))
                      for owner in owners]  # fmt: skip
            wanted = dict(zip(systems, range(first, len(links)), strict=False))
            every = sorted(down.vehicles) if systems else []
            places = [wanted.get(system, -1) for system in every] or [first]
            stations = frozenset(up.frames.keys() - down.vehicles)
            self._links[pair] = _Link(station, places, every, up.numbers_each_link, stations)
            text = f"{station} is taken as the ground station of {', '.join(owners)}, by {why}"
            remarks.append(Remark("flows", text))
        if self._links:
            at = "the ground station's end" if self.side == "gcs" else "the aircraft's end"
            text = (
                f"the capture is taken as made at {at}, with the times of that end; one that `skyrange export` wrote "
            )
            text += "has each frame at its time of arrival, and none that was lost"
            remarks.append(Remark("flows", text))
        ends = [Port(link.a if self.side == "gcs" else link.b, link.name) for link in links]
        for name in sorted(survey.receivers):
            self._receivers[name] = len(ends)
            link = LogLink(link_name("rid_down", name), ORACLE, endpoint(name, "companion"))
            links.append(link)
            ends.append(Port(link.b, link.name))
        if survey.receivers:
            count = f"{survey.receivers.total():,} broadcasts of {len(survey.receivers)} receivers"
            text = f"{count}; strengths are in whole dB, and a broadcast is taken as known when its reception ended"
            remarks.append(Remark("remote id", text))
        return links, ends, remarks

    def _choose_systems(self, down: SystemCounts) -> list[int] | None:
        """The vehicles of a pair that have links of their own; none for one link of all; None if none is wanted."""
        vehicles = sorted(down.vehicles)
        if self._systems:
            wanted = [system for system in (vehicles or down.frames) if system in self._systems]
            if not wanted:
                return None
            return wanted if len(vehicles) > 1 else []
        return vehicles if len(vehicles) > 1 else []


class _Names:
    """Names of the ends of links, each once."""

    def __init__(self, by_address: dict[bytes, str]) -> None:
        self._by_address = by_address
        self._used: set[str] = set()

    def station(self, address: Address) -> str:
        name = self._by_address.get(address.host, "")
        return name if name.endswith(".gcs") else endpoint(name or str(address), "gcs")

    def owners(self, station: Address, vehicle: Address, systems: Sequence[int]) -> list[str]:
        """The vehicles of a pair: as the capture names them, else by their addresses and system ids."""
        named = self._by_address.get(vehicle.host, "")
        base = named or f"{self.station(station).removesuffix('.gcs')}/{vehicle}"
        if base in self._used:
            base = f"{base}-{station}"
        self._used.add(base)
        return [f"{base}-sys{system}" for system in systems] or [base]


def _receiver(packet: Packet) -> str:
    name = packet.interface.name
    for kind in _KINDS:
        name = name.removesuffix(kind)
    return name or "receiver"


def _choose_origin(bodies: Sequence[bytes]) -> Origin:
    """The median of the positions that broadcasts claim, so that few false ones do not move it far."""
    located = decode_locations(Payloads.of(bodies))
    good = located.has_location & np.isfinite(located.lat_deg) & np.isfinite(located.lon_deg)
    if not good.any():
        return Origin(0.0, 0.0)
    return Origin(median(located.lat_deg[good].tolist()), median(located.lon_deg[good].tolist()))


def _say_packets(survey: _Survey) -> str:
    return f"{survey.packets.packets:,} packets, {survey.segments:,} of UDP or TCP"


def _list_damage(survey: _Survey) -> list[Remark]:
    counts, remarks = survey.packets, []
    for count, text in (
        (counts.bad_bytes, "bytes belong to no block or record that can be, and are left out"),
        (counts.cut_bytes, "bytes at the end are the begin of a block, and are left out"),
    ):
        if count:
            remarks.append(Remark("bytes", f"{count:,} {text}"))
    for count, text in (
        (counts.untimed_packets, "packets have no time or no interface, and are left out"),
        (counts.cut_packets, "packets were captured with their first bytes only"),
        (sum(survey.link_types.values()), f"packets have link types that are not read: {_list(survey.link_types)}"),
        (survey.radio_packets, "packets of radio interfaces have no Remote ID"),
        (survey.flows.left_out, "frames are of more than 1,024 pairs of sockets, and are left out"),
    ):
        if count:
            remarks.append(Remark("packets", f"{count:,} {text}"))
    flows = survey.reader.counts
    for count, text in (
        (flows.garbage_bytes, "bytes of UDP and TCP payloads belong to no MAVLink frame"),
        (flows.lost_segments, "gaps of TCP streams were jumped over"),
        (flows.flows_left_out, "segments are of more than 2,048 TCP streams, and are left out"),
    ):
        if count:
            remarks.append(Remark("flows", f"{count:,} {text}"))
    return remarks


def _list(kinds: Counter[int]) -> str:
    return ", ".join(map(str, sorted(kinds)[:10]))
