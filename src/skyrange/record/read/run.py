"""Reader of a recorded run, whether it ended, was interrupted, or was killed."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import MAX_RECORD_BYTES, expand_user, parse_json, read_input
from skyrange.core.ids import FrameId
from skyrange.core.time import to_seconds
from skyrange.core.typed_json import require_type
from skyrange.record.folder import check_folder_name
from skyrange.record.manifest import RUNNING, origin_of, read_manifest, start_unix_ns_of
from skyrange.record.manifest_types import Building
from skyrange.record.notes import CRASH, OUTCOME, outcomes_of_events, parse_details, vehicle_ids
from skyrange.record.read.features import count_features, features_period_ns, merge_features
from skyrange.record.read.notebook import describe_record, render_record
from skyrange.record.read.observations import derive_observations, observations_table
from skyrange.record.read.tables import Tables
from skyrange.record.read.telemetry import FOLDER, count_messages, is_message, message_batches, read_message
from skyrange.record.schema import FULL, TABLES, arrow_schema, keeps, level_of
from skyrange.record.spool import SPOOL, table_files

if TYPE_CHECKING:
    import pandas
    import polars

    from skyrange.figures import Figure


class RecordedFrame(NamedTuple):
    """One recorded frame; `parent` and `causes` are ids in the text form of `core.ids.FrameId`."""

    link: str
    direction: str
    sender: str
    serial: int
    src: str
    dst: str
    sent_ns: int
    arrived_ns: int | None
    fate: str
    payload: bytes
    parent: str | None
    causes: tuple[str, ...]

    @property
    def id(self) -> str:
        """The frame's own id in the same text form as `parent` and `causes`."""
        return str(FrameId(self.link, self.direction, self.sender, self.serial))


_FRAME_COLUMNS = [name for name in RecordedFrame._fields if name != "payload"]


def _whole(name: str) -> property:
    """A property that is a whole table."""

    def read(record: RunRecord) -> pa.Table:
        return record.table(name)

    read.__doc__ = f"The whole table `{name}`, as a `pyarrow.Table`."
    return property(read)


@dataclass(frozen=True, repr=False)
class RunRecord:
    """An opened run folder. Tables are read on request."""

    path: Path
    manifest: dict[str, Any]
    tables: Tables

    truth = _whole("truth")
    frames = _whole("frames")
    events = _whole("events")
    decisions = _whole("decisions")
    labels = _whole("labels")
    alerts = _whole("alerts")
    observations = _whole("observations")
    features = _whole("features")

    def __repr__(self) -> str:
        return describe_record(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return render_record(self)

    @property
    def status(self) -> str:
        """`complete`, `interrupted`, `failed`, or `killed or still running`."""
        status = str(self.manifest["status"])
        return "killed or still running" if status == RUNNING else status

    @property
    def ended(self) -> bool:
        """Whether the manifest says how the run ended."""
        return bool(self.manifest["status"] != RUNNING)

    def table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """A whole table as a `pyarrow.Table`, with names as plain strings; `columns` selects columns.

        The names of tables are those of `skyrange.record.schema.TABLES`. A table without recorded rows is empty.
        Raises `InputError` for a table that the run's `level` leaves out.
        """
        _check(name)
        if self._is_derived_now(name):
            table = self._derive(name)
            return table if columns is None else table.select(list(columns))
        return self.tables.table(name, columns)

    def to_pandas(self, name: str, columns: Sequence[str] | None = None) -> pandas.DataFrame:
        """A table as a pandas data frame. Raises `InputError` as `table` does, and without pandas."""
        _require_package("pandas")
        return cast("pandas.DataFrame", self.table(name, columns).to_pandas())

    def to_polars(self, name: str, columns: Sequence[str] | None = None) -> polars.DataFrame:
        """A table as a polars data frame. Raises `InputError` as `table` does, and without polars."""
        frame = _require_package("polars").from_arrow(self.table(name, columns))
        return cast("polars.DataFrame", frame)

    def plot(self) -> Figure:
        """The tracks of all aircraft from above, over the city; a notebook displays it, and `save` writes it."""
        from skyrange.figures import plan_view

        return plan_view(self)

    def batches(self, name: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """The same rows in batches, for tables that are larger than memory."""
        _check(name)
        if self._is_derived_now(name):
            batches: Iterable[pa.RecordBatch] = (
                derive_observations(self.tables, origin_of(self.manifest), start_unix_ns_of(self.manifest))
                if name == "observations"
                else self._derive(name).to_batches()
            )
            return iter(batches) if columns is None else (batch.select(list(columns)) for batch in batches)
        return self.tables.batches(name, columns)

    def rows(self, name: str) -> int:
        """Number of rows of a table."""
        _check(name)
        if self._is_derived_now(name):
            return int(self.table(name, ["time_ns"]).num_rows)
        return self.tables.rows(name)

    def _is_derived_now(self, name: str) -> bool:
        """Whether a table is derived on request: the run did not end, or keeps the frames that are counted in it."""
        if name == "observations":
            return self.level == FULL and self.tables.spooled
        return name == "features" and (self.level == FULL or self.tables.spooled)

    def _derive(self, name: str) -> pa.Table:
        """The whole of a table that is derived now."""
        self.tables.require(name)
        if name == "observations":
            return observations_table(self.tables, origin_of(self.manifest), start_unix_ns_of(self.manifest))
        if self.level == FULL:
            return count_features(self.tables, features_period_ns(self.manifest))
        return pa.concat_tables([arrow_schema(name).empty_table(), *merge_features(self.tables)])

    @property
    def level(self) -> str:
        """The level at which it was recorded: full, study or summary (`record.schema`)."""
        return level_of(self.manifest)

    def keeps(self, name: str) -> bool:
        """Whether the run's level keeps a table, or "telemetry"; reading another raises `InputError`."""
        return keeps(self.manifest, name)

    @property
    def messages(self) -> dict[str, int]:
        """How many of each MAVLink message the ground stations received, by name; `BAD_DATA` is undecodable bytes."""
        self.tables.require(FOLDER)
        declared = self.manifest.get("messages")
        return count_messages(self.tables) if declared is None or self.tables.spooled else dict(declared)

    def telemetry(self, message: str, columns: Sequence[str] | None = None) -> pa.Table:
        """What ground stations received of a MAVLink message, such as "ATTITUDE", in order of time: its fields in
        MAVLink's types and units. For a killed run it is derived from the frames now.

        Raises `InputError` for a name that no message has.
        """
        self._check_message(message)
        table = read_message(self.tables, message)
        return table if columns is None else table.select(list(columns))

    def telemetry_batches(self, message: str) -> Iterator[pa.RecordBatch]:
        """The same rows in batches, for messages that are larger than memory."""
        self._check_message(message)
        return message_batches(self.tables, message)

    def _check_message(self, message: str) -> None:
        if not is_message(message):
            hint = nearest(message, self.messages)
            raise InputError.one("record", "message", message, "a MAVLink message such as ATTITUDE", hint)

    def frames_with_payloads(self) -> Iterator[RecordedFrame]:
        """Every frame with its payload, in the order recorded, which is nearly the order of time."""
        for table in self.tables.frames_with_payloads(_FRAME_COLUMNS):
            columns = {name: table.column(name).to_pylist() for name in table.column_names}
            columns["causes"] = [tuple(ids or ()) for ids in columns["causes"]]
            for row in zip(*(columns[name] for name in RecordedFrame._fields), strict=True):
                yield RecordedFrame(*row)

    @property
    def city(self) -> list[dict[str, Any]]:
        """The buildings of `city.json`: `height_m` and `rings` of (east, north) metres; empty if there is no file."""
        path = self.path / "city.json"
        if not path.exists():
            return []
        who = str(self.path)
        buildings = parse_json(read_input(path, who, path.name, max_bytes=MAX_RECORD_BYTES), who, path.name)
        require_type(buildings, list[Building], who, path.name)
        found: list[dict[str, Any]] = buildings
        return found

    @property
    def outcomes(self) -> dict[str, dict[str, Any]]:
        """`state`, `reason` and `finished_s` of every aircraft's mission.

        The state is that which the ground station reported last, but `failed` if the aircraft crashed.
        """
        declared = self.manifest.get("outcomes")
        if declared is not None and not self.tables.spooled:
            return dict(declared)
        table = self.tables.table("events", ["time_ns", "kind", "about", "data"])
        ends = table.filter(pc.is_in(table.column("kind"), pa.array([OUTCOME, CRASH]))).to_pylist()
        events = ((row["time_ns"], row["kind"], row["about"], parse_details(row["data"])) for row in ends)
        return outcomes_of_events(vehicle_ids(self.manifest), events)

    @property
    def duration(self) -> float:
        """Simulated seconds that the record covers."""
        declared = self.manifest.get("simulated_s")
        if declared is not None:
            return float(declared)
        last = 0
        for name, column in (("truth", "time_ns"), ("frames", "arrived_ns"), ("events", "time_ns")):
            if not self.keeps(name):
                continue
            for batch in self.tables.batches(name, [column]):
                last = max(last, pc.max(batch.column(0)).as_py() or 0)
        return to_seconds(last)


def load(path: Path | str) -> RunRecord:
    """Open the run in the folder `path`.

    Raises `InputError` if it is not a run's folder, was written in another format, has a damaged manifest, or lacks a
    table. Of a run that was killed or is running, the record contains the rows that were written.
    """
    record = open_folder(path)
    lost = [] if record.tables.spooled else list(_lost_tables(record))
    if lost:
        hint = f"It was removed. `skyrange verify {record.path}` names everything that is not as the manifest says."
        problems = [Problem(name, "missing", "a table of this run", hint) for name in lost]
        raise InputError(str(record.path), problems)
    return record


def _lost_tables(record: RunRecord) -> Iterator[str]:
    """The tables, and the parts of tables, that a run lacks by its manifest."""
    names = [
        *(record.manifest.get("counts") or ()),
        *(f"{FOLDER}/{message}" for message in record.manifest.get("messages") or ()),
    ]
    for name in names:
        if not table_files(record.path / f"{name}.parquet"):
            yield f"{name}.parquet"
    for name in record.manifest.get("files") or ():
        if ".parquet/" in name and not os.path.isfile(record.path / name):
            yield name


def open_folder(path: Path | str) -> RunRecord:
    """Open a run's folder as `load` does, also one that lacks tables: these are read as empty."""
    folder = expand_user(path)
    check_folder_name(folder, "run")
    manifest = read_manifest(folder)
    spooled = manifest["status"] == RUNNING or manifest.get("spooled") is True
    if spooled and not (folder / SPOOL).is_dir():
        raise InputError.one(str(folder), SPOOL, "missing", "the streams of a run that did not end", "It was removed.")
    return RunRecord(folder, manifest, Tables(folder, spooled, level=level_of(manifest)))


def _require_package(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError:
        hint = f"pip install {name}"
        raise InputError.one("record", "package", name, "an installed package", hint) from None


def _check(name: str) -> None:
    if name == FOLDER:
        hint = "Each MAVLink message has its own: record.telemetry('ATTITUDE'); record.messages names them."
        raise InputError.one("record", "table", name, "the name of one table", hint)
    if name not in TABLES:
        raise InputError.one("record", "table", name, f"one of {', '.join(TABLES)}", nearest(name, TABLES))
