"""Export of the flights of a run as DataFlash logs (`.BIN`), one for each aircraft, as ArduPilot writes them on board.

A log has what the autopilot believed, sensed, sent and did; SIM alone has the truth. Times (`TimeUS`) are microseconds
since the scenario's start, at which all autopilots boot. Memory is bounded: all tables are read once, in spans of time.
"""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.files import DRAFT, MAX_RECORD_BYTES, read_input
from skyrange.core.ids import ID_PATTERN
from skyrange.core.time import NS_PER_S
from skyrange.export import require_origin
from skyrange.export.dataflash_events import EventRows, default_of, label_rows
from skyrange.export.dataflash_messages import DEFINITIONS, encode_definitions
from skyrange.export.dataflash_missions import MissionFrame, StoredMission, list_mission_frames
from skyrange.export.dataflash_reports import ReportRows, frames_of_autopilots
from skyrange.export.dataflash_rows import Ints, Rows, encode_in_order
from skyrange.export.dataflash_states import MAX_AGE_NS, ReadingRows, truth_rows
from skyrange.metrics.time_series import start_utc_ns
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import decode_station_frames
from skyrange.record.read.time_order import align_sorted, sort_by_time
from skyrange.vehicle.builtin.log_events import BANNER
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, initial_values
from skyrange.world.airframes import AIRFRAMES

FOLDER: Final = "logs"
LABELS: Final = "LABL"
_BUILTIN: Final = "builtin"
_MAX_AGE_S: Final = MAX_AGE_NS // NS_PER_S
_DEFINING: Final = ("FMT", "UNIT", "MULT", "FMTU")
_REPORTED: Final = ("ATT", "POS", "VNED", "EKSR", "AHR2", "RFND", "RCIN", "RCOU")
"""Messages that are made of what autopilots send alone."""
_ALWAYS_LEFT_OUT: Final = {
    "XKF1, XKF4": "no report has the biases, faults and timeouts of the estimator",
    "XKF3": "no report has the innovations of the estimator",
    "BARO": "no record has the pressure and the temperature that the barometer measured",
    "VIBE": "the builtin autopilot models no vibration",
}
_WITHOUT_FRAMES: Final = {
    ", ".join((*_REPORTED, "CMD")): "the run's level keeps no frames, and what an autopilot believes is in these",
    "MSG": "without the texts that the autopilot sent, which are in frames",
    "ORGN": "without the estimator's origin and the home set at arming, which are in frames",
}


class LogExport(NamedTuple):
    """The logs that were written into the folder `path`."""

    path: Path
    items: int
    """Messages, without those that define others."""
    by: Mapping[str, int]
    """Messages by file."""
    messages: Mapping[str, int]
    """Messages of all files by name."""
    left_out: Mapping[str, str]
    """What is not in the logs, or only in part, and why."""


def write_dataflash(record: RunRecord, folder: Path | None = None, *, labels: bool = False) -> LogExport:
    """Write a log of each aircraft with the builtin autopilot into `folder` (default: `logs` in the run's folder;
    created if it is missing), as `OPERATOR/VEHICLE.BIN`; with `labels` also LABL, the hostile acts and faults.

    Raises `InputError` for a run at level `summary`, without origin or start, or without a builtin autopilot, and
    `OSError` if a file cannot be written. A log has its name when all are whole.
    """
    record.tables.require("sensors")
    start_utc_ns(record), require_origin(record)
    fleet, left_out = _choose_vehicles(record)
    target = folder or record.path / FOLDER
    with TemporaryDirectory(prefix=f".{target.name}-", suffix=DRAFT, dir=target.parent) as name:
        draft = Path(name)
        logs = _Logs(record, draft, fleet, labels=labels)
        logs.write()
        for vehicle in fleet:
            (target / vehicle).parent.mkdir(parents=True, exist_ok=True)
            (draft / f"{vehicle}.BIN").replace(target / f"{vehicle}.BIN")
    by = {f"{vehicle}.BIN": logs.by_vehicle[number] for number, vehicle in enumerate(fleet)}
    return LogExport(target, sum(by.values()), by, dict(logs.by_name), {**left_out, **logs.left_out()})


def _choose_vehicles(record: RunRecord) -> tuple[dict[str, Mapping[str, Any]], dict[str, str]]:
    """The vehicles with the builtin autopilot, as the manifest declares them, and why others have no log."""
    chosen, others = {}, {}
    for row in record.manifest.get("vehicles") or []:
        vehicle, kind = str(row["id"]), row.get("autopilot")
        if kind != _BUILTIN:
            others[vehicle] = f"no log: its autopilot is {kind}, which writes its own"
        elif not all(ID_PATTERN.fullmatch(part) for part in vehicle.split("/")) or vehicle.count("/") != 1:
            others[vehicle] = "no log: its id is no name of a file"
        else:
            chosen[vehicle] = row
    if not chosen:
        hint = "ArduPilot writes logs of its own: [autopilots.options.ardupilot] keep_logs keeps them."
        kinds = ", ".join(sorted({str(row.get("autopilot")) for row in record.manifest.get("vehicles") or []}))
        raise InputError.one(str(record.path), "vehicles", kinds or "none", "one with the builtin autopilot", hint)
    return chosen, others


def _initial_params(record: RunRecord, fleet: Mapping[str, Mapping[str, Any]]) -> dict[int, dict[str, float]]:
    """The parameters of each aircraft at its first boot, by the scenario of the run."""
    who = str(record.path)
    data = read_input(record.path / "scenario.toml", who, "scenario.toml", max_bytes=MAX_RECORD_BYTES)
    try:
        scenario = tomllib.loads(data.decode())
        given = {
            f"{operator['id']}/{vehicle['id']}": dict(vehicle.get("params") or {})
            for operator in scenario.get("operators") or []
            for vehicle in operator.get("vehicles") or []
        }
    except (ValueError, TypeError, KeyError) as error:
        raise InputError.one(
            who, "scenario.toml", str(error)[:80], "the scenario of the run, as it was written"
        ) from error
    found = {}
    for number, (vehicle, row) in enumerate(fleet.items()):
        airframe = AIRFRAMES.get(str(row.get("airframe")))
        if airframe is None or vehicle not in given:
            expected = "one that the scenario declares, with a known airframe"
            raise InputError.one(who, "manifest.json: vehicles", vehicle, expected)
        values = initial_values(vehicle, airframe, int(row.get("system_id", 1)), given[vehicle])
        found[number] = {known.name: value for known, value in zip(PARAMETERS, values.tolist(), strict=True)}
    return found


class _Logs:
    """The logs of some aircraft while they are written."""

    def __init__(
        self, record: RunRecord, folder: Path, fleet: Mapping[str, Mapping[str, Any]], *, labels: bool
    ) -> None:
        self._record, self._folder, self._labels = record, folder, labels
        self._vehicles = list(fleet)
        self._names = pa.array(self._vehicles, pa.string())
        self._origin = require_origin(record)
        self._framed = record.keeps("frames")
        self._readings = ReadingRows(self._names, self._origin, start_utc_ns(record))
        self._reports = ReportRows(self._vehicles, self._readings)
        self._events = EventRows(self._vehicles, _initial_params(record, fleet), self._origin)
        self._missions = [StoredMission() for _ in self._vehicles]
        self._untold = 0
        """Missions that were stored, and whose items no frame has."""
        self.by_vehicle: Counter[int] = Counter()
        self.by_name: Counter[str] = Counter()

    def write(self) -> None:
        """Write all logs."""
        self._begin()
        for span in align_sorted(self._streams(), "time_ns"):
            rows = [part for part in self._span_rows(span) if len(part.time_ns)]
            for part in rows:
                self.by_vehicle.update(Counter(part.vehicle.tolist()))
                self.by_name[part.name] += len(part.time_ns)
            for number, data in encode_in_order(rows):
                with self._path(number).open("ab") as file:  # a fleet has more files than a process may have open
                    file.write(data)

    def left_out(self) -> dict[str, str]:
        """What is not in the logs, or only in part, and why."""
        found = dict(_ALWAYS_LEFT_OUT) | ({} if self._framed else _WITHOUT_FRAMES)
        if self._untold and self._framed:
            found["CMD"] = f"{self._untold:,} missions were stored whose items are in no frame"
        for field, count in self._readings.unknown.items():
            if count:
                total = self.by_name[field.partition(".")[0]]
                found[field] = f"unknown in {count:,} of {total:,}: no report of the {_MAX_AGE_S} s before has it"
        told = {name for names in found for name in names.split(", ")}
        empty = [name for name in self._defined() if name not in told and not self.by_name[name]]
        not_sent = [name for name in empty if name in _REPORTED]
        unknown = [name for name in empty if name not in _REPORTED]
        if not_sent:
            found[", ".join(not_sent)] = 'no autopilot sent reports with these; [[operators]] streams = "operator" does'
        return found | ({", ".join(unknown): "the run has nothing of the kind"} if unknown else {})

    def _defined(self) -> Sequence[str]:
        return [name for name in DEFINITIONS if name not in _DEFINING and (self._labels or name != LABELS)]

    def _path(self, number: int) -> Path:
        return self._folder / f"{self._vehicles[number]}.BIN"

    def _begin(self) -> None:
        """Write the definitions, the firmware and the parameters of each log."""
        definitions = encode_definitions(self._defined())
        message, parameter = DEFINITIONS["MSG"], DEFINITIONS["PARM"]
        for number, vehicle in enumerate(self._vehicles):
            texts = [
                f"{BANNER[0].partition('(')[0]}(simulated by skyrange {self._record.manifest.get('skyrange')})",
                *BANNER[1:],
                f"Simulated aircraft {vehicle}"[:64],
                "TimeUS is time since the start of the scenario",
            ]
            params = self._events.params[number]
            head = [
                *(message.encode(0, text.encode()) for text in texts),
                *(parameter.encode(0, name.encode(), value, default_of(name)) for name, value in params.items()),
            ]
            self._path(number).parent.mkdir(parents=True, exist_ok=True)
            self._path(number).write_bytes(b"".join([definitions, *head]))
            self.by_vehicle[number] += len(head)
            self.by_name.update({"MSG": len(texts), "PARM": len(params)})

    def _streams(self) -> dict[str, Iterator[pa.Table]]:
        """The tables that logs are made of, each in order of time."""
        tables = ["truth", "sensors", "received_sensors", "events"]
        streams = {name: self._sorted(name, "time_ns") for name in tables}
        if self._framed:
            streams["frames"] = frames_of_autopilots(self._record.tables, self._vehicles)
        if self._labels:
            labels = self._sorted("labels", "at_ns")
            streams["labels"] = (table.append_column("time_ns", table.column("at_ns")) for table in labels)
        return streams

    def _sorted(self, name: str, key: str) -> Iterator[pa.Table]:
        def tables() -> Iterator[pa.Table]:
            return (pa.Table.from_batches([batch]) for batch in self._record.batches(name))

        def keys() -> Iterator[Ints]:
            return (batch.column(0).to_numpy() for batch in self._record.batches(name, [key]))

        return sort_by_time(tables, key, (), keys)

    def _span_rows(self, span: Mapping[str, pa.Table]) -> Iterator[Rows]:
        """The messages of a span of time, those that are logged first at one time first."""
        uploads: list[MissionFrame] = []
        if "frames" in span:
            block = decode_station_frames(span["frames"])
            uploads = sorted(
                list_mission_frames(block, self._reports.owners(block), self._events.systems),
                key=lambda frame: frame.time_ns,
            )
            yield from self._reports.rows(block)
        yield from self._event_rows(span.get("events"), uploads)
        yield from self._readings.rows(span.get("sensors"), span.get("received_sensors"), self._monitored())
        if "truth" in span:
            yield truth_rows(span["truth"], self._names, self._origin)
        if "labels" in span:
            yield from label_rows(span["labels"], self._vehicles)

    def _event_rows(self, events: pa.Table | None, uploads: Sequence[MissionFrame]) -> Iterator[Rows]:
        waiting = iter(uploads)
        following = next(waiting, None)

        def stored(vehicle: int, time_ns: int, count: int) -> Rows | None:
            """CMD of a mission: its frames are older than its event, or of the same time."""
            nonlocal following
            while following is not None and following.time_ns <= time_ns:
                self._missions[following.vehicle].take(following)
                following = next(waiting, None)
            found = self._missions[vehicle].rows(vehicle, time_ns, count)
            self._untold += found is None
            return found

        if events is not None:
            yield from self._events.rows(events, stored)
        while following is not None:
            self._missions[following.vehicle].take(following)
            following = next(waiting, None)

    def _monitored(self) -> NDArray[np.bool_]:
        """Whether each aircraft measures its battery."""
        return np.array([self._events.params[n].get("BATT_MONITOR", 0) != 0 for n in range(len(self._vehicles))])
