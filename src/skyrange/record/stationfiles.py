"""What files does an operator take home? One CSV of all data received, one tlog of both directions.

The CSV has a row per message and the union of the fields of all its messages as columns, empty where a
message has no such field; `fields.csv` beside it gives every field's unit. A tlog is what QGroundControl,
Mission Planner and MAVProxy write: before each frame, 8 bytes, big endian, microseconds of UTC (QGroundControl
developer guide, "MAVLink log format").
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO

from skyrange.core.ids import ID_PATTERN, operator_of
from skyrange.core.time import Epoch
from skyrange.record.schema import BAD_DATA
from skyrange.record.stations import Seen, Survey

_STAMP = struct.Struct(">Q")
_FIXED = ("time_s", "utc", "vehicle", "system_id", "component_id", "message")


class _Row:
    """How one message's fields become one line: a template and the fields in the columns' order."""

    __slots__ = ("fields", "template", "texts")

    def __init__(self, message: str, own: Sequence[tuple[str, bool]], columns: Sequence[str]) -> None:
        names = {name for name, _ in own}
        self.fields = [column for column in columns if column in names]
        self.texts = [name for name, text in own if text]
        cells = "".join(",%s" if column in names else "," for column in columns)
        self.template = f"%.6f,%s,%s,%s,%s,{message}{cells}\r\n"


class StationFiles:
    """The CSV and tlog of every operator, open for writing; a context manager."""

    def __init__(self, folder: Path, operators: Sequence[str], found: Survey, epoch: Epoch) -> None:
        """Files are `folder/<operator>.csv`, `.tlog` and `folder/fields.csv`; `OSError` where they cannot be made."""
        self._epoch = epoch
        self._open_files = ExitStack()
        self._csv: dict[str, IO[str]] = {}
        self._tlog: dict[str, IO[bytes]] = {}
        self._rows: dict[str, dict[str, _Row]] = {}
        for operator in dict.fromkeys([*operators, *found.operators]):
            if ID_PATTERN.match(operator):
                self._open(folder, operator, found)
        with (folder / "fields.csv").open("w", encoding="utf-8", newline="") as file:
            file.write("message,field,unit\r\n")
            for (message, name), unit in sorted(found.units.items()):
                file.write(f"{message},{name},{_quoted(unit)}\r\n")

    def _open(self, folder: Path, operator: str, found: Survey) -> None:
        columns = [name for name, _ in found.fields([operator])]
        messages = {**found.operators.get(operator, {}), BAD_DATA: []}
        self._rows[operator] = {name: _Row(name, own, columns) for name, own in messages.items()}
        path = folder / f"{operator}.csv"
        self._csv[operator] = self._open_files.enter_context(path.open("w", encoding="utf-8", newline=""))
        self._csv[operator].write(",".join((*_FIXED, *columns)) + "\r\n")
        self._tlog[operator] = self._open_files.enter_context(path.with_suffix(".tlog").open("wb"))

    def received(self, item: Seen, fields: Mapping[str, int | float | str]) -> None:
        """One line of CSV."""
        operator = operator_of(item.vehicle)
        if operator not in self._csv:
            return
        message = item.message
        row = self._rows[operator][BAD_DATA if message is None else message.get_type()]
        values = [fields[name] for name in row.fields]
        if row.texts:
            values = [_quoted(value) if isinstance(value, str) else value for value in values]
        system, component = ("", "") if message is None else (message.get_srcSystem(), message.get_srcComponent())
        stamp = (item.time_ns * 1e-9, self._epoch.iso(item.time_ns), item.vehicle, system, component)
        self._csv[operator].write(row.template % (*stamp, *values))

    def heard(self, item: Seen) -> None:
        """One frame of tlog, sent or received; bytes that are no frame are left out, as its readers would stumble."""
        file = self._tlog.get(operator_of(item.vehicle))
        if file is not None and item.message is not None:
            file.write(_STAMP.pack(self._epoch.utc_us(item.time_ns)) + item.payload)

    def __enter__(self) -> StationFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._open_files.close()


def _quoted(text: str) -> str:
    """A cell by RFC 4180, section 2: quoted where it holds a comma, a quote or a line's end."""
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\r\n') else text
