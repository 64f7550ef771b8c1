"""Files for operators: a CSV file of all data received, and tlogs of both directions, one per MAVLink network.

The CSV file has one row per message. Its columns are the union of the fields of all messages; a cell is empty if the
message has no such field. `fields.csv` gives the unit of every field. A tlog has the format of QGroundControl, Mission
Planner and MAVProxy: before each frame, 8 bytes, big endian, microseconds of UTC (QGroundControl developer guide,
"MAVLink log format"). Readers of tlogs distinguish aircraft by system id alone, so each of an operator's networks has
a file of its own: `blue.tlog`, `blue.net1.tlog`, …
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

from skyrange.codec.mavlink.message_columns import message_columns
from skyrange.contracts.frames import Bytes, Ints
from skyrange.core.compiled import compiled
from skyrange.core.ids import ID_PATTERN, operator_of
from skyrange.record.manifest import epoch_of
from skyrange.record.read.station_frames import (
    MessageSurvey,
    StationFrames,
    name_of,
    numeric_column,
    read_station_frames,
    survey_messages,
    text_column,
)
from skyrange.record.read.tables import Tables
from skyrange.record.schema import BAD_DATA

_FIXED = ("time_s", "utc", "vehicle", "system_id", "component_id", "message")
_STAMP_BYTES = 8


@compiled
def _interleave(stamps: NDArray[np.uint64], data: Bytes, starts: Ints, sizes: Ints, out: Bytes) -> None:
    """Write each payload to `out`, preceded by its time, most significant byte first."""
    at = 0
    for row in range(starts.shape[0]):
        for byte in range(8):
            out[at + byte] = (stamps[row] >> np.uint64(56 - 8 * byte)) & np.uint64(255)
        at += 8
        for place in range(sizes[row]):
            out[at + place] = data[starts[row] + place]
        at += sizes[row]


OPERATORS: Final = "operators"
"""The folder of the files in a run's folder."""


def write_operator_files(
    folder: Path, tables: Tables, manifest: Mapping[str, Any], *, with_csv: bool = True, with_tlogs: bool = True
) -> None:
    """Write the files of all operators of a run into an existing folder, in one pass over the frames at their ground
    stations, after one that finds the columns of CSV files. Raises `OSError`.
    """
    survey = survey_messages(tables) if with_csv else MessageSurvey()
    kinds = survey.cells()
    with OperatorFiles(folder, manifest, survey, with_csv=with_csv, with_tlogs=with_tlogs) as files:
        for block in read_station_frames(tables):
            files.write_tlogs(block)
            if with_csv:
                files.write_csv(ReceivedMessages(block, kinds))


class ReceivedMessages:
    """The received rows of a block as columns: message names, and by field the values and a mask of absent ones."""

    def __init__(self, block: StationFrames, kinds: dict[str, str]) -> None:
        """`kinds` gives the type of each column: "int", "float" or "text"."""
        self.rows = np.flatnonzero(block.received)
        count = len(self.rows)
        place = np.cumsum(block.received) - 1
        self.block = block
        self.messages = [BAD_DATA]
        self.message: NDArray[np.int32] = np.zeros(count, dtype=np.int32)
        self.system = np.full(count, -1, dtype=np.int32)
        self.component = np.full(count, -1, dtype=np.int32)
        self.values: dict[str, tuple[Any, NDArray[np.bool_]]] = {}
        for group in block.groups(block.received):
            places = place[group.rows]
            self.message[places] = len(self.messages)
            self.messages.append(name_of(group.message_id))
            self.system[places] = group.systems
            self.component[places] = group.components
            for cell in message_columns(group.message_id):
                text = kinds[cell.name] == "text"
                if cell.name not in self.values:
                    empty: Any = np.full(count, None, dtype=object) if text else np.zeros(count)
                    self.values[cell.name] = (empty, np.ones(count, dtype=np.bool_))
                values, absent = self.values[cell.name]
                values[places] = text_column(group, cell) if text else numeric_column(group, cell)
                absent[places] = False

    def vehicles(self) -> pa.Array:
        """The vehicle id of each row."""
        return pa.array(self.block.owners, pa.string()).take(pa.array(self.block.owner[self.rows]))

    def names(self) -> pa.Array:
        """The message name of each row."""
        return pa.array(self.messages, pa.string()).take(pa.array(self.message))


class OperatorFiles:
    """The CSV file and tlogs of every operator, open for writing; a context manager."""

    def __init__(
        self, folder: Path, manifest: Mapping[str, Any], survey: MessageSurvey, *, with_csv: bool, with_tlogs: bool
    ) -> None:
        """The files of the run with a manifest are created in `folder`. Raises `OSError` if one cannot be."""
        operators = [str(row["id"]) for row in manifest.get("operators") or []]
        self._folder = folder
        self._epoch = epoch_of(manifest)
        self._networks = {str(row["id"]): row.get("network", 0) for row in manifest.get("vehicles") or []}
        self._open_files = ExitStack()
        self._csv: dict[str, IO[bytes]] = {}
        self._cells: dict[str, dict[str, str]] = {}
        self._tlog: dict[tuple[str, int], IO[bytes]] = {}
        names = [
            operator_name
            for operator_name in dict.fromkeys([*operators, *survey.operators])
            if ID_PATTERN.fullmatch(operator_name)
        ]
        if with_csv:
            for operator in names:
                self._open_csv(operator, survey.cells(operator))
            with (folder / "fields.csv").open("w", encoding="utf-8", newline="") as file:
                file.write("message,field,unit\n")
                for (message, name), unit in sorted(survey.units().items()):
                    file.write(f"{message},{name},{unit}\n")
        if with_tlogs:
            networks = [(operator_of(vehicle), network) for vehicle, network in self._networks.items()]
            for operator, network in [*((operator_name, 0) for operator_name in names), *networks]:
                if operator in names:
                    self._open_tlog(operator, network)

    def _open_csv(self, operator: str, cells: dict[str, str]) -> None:
        self._cells[operator] = cells
        self._csv[operator] = self._open_files.enter_context((self._folder / f"{operator}.csv").open("wb"))
        self._csv[operator].write((",".join((*_FIXED, *cells)) + "\n").encode())

    def _open_tlog(self, operator: str, network: int) -> None:
        if (operator, network) not in self._tlog:
            name = f"{operator}.net{network}.tlog" if network else f"{operator}.tlog"
            self._tlog[operator, network] = self._open_files.enter_context((self._folder / name).open("wb"))

    def write_csv(self, block: ReceivedMessages) -> None:
        """Write the received messages to the CSV files."""
        number = block.block.operator[block.rows]
        for place, operator in enumerate(block.block.operators):
            chosen = np.flatnonzero(number == place)
            if operator in self._csv and len(chosen):
                self._write_csv(operator, block, chosen)

    def _write_csv(self, operator: str, block: ReceivedMessages, chosen: Ints) -> None:
        time_ns = block.block.time_ns[block.rows[chosen]]
        bad = block.message[chosen] == 0
        chosen_rows = pa.array(chosen)
        columns: list[pa.Array] = [
            pa.array(np.round(time_ns * 1e-9, 6)),
            pa.array(self._utc(time_ns), pa.string()),
            block.vehicles().take(chosen_rows),
            pa.array(block.system[chosen], mask=bad),
            pa.array(block.component[chosen], mask=bad),
            block.names().take(chosen_rows),
        ]
        plain = True
        for name, kind in self._cells[operator].items():
            if name not in block.values:
                columns.append(pa.nulls(len(chosen), pa.int64()))
                continue
            values, absent = block.values[name]
            if kind == "text":
                column = pa.array(values[chosen].tolist(), pa.string())
                plain = plain and not pc.any(pc.match_substring_regex(column, '[,"\r\n]')).as_py()
            elif kind == "int":
                column = pa.array(np.where(absent[chosen], 0, values[chosen]).astype(np.int64), mask=absent[chosen])
            else:
                column = pa.array(values[chosen], mask=absent[chosen])
            columns.append(column)
        # RFC 4180 section 2: a cell is quoted if it contains a comma, a quote or a line break
        style = "none" if plain else "needed"
        table = pa.Table.from_arrays(columns, names=[str(number) for number in range(len(columns))])
        csv.write_csv(table, self._csv[operator], csv.WriteOptions(include_header=False, quoting_style=style))

    def _utc(self, time_ns: Ints) -> list[str]:
        """ISO 8601 with milliseconds and Z."""
        millis = (time_ns // 1_000 + self._epoch.utc_us(0)) // 1_000
        return [f"{text}Z" for text in np.datetime_as_string(millis.astype("datetime64[ms]")).tolist()]

    def write_tlogs(self, block: StationFrames) -> None:
        """Write the frames sent and received to the tlogs, without bytes that are not a frame."""
        owner = [(operator_of(vehicle), self._networks.get(vehicle, 0)) for vehicle in block.owners]
        for key in set(owner) & set(self._tlog):
            is_own = np.array([owner_key == key for owner_key in owner])[block.owner] & (block.kinds >= 0)
            frames = block.payloads.take(np.flatnonzero(is_own))
            stamps = (block.time_ns[is_own] // 1_000 + self._epoch.utc_us(0)).astype(np.uint64)
            out = np.empty(int(frames.sizes.sum()) + _STAMP_BYTES * len(frames), dtype=np.uint8)
            _interleave(stamps, *frames.arrays, out)
            self._tlog[key].write(out.tobytes())

    def __enter__(self) -> OperatorFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._open_files.close()
