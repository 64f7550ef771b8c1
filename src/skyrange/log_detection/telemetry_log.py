"""Telemetry logs (`.tlog`) as frames at the ends of the links between a ground station and each of its vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, Literal

from skyrange.codec.mavlink.telemetry_log import LogCounts, read_frames
from skyrange.core.errors import InputError
from skyrange.core.files import open_input
from skyrange.core.ids import Port, endpoint, link_name, vehicle_id
from skyrange.core.time import NS_PER_S, NS_PER_US, Epoch, Time
from skyrange.log_detection.frame_log import FrameLog, SeenFrame
from skyrange.log_detection.log_clock import LogClock
from skyrange.log_detection.mavlink_systems import Head, LinkFinder, SystemCounts, read_head
from skyrange.log_detection.observed_log import LogLink, Remark

Side = Literal["gcs", "companion"]
STATION: Final = "station"
"""The operator of the vehicles of a log that names none."""
EXPECTED: Final = "a telemetry log (.tlog), a capture (.pcapng, .pcap), or the folder of a run"


class Window:
    """The part of a log that is read: seconds from its first frame on, as a `LogClock` counts them."""

    def __init__(self, from_s: float = 0.0, to_s: float | None = None) -> None:
        self._from_ns = round(from_s * NS_PER_S)
        self._to_ns = None if to_s is None else round(to_s * NS_PER_S)
        self.is_whole = from_s <= 0.0 and to_s is None

    def has(self, since_ns: Time) -> bool:
        """Whether it has a frame that is so much later than the first one."""
        return self._from_ns <= since_ns and (self._to_ns is None or since_ns <= self._to_ns)


class WindowClock:
    """The times of the frames in a window, by a clock that begins with the first of them."""

    def __init__(self, window: Window, clock: LogClock) -> None:
        """`clock` is read for the frames in the window."""
        self._window, self._clock = window, clock
        self._whole = LogClock()
        self._first_ns: Time | None = None

    def read(self, unix_ns: int) -> Time | None:
        """The time of the next frame of the log; None if it is outside, or cannot be."""
        if self._window.is_whole:
            return self._clock.read(unix_ns)
        at = self._whole.read(unix_ns)
        if at is None:
            return None
        self._first_ns = at if self._first_ns is None else self._first_ns
        return self._clock.read(unix_ns) if self._window.has(at - self._first_ns) else None


class TelemetryLog(FrameLog):
    """A telemetry log. Its frames say who sent them; whether they came or went follows from that."""

    format = "tlog"

    def __init__(
        self, path: Path, systems: Sequence[int] = (), side: Side = "gcs", window: Window | None = None
    ) -> None:
        """Read a log once for its systems; `systems` are the vehicles to judge, or all.

        Raises `InputError` for a log without a vehicle, or without one of `systems`.
        """
        self.path, self.side = path, side
        self._window = Window() if window is None else window
        counts, systems_seen, clock, last_ns = LogCounts(), SystemCounts(), LogClock(), 0
        for at, head, frame in self._scan(counts, clock):
            systems_seen.add(head, frame)
            last_ns = at
        self._chosen = _choose(path, systems_seen, systems)
        self._every = sorted({*systems_seen.list_vehicles(), *self._chosen})
        self._finder = (systems_seen.stations, systems_seen.numbers_each_link)
        self._left_out = set(self._every) - set(self._chosen)
        station = endpoint(STATION, "gcs")
        names = [vehicle_id(STATION, f"sys{system}") for system in self._chosen]
        links = [LogLink(link_name("gcs", name), station, endpoint(name, "companion")) for name in names]
        ends = [Port(link.a if side == "gcs" else link.b, link.name) for link in links]
        order = sorted(range(len(ends)), key=lambda number: ends[number].link)
        place = {self._chosen[number]: place for place, number in enumerate(order)}
        self._places = [place.get(system, -1) for system in self._every]
        super().__init__(path, links, [ends[number] for number in order], Epoch(clock.start_unix_ns or 0), last_ns)
        self._remarks = [*_list_damage(counts), *clock.remarks(), *self._describe_systems(systems_seen)]

    def read(self) -> Iterator[SeenFrame]:
        """See `FrameLog`."""
        stations, each = self._finder
        finder = LinkFinder(self._every, stations, self._every.index(self._chosen[0]), numbers_each_link=each)
        at_station = self.side == "gcs"
        for at, head, frame in self._scan(LogCounts(), LogClock()):
            received = finder.is_from_station(head) != at_station
            for number in finder.find(head):
                if self._places[number] >= 0:
                    yield SeenFrame(at, self._places[number], received, frame)

    def _scan(self, counts: LogCounts, clock: LogClock) -> Iterator[tuple[Time, Head, bytes]]:
        whole = WindowClock(self._window, clock)
        with open_input(self.path, str(self.path), "file", expected=EXPECTED) as file:
            for time_us, frame in read_frames(file, counts):
                at = whole.read(time_us * NS_PER_US)
                if at is not None:
                    yield at, read_head(frame), frame

    def _describe_systems(self, seen: SystemCounts) -> list[Remark]:
        remarks = [Remark("times", "they are in microseconds; alerts of a run's own record may differ by as much")]
        stations = sorted(system for system in seen.stations - set(self._chosen) if seen.frames[system])
        text = "no frame is from a ground station: the log has one direction"
        if stations:
            text = f"ground stations, by heartbeats or ids: {_list_systems(seen, stations)}; "
            text += "their frames are taken as sent to a vehicle, all others as received from one"
        remarks.append(Remark("systems", text))
        others = sorted(seen.frames.keys() - set(self._chosen) - seen.stations - self._left_out)
        if others:
            text = f"neither vehicles nor ground stations, such as radios: {_list_systems(seen, others)}; their frames "
            remarks.append(Remark("systems", text + f"are taken as received on the link of system {self._chosen[0]}"))
        if self._left_out:
            text = f"vehicles that were not asked for, and are left out: {_list_systems(seen, sorted(self._left_out))}"
            remarks.append(Remark("systems", text))
        if len(self._every) > 1 and stations:
            how = "is found by its number, since each link has numbers of its own"
            if not seen.numbers_each_link:
                how = "is taken as sent to every vehicle"
            remarks.append(Remark("systems", f"a frame of a station that names no vehicle {how}"))
        if not seen.vehicles:
            text = "no HEARTBEAT of an autopilot: every system that is no ground station is taken as a vehicle"
            remarks.append(Remark("systems", text))
        return remarks


def _choose(path: Path, seen: SystemCounts, systems: Sequence[int]) -> list[int]:
    vehicles = seen.list_vehicles()
    if not vehicles:
        raise InputError.one(str(path), "systems", "none", "frames of a vehicle", "No frame of one could be read.")
    for system in systems:
        if system not in seen.frames:
            known = ", ".join(map(str, vehicles))
            raise InputError.one(str(path), "--system", str(system), f"one of {known}")
    return sorted(set(systems)) or vehicles


def _list_systems(seen: SystemCounts, systems: Sequence[int]) -> str:
    return ", ".join(f"system {system} ({seen.frames[system]:,} frames)" for system in systems)


def _list_damage(counts: LogCounts) -> list[Remark]:
    remarks = []
    if counts.bad_bytes:
        text = f"{counts.bad_bytes:,} bytes belong to no good frame, and are left out"
        if counts.bad_checksums:
            text += f"; {counts.bad_checksums:,} frames among them have a wrong checksum"
        remarks.append(Remark("bytes", text))
    if counts.unknown_messages:
        text = f"{counts.unknown_messages:,} frames are of messages that the dialect does not have, and are left out"
        remarks.append(Remark("messages", text))
    if counts.cut_bytes:
        remarks.append(
            Remark("bytes", f"the log ends within a frame: its last {counts.cut_bytes:,} bytes are left out")
        )
    return remarks
