"""Views of one run in batches as the data set stores them, among them `aircraft`, `episodes` and `flows`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.core.ids import Port, endpoint, link_name, operator_of
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.dataset.columns import AGED, FIELDS, RUN_COLUMNS, view_schema
from skyrange.dataset.frame_views import (
    Place,
    SeenActs,
    describe_approval,
    describe_mavlink,
    describe_receptions,
    ports_of,
    seen_frames,
)
from skyrange.dataset.labels import ATTACK, WindowLabeller, dropped_at, read_acts, trace_frames
from skyrange.dataset.windows import WINDOW_NS, number_keys
from skyrange.record.manifest import fleet_of
from skyrange.record.message_groups import GROUPS, group_messages
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import payload_column

Floats = np.ndarray[Any, np.dtype[np.float64]]


class FlowCounter:
    """Statistics of the frames of a run, added table by table; each table holds whole windows."""

    def __init__(self, record: RunRecord, ports: Sequence[Port]) -> None:
        self._windows = max(1, -(-from_seconds(record.duration) // WINDOW_NS))
        self._flows = [(port, received) for port in ports for received in (True, False)]
        self._place = {(port.endpoint, port.link, received): k for k, (port, received) in enumerate(self._flows)}
        size = len(self._flows) * self._windows
        self._sums = {name: np.zeros(size, dtype=np.int64) for name in _SUMS}
        self._stats = {name: np.full(size, np.nan) for name in _STATS}
        self._senders: dict[tuple[int, int], int] = {}
        self._firsts = {(row["name"]): row["a"] for row in record.manifest.get("links") or ()}

    def add(self, frames: pa.Table) -> None:
        """Add rows of the view `mavlink`."""
        flow = self._flow_of(frames)
        window = np.minimum(frames.column("window").to_numpy(), self._windows - 1)
        key = flow * self._windows + window
        order = np.argsort(key, kind="stable")
        key = key[order]
        begin = np.flatnonzero(np.diff(key, prepend=-1))
        cell = key[begin]
        if not len(cell):
            return
        size = frames.column("size").to_numpy()[order].astype(np.int64)
        self._sums["frames"][cell] = np.diff([*begin, len(key)])
        self._sums["bytes"][cell] = np.add.reduceat(size, begin)
        self._spread("size", size.astype(np.float64), begin, cell)
        self._intervals(frames.column("time_ns").to_numpy()[order], begin, cell)
        group = group_messages(payload_column(frames.column("raw")))[order]
        marks = {name: group == place for place, name in enumerate(GROUPS, 1)}
        for name, column in (("invalid", pc.invert(frames.column("valid"))), ("signed", frames.column("signed")),
                             ("hostile", frames.column("hostile")), ("derived", frames.column("derived"))):  # fmt: skip
            marks[name] = np.asarray(column)[order]
        for name, mark in marks.items():
            self._sums[name][cell] = np.add.reduceat(mark.astype(np.int64), begin)
        sender = _joined(frames, "system", "component")[order]
        message = frames.column("message_id").fill_null(-1).to_numpy()[order]
        self._sums["senders"][cell] = _distinct(key, sender, begin)
        self._sums["message_kinds"][cell] = _distinct(key, message.astype(np.int64), begin)
        self._gaps(flow[order], sender, frames.column("sequence").fill_null(-1).to_numpy()[order], begin, cell)

    def _flow_of(self, frames: pa.Table) -> Ints:
        key = ("place", "link", "received")
        codes = number_keys(frames, key)
        _, first, rows = np.unique(codes, return_index=True, return_inverse=True)
        keys = frames.select(key).take(pa.array(first)).to_pylist()
        numbers = np.array(
            [self._place[flow["place"], flow["link"], flow["received"]] for flow in keys], dtype=np.int64
        )
        return numbers[rows]

    def _spread(self, name: str, values: Floats, begin: Ints, cell: Ints) -> None:
        count = np.diff([*begin, len(values)])
        mean = np.add.reduceat(values, begin) / count
        deviation = np.add.reduceat((values - np.repeat(mean, count)) ** 2, begin) / count
        self._stats[f"{name}_mean"][cell] = mean
        self._stats[f"{name}_std"][cell] = np.sqrt(deviation)
        self._stats[f"{name}_min"][cell] = np.minimum.reduceat(values, begin)
        self._stats[f"{name}_max"][cell] = np.maximum.reduceat(values, begin)

    def _intervals(self, time_ns: Ints, begin: Ints, cell: Ints) -> None:
        inside = np.ones(len(time_ns), dtype=np.bool_)
        inside[begin] = False
        owner = np.repeat(cell, np.diff([*begin, len(time_ns)]))[inside]
        if not len(owner):
            return
        between = np.diff(time_ns, prepend=time_ns[:1])[inside] / 1e6
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        self._spread("iat", between, first, owner[first])

    def _gaps(self, flow: Ints, sender: Ints, sequence: Ints, begin: Ints, cell: Ints) -> None:
        """Count the frames that do not follow the previous one of their flow and claimed sender."""
        gap = np.zeros(len(flow), dtype=np.int64)
        order = np.lexsort((np.arange(len(flow)), sender, flow))
        heads = np.flatnonzero((np.diff(flow[order], prepend=-1) != 0) | (np.diff(sender[order], prepend=-2) != 0))
        for at, end in zip(heads.tolist(), [*heads[1:].tolist(), len(order)], strict=True):
            rows = order[at:end]
            numbers = sequence[rows]
            if sender[rows[0]] < 0:
                continue
            key = (int(flow[rows[0]]), int(sender[rows[0]]))
            before = self._senders.get(key, int(numbers[0]) - 1)
            previous = np.append(before, numbers[:-1]).astype(np.int64)
            gap[rows] = (numbers - previous) & 0xFF != 1
            self._senders[key] = int(numbers[-1])
        self._sums["sequence_gaps"][cell] = np.add.reduceat(gap, begin)

    def tables(self, labeller: WindowLabeller, seen_ns: dict[Port, Ints]) -> Iterator[pa.Table]:
        """The rows of the view for each flow, without its first and last columns; also windows without a frame."""
        window = np.arange(self._windows, dtype=np.int64)
        begin_ns = window * WINDOW_NS
        for place, (port, received) in enumerate(self._flows):
            cells = slice(place * self._windows, (place + 1) * self._windows)
            sums = {name: column[cells] for name, column in self._sums.items()}
            stats = {name: column[cells] for name, column in self._stats.items()}
            frames = sums["frames"]
            times = seen_ns.get(port, np.zeros(0, dtype=np.int64))
            if received:
                direction = "rev" if self._firsts[port.link] == port.endpoint else "fwd"
                times = np.sort(np.concatenate([times, dropped_at(labeller.acts, port.link, direction)]))
            shares = {name: pa.array(sums[name] / np.maximum(frames, 1), mask=frames == 0) for name in _SHARES}
            yield pa.table(
                {
                    "place": [port.endpoint] * self._windows,
                    "link": [port.link] * self._windows,
                    "time_ns": begin_ns,
                    "received": np.full(self._windows, received),
                    "frames": frames.astype(np.int32),
                    "bytes": sums["bytes"],
                    **{name if name.startswith("size") else f"{name}_ms": pa.array(column, mask=np.isnan(column))
                       for name, column in stats.items()},
                    **shares,
                    **{name: sums[name].astype(np.int32) for name in ("message_kinds", "senders", "sequence_gaps")},
                    "window": window,
                    **labeller.columns(port.link.partition(":")[2], begin_ns, begin_ns + WINDOW_NS, times),
                    "hostile_frames": sums["hostile"].astype(np.int32),
                    "derived_frames": sums["derived"].astype(np.int32),
                }
            )  # fmt: skip


_SHARES = (*GROUPS, "invalid", "signed")
_SUMS = (*_SHARES, "frames", "bytes", "hostile", "derived", "senders", "message_kinds", "sequence_gaps")
_STATS = tuple(f"{measure}_{statistic}" for measure in ("size", "iat") for statistic in ("mean", "std", "min", "max"))


def _joined(frames: pa.Table, first_column: str, second_column: str) -> Ints:
    """(n,) a number for each pair of two columns; -1 where they are null."""
    first, second = (
        frames.column(name).fill_null(-1).to_numpy().astype(np.int64) for name in (first_column, second_column)
    )
    joined: Ints = np.where(first < 0, -1, first * 256 + second)
    return joined


def _distinct(key: Ints, values: Ints, begin: Ints) -> Ints:
    """The number of different values in each run of equal keys."""
    order = np.lexsort((values, key))
    fresh = (np.diff(key[order], prepend=-1) != 0) | (np.diff(values[order], prepend=-(2**62)) != 0)
    counts: Ints = np.add.reduceat(fresh.astype(np.int64), begin)
    return counts


def describe_episodes(record: RunRecord, labeller: WindowLabeller, seen_acts: SeenActs) -> pa.Table:
    """One row for each author that acted and each aircraft that it acted on or touches, without the run's columns."""
    fleet = fleet_of(record.manifest, str(record.path))
    declared = {
        row["id"]: row for row in (*(record.manifest.get("attacks") or ()), *(record.manifest.get("faults") or ()))
    }
    acts = labeller.acts
    authors = dict.fromkeys((act.author, act.role) for act in acts.acts)
    rows = []
    for author, role in authors:
        author_acts = [act for act in acts.acts if act.author == author and act.role == role]
        touched = {str(name).partition(":")[2] or str(name) for name in declared.get(author, {}).get("touches", ())}
        touched |= {act.owner for act in author_acts}
        vehicles: list[str | None] = [name for name in fleet if name in touched]
        for vehicle in vehicles or [None]:
            link = link_name("gcs", vehicle or "")
            times = [seen_acts.authors.get((link, author)), _first(dropped_at(acts, link, "rev"))]
            observed_ns = [time_ns for time_ns in times if time_ns is not None]
            effect_s = (labeller.effects_s or {}).get(vehicle or "")
            rows.append(
                {
                    "vehicle": vehicle, "author": author, "role": role, "kind": acts.kinds.get(author, "unknown"),
                    "family": acts.families.get(author), "onset_ns": author_acts[0].at_ns,
                    "end_ns": max(act.until_ns for act in author_acts), "acts": len(author_acts),
                    "observable_ns": min(observed_ns) if observed_ns and role == ATTACK else None,
                    "effect_ns": None if effect_s is None or role != ATTACK else from_seconds(effect_s),
                }
            )  # fmt: skip
    schema = view_schema("episodes")
    return pa.Table.from_pylist(rows, schema=pa.schema(list(schema)[len(RUN_COLUMNS) :]))


def _first(times: Ints) -> int | None:
    return int(np.min(times)) if len(times) else None


def describe_aircraft(
    record: RunRecord, rate_hz: float, labeller: WindowLabeller, seen_ns: dict[Port, Ints]
) -> Iterator[pa.Table]:
    """The rows of the view for each aircraft, without its first and last columns.

    A row has the last values received up to its time, and null for what was never received. Windows are the intervals
    between rows. Raises `InputError` for a record without telemetry.
    """
    period_ns = round(NS_PER_S / rate_hz)
    count = from_seconds(record.duration) // period_ns
    end_ns = np.arange(1, count + 1, dtype=np.int64) * period_ns
    messages = {
        name: record.telemetry(name)
        for name in {*AGED, *(telemetry_field.message for telemetry_field in FIELDS)} & {*record.messages}
    }
    for vehicle in fleet_of(record.manifest, str(record.path)):
        vehicle_messages = {
            name: table.filter(pc.equal(table.column("vehicle"), vehicle)) for name, table in messages.items()
        }
        port = Port(endpoint(operator_of(vehicle), "gcs"), link_name("gcs", vehicle))
        missing = dropped_at(labeller.acts, port.link, "rev")
        times = np.sort(np.concatenate([seen_ns.get(port, np.zeros(0, dtype=np.int64)), missing]))
        last = {name: _last(table, end_ns) for name, table in vehicle_messages.items()}
        columns: dict[str, pa.Array] = {"vehicle": pa.array([vehicle] * count, pa.string()), "time_ns": end_ns}
        for telemetry_field in FIELDS:
            columns[telemetry_field.column] = pa.nulls(count, pa.float64())
            if telemetry_field.message in vehicle_messages:
                values = pc.multiply(
                    vehicle_messages[telemetry_field.message].column(telemetry_field.field).cast(pa.float64()),
                    telemetry_field.factor,
                )
                columns[telemetry_field.column] = _taken(values, last[telemetry_field.message])
        for name in AGED:
            age = pa.nulls(count, pa.float64())
            if name in vehicle_messages:
                received = _taken(vehicle_messages[name].column("time_ns"), last[name])
                age = pc.divide(pc.subtract(pa.array(end_ns), received).cast(pa.float64()), float(NS_PER_S))
            columns[f"{name.lower()}_age_s"] = age
        # an interval includes its end and not its begin: a frame at the row's time is known in the row
        labels = labeller.columns(vehicle, end_ns - period_ns + 1, end_ns + 1, times)
        yield pa.table({**columns, "window": end_ns // period_ns - 1, **labels})


def _last(table: pa.Table, end_ns: Ints) -> Ints:
    """The row of `table` that is the last one up to each time; -1 for none."""
    rows: Ints = np.searchsorted(table.column("time_ns").to_numpy(), end_ns, side="right") - 1
    return rows


def _taken(column: pa.ChunkedArray, rows: Ints) -> pa.Array:
    values = column.take(pa.array(rows, mask=rows < 0))
    return values.combine_chunks() if isinstance(values, pa.ChunkedArray) else values


_APPROVAL: Final = Place("approval:*", "gcs")
"""Where approval messages are seen."""


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """Where the sensors of a data set are, and at what rate it samples."""

    places: Sequence[Place] = (Place(),)
    """Where MAVLink frames and flows are seen: by default the ground station's end of the gcs links."""
    rate_hz: float = 2.0
    """Rows of `aircraft` a second, 1 to 4."""


def run_views(
    record: RunRecord, settings: ViewSettings, effects_s: Mapping[str, float | None] | None = None
) -> Iterator[tuple[str, pa.Table]]:
    """The views of a run by name, each in one table or several, without the columns of the run and the window's hash.

    The tables of a view of frames have whole windows. Raises `InputError` for a record that does not keep frames.
    """
    labels = trace_frames(record, acts := read_acts(record))
    labeller, seen_acts = WindowLabeller(acts, effects_s), SeenActs()
    ports, stations = ports_of(record, settings.places), ports_of(record, (_APPROVAL,))
    both = ports_of(record, (*settings.places, _APPROVAL))
    is_place, is_station = (np.array([port in side_ports for port in both]) for side_ports in (ports, stations))
    flows = FlowCounter(record, ports)
    for port, frames in seen_frames(record, both, labels, seen_acts):
        described = describe_mavlink(_where(frames, is_place[port]))
        flows.add(described)
        yield "mavlink", described
        yield "approval", describe_approval(_where(frames, is_station[port]))
    times = {port: seen_acts.at(port) for port in ports}
    for table in flows.tables(labeller, times):
        yield "flows", table
    for table in describe_aircraft(record, settings.rate_hz, labeller, times):
        yield "aircraft", table
    for table in describe_receptions(record, labels):
        yield "remote_id", table
    yield "episodes", describe_episodes(record, labeller, seen_acts)


def _where(table: pa.Table, chosen: NDArray[np.bool_]) -> pa.Table:
    return table if chosen.all() else table.filter(pa.array(chosen))
