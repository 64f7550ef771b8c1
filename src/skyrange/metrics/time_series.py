"""Tracks and events of a run as arrays: true positions, believed positions, events, decisions and hostile acts.

Figures and reports read a run through this module. Truth is the state of the world. Belief is what an operator's own
ground station received about its own aircraft, at the time of reception. The two are never mixed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.notes import parse_details

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

POSITION_MESSAGE = "GLOBAL_POSITION_INT"
"""The MAVLink message (common dialect, id 33) from which believed positions are read."""


class Record(Protocol):
    """The interface of a run's record that figures and measures need; `skyrange.record.RunRecord` implements it."""

    @property
    def path(self) -> Path:
        """The run's folder."""
        ...

    @property
    def manifest(self) -> Mapping[str, Any]:
        """The run's `manifest.json`."""
        ...

    @property
    def city(self) -> Sequence[Mapping[str, Any]]:
        """Buildings: `height_m` and `rings` of (east, north) metres, the first ring the outline, others holes."""
        ...

    def table(self, name: str, columns: Sequence[str] | None = None) -> Any:
        """A `pyarrow.Table` with all columns or with `columns`; without rows if the run recorded none."""
        ...

    def telemetry(self, message: str, columns: Sequence[str] | None = None) -> Any:
        """A `pyarrow.Table` of a MAVLink message that ground stations received; without rows if none did."""
        ...

    def batches(self, name: str, columns: Sequence[str] | None = None) -> Iterator[Any]:
        """The same rows as `pyarrow.RecordBatch`es, for tables that are larger than memory."""
        ...


@dataclass(frozen=True, slots=True)
class Vehicle:
    """One aircraft as the manifest declares it; `home_enu_m` is `None` if it is not recorded."""

    id: str
    operator: str
    autopilot: str
    airframe: str
    plan: str
    home_enu_m: tuple[float, float, float] | None

    @property
    def short(self) -> str:
        """The id without its operator: `b1` for `blue/b1`."""
        return self.id.split("/", 1)[-1]


@dataclass(frozen=True, slots=True)
class Track:
    """Positions over time, one row per sample, in ascending order of time.

    `time_ns` (n,) simulated time, `enu_m` (n, 3) position from the origin, `speed_mps` (n,) length of the
    velocity vector.
    """

    time_ns: Ints
    enu_m: Floats
    speed_mps: Floats

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    @property
    def distance_m(self) -> float:
        """Length in metres of the path through the samples."""
        return float(np.sqrt((np.diff(self.enu_m, axis=0) ** 2).sum(axis=1)).sum()) if len(self) > 1 else 0.0

    def until(self, time_ns: int) -> Track:
        """The samples up to and including `time_ns`."""
        count = int(np.searchsorted(self.time_ns, time_ns, side="right"))
        return Track(self.time_ns[:count], self.enu_m[:count], self.speed_mps[:count])

    def since(self, time_ns: int) -> Track:
        """The samples from `time_ns` on."""
        count = int(np.searchsorted(self.time_ns, time_ns, side="left"))
        return Track(self.time_ns[count:], self.enu_m[count:], self.speed_mps[count:])

    def take(self, rows: Ints) -> Track:
        """The samples of some rows, in their order."""
        return Track(self.time_ns[rows], self.enu_m[rows], self.speed_mps[rows])

    def at(self, time_ns: Ints) -> Floats:
        """(m, 3) positions at `time_ns` (m,), linear between samples, constant before the first and after the last
        sample.
        """
        return np.stack([np.interp(time_ns, self.time_ns, self.enu_m[:, axis]) for axis in range(3)], axis=1)


EMPTY_TRACK = Track(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0))


def operators(record: Record) -> dict[str, str]:
    """Operator ids in the manifest's order, each with its declared colour ("" for none)."""
    colours = {str(row["id"]): str(row.get("color") or "") for row in record.manifest.get("operators") or []}
    for vehicle in vehicles(record):
        colours.setdefault(vehicle.operator, "")
    return colours


def vehicles(record: Record) -> list[Vehicle]:
    """The aircraft in the manifest's order, with range-wide ids (`operator/vehicle`)."""
    rows = []
    for row in record.manifest.get("vehicles") or []:
        operator = str(row.get("operator") or str(row["id"]).split("/", 1)[0])
        home = row.get("home_enu_m")
        rows.append(
            Vehicle(
                id=str(row["id"]) if "/" in str(row["id"]) else f"{operator}/{row['id']}",
                operator=operator,
                autopilot=_text(row.get("autopilot")),
                airframe=_text(row.get("airframe")),
                plan=_text(row.get("plan")),
                home_enu_m=(float(home[0]), float(home[1]), float(home[2]) if len(home) > 2 else 0.0) if home else None,
            )
        )
    return rows


def start_utc_ns(record: Record) -> int:
    """UTC of a run's time 0, ns since 1970; `InputError` if its manifest has none, or one before 1970."""
    unix_ns = start_unix_ns_of(record.manifest)
    if unix_ns is None or not 0 <= unix_ns < NEVER:
        value = repr(record.manifest.get("start_unix_ns"))
        raise InputError.one(str(record.path), "manifest.json: start_unix_ns", value, "ns since 1970, 0 or later")
    return unix_ns


def truth_tracks(record: Record) -> dict[str, Track]:
    """The true track of each aircraft by vehicle id; empty for an aircraft without truth rows."""
    names = ("east_m", "north_m", "up_m", "vel_east_mps", "vel_north_mps", "vel_up_mps")
    parts: dict[str, list[tuple[Ints, Floats]]] = {}
    for batch in record.batches("truth", ["time_ns", "vehicle", *names]):
        append_rows(parts, batch, batch.column("vehicle"), names)
    return _tracks(record, parts, lambda rows: (rows[:, :3], rows[:, 3:]))


def belief_tracks(record: Record) -> dict[str, Track]:
    """The track of each aircraft as its own ground station believed it, by vehicle id.

    It is read from the GLOBAL_POSITION_INT messages that the station received: `lat`, `lon` in 1e-7 degrees, `alt` in
    millimetres above mean sea level, `vx`, `vy`, `vz` in cm/s. The time of a sample is the time of reception.
    """
    names = ("lat", "lon", "alt", "vx", "vy", "vz")
    parts: dict[str, list[tuple[Ints, Floats]]] = {}
    for heard in record.telemetry(POSITION_MESSAGE, ["time_ns", "operator", "vehicle", *names]).to_batches():
        is_own = pc.equal(heard.column("operator"), pc.replace_substring_regex(heard.column("vehicle"), "/.*", ""))
        heard = heard.filter(is_own)  # an operator's belief covers only its own aircraft
        append_rows(parts, heard, heard.column("vehicle"), names)
    origin = origin_of(record.manifest) or Origin(0.0, 0.0)

    def local(rows: Floats) -> tuple[Floats, Floats]:
        east, north = origin.to_enu(rows[:, 0] * 1e-7, rows[:, 1] * 1e-7)
        return np.stack([east, north, rows[:, 2] * 1e-3 - origin.alt_msl_m], axis=1), rows[:, 3:] * 0.01

    return _tracks(record, parts, local)


def belief_errors_m(truth: Track, belief: Track) -> Floats:
    """(n,) distance in metres between belief and truth at each time of reception, which includes latency.

    Zeros if either track is empty.
    """
    if not len(truth) or not len(belief):
        return np.zeros(len(belief))
    distance: Floats = np.sqrt(((truth.at(belief.time_ns) - belief.enu_m) ** 2).sum(axis=1))
    return distance


@dataclass(frozen=True, slots=True)
class RecordedNote:
    """One row of events, decisions or labels: time, kind, subject, source and details."""

    time_ns: int
    kind: str
    about: str
    source: str
    data: Mapping[str, Any]
    causes: tuple[str, ...] = ()


def read_notes(record: Record, name: str) -> list[RecordedNote]:
    """The rows of `events` or `decisions` in order of time; details that are not a JSON object are under `text`."""
    return read_note_rows(record.table(name).sort_by("time_ns").to_pylist())


def read_note_rows(rows: Iterable[Mapping[str, Any]]) -> list[RecordedNote]:
    """Rows of `events` or `decisions` as notes."""
    return [
        RecordedNote(
            int(row["time_ns"]),
            _text(row.get("kind")),
            _text(row.get("about")),
            _text(row.get("source")),
            parse_details(row.get("data")),
            tuple(row.get("causes") or ()),
        )
        for row in rows
    ]


def labelled_acts(record: Record) -> list[RecordedNote]:
    """The labels as rows about the owner of the link acted on, of kind `attack.<action>`, `fault.<action>`, or
    `harmless.<action>` for the acts of a sham and those of a real aircraft in the honest arm.
    """
    return read_label_rows(record.table("labels").sort_by("at_ns").to_pylist())


def read_label_rows(rows: Iterable[Mapping[str, Any]]) -> list[RecordedNote]:
    """Rows of `labels` as acts, as `labelled_acts` describes them."""
    acts = []
    for row in rows:
        frame = _text(row.get("frame"))
        author = "fault" if row["fault"] else "attack"
        kind = "harmless" if row["benign"] and author == "attack" else author
        acts.append(
            RecordedNote(
                int(row["at_ns"]),
                f"{kind}.{_text(row.get('action'))}",
                _owner(frame),
                _text(row.get("actor")),
                {author: _text(row.get("attack")), "frame": frame},
            )
        )
    return acts


def end_ns(record: Record, tracks: Iterable[Track]) -> int:
    """The last simulated time in the record, at least 1 s."""
    last = max((int(track.time_ns[-1]) for track in tracks if len(track)), default=0)
    declared = record.manifest.get("simulated_s")
    return max(last, int(float(declared) * NS_PER_S) if declared else 0, NS_PER_S)


MOVING_MPS = 0.2
"""An aircraft slower than this counts as stationary."""


def last_activity_ns(tracks: Iterable[Track], rows: Iterable[RecordedNote]) -> int | None:
    """The last time at which an aircraft moved or something was noted; `None` if neither happened."""
    moments = [row.time_ns for row in rows]
    for track in tracks:
        moving = np.flatnonzero(track.speed_mps > MOVING_MPS)
        if len(moving):
            moments.append(int(track.time_ns[moving[-1]]))
    return max(moments, default=None)


def _owner(frame: str) -> str:
    """The owner of a frame's link: `blue/b1` for a frame on `gcs:blue/b1`; "" for an invalid frame id."""
    try:
        return FrameId.parse(frame).link.partition(":")[2]
    except ValueError:
        return ""


def _text(value: object) -> str:
    """A value as text: strings unchanged, `None` as "", anything else as JSON."""
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value, default=str)


def append_rows(parts: dict[str, list[tuple[Ints, Floats]]], batch: Any, keys: Any, names: Sequence[str]) -> None:
    """Append the times (n,) in ns and values (n, len(names)) of a batch to the parts of the vehicles that its rows
    concern by `keys`, a column of vehicle ids.
    """
    codes = keys.dictionary_encode()
    index = codes.indices.to_numpy(zero_copy_only=False)
    time_ns = batch.column("time_ns").to_numpy(zero_copy_only=False)
    columns = [batch.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False) for name in names]
    values = np.stack(columns, axis=1)
    order = np.argsort(index, kind="stable")
    bounds = np.searchsorted(index[order], np.arange(len(codes.dictionary) + 1))
    for number, name in enumerate(codes.dictionary.to_pylist()):
        rows = order[bounds[number] : bounds[number + 1]]
        parts.setdefault(str(name), []).append((time_ns[rows], values[rows]))


def _tracks(
    record: Record,
    parts: Mapping[str, list[tuple[Ints, Floats]]],
    local: Callable[[Floats], tuple[Floats, Floats]],
) -> dict[str, Track]:
    """One track per declared aircraft; `local` converts the collected values to ENU positions and velocities."""
    tracks = {vehicle.id: EMPTY_TRACK for vehicle in vehicles(record)}
    for name in tracks:
        if name in parts:
            time_ns = np.concatenate([times for times, _ in parts[name]])
            position, velocity = local(np.concatenate([values for _, values in parts[name]]))
            keep = np.isfinite(position).all(axis=1)
            order = np.argsort(time_ns[keep], kind="stable")
            speed = np.nan_to_num(np.sqrt((velocity[keep][order] ** 2).sum(axis=1)))
            tracks[name] = Track(time_ns[keep][order], position[keep][order], speed)
    return tracks
