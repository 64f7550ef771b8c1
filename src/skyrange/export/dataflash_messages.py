"""Messages of DataFlash logs: their fields, types, units and multipliers, and the bytes that define them in a log.

A log defines its own messages: FMT has the type and name of each field, FMTU its unit and multiplier, which UNIT and
MULT spell out (ArduPilot, libraries/AP_Logger/LogStructure.h and AP_Logger/README.md). `dataflash_messages.toml` has
the messages that are written here. The number of a message is free: a log's FMT says it, but for FMT, which is 128.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.files import read_package_text

HEAD: Final = (0xA3, 0x95)
"""HEAD_BYTE1 and HEAD_BYTE2 before each message."""
FMT_NUMBER: Final = 128
"""LOG_FORMAT_MSG."""

_TYPES: Final = {
    "b": "i1", "B": "u1", "M": "u1", "h": "<i2", "c": "<i2", "H": "<u2", "C": "<u2", "i": "<i4", "e": "<i4", "L": "<i4",
    "I": "<u4", "E": "<u4", "q": "<i8", "Q": "<u8", "f": "<f4", "d": "<f8", "n": "S4", "N": "S16", "Z": "S64",
}  # fmt: skip
"""NumPy's types of the characters of a format (LogStructure.h, "Format characters")."""

Records = NDArray[Any]
"""A structured array with the whole bytes of messages of one kind, one for each row."""


@dataclass(frozen=True)
class Definition:
    """One message: strings with one character for each field, and the names of the fields."""

    name: str
    number: int
    format: str
    labels: tuple[str, ...]
    units: str
    multipliers: str
    source: str
    """The library of ArduPilot whose LogStructure.h defines it; empty for one of our own."""

    @cached_property
    def layout(self) -> np.dtype[Any]:
        """The bytes of a message: the two head bytes and the number as `head`, then the fields."""
        fields = [(label, _TYPES[kind]) for label, kind in zip(self.labels, self.format, strict=True)]
        return np.dtype([("head", "u1", (3,)), *fields])

    def records(self, count: int) -> Records:
        """Messages whose fields are zero."""
        made = np.zeros(count, dtype=self.layout)
        made["head"] = (*HEAD, self.number)
        return made

    def encode(self, *values: Any) -> bytes:
        """One message of these values, as they are stored."""
        made = self.records(1)
        for label, value in zip(self.labels, values, strict=True):
            made[label] = value
        return made.tobytes()


_READ: Final = tomllib.loads(read_package_text(__file__, "dataflash_messages.toml"))


UNITS: Final[Mapping[str, str]] = _READ["units"]
"""By their ids."""
MULTIPLIERS: Final[Mapping[str, float]] = _READ["multipliers"]
"""By their ids."""


def _define_messages(tables: Mapping[str, Mapping[str, str]]) -> dict[str, Definition]:
    return {
        name: Definition(
            name, FMT_NUMBER + place, table["format"], tuple(table["labels"].split(",")), table["units"],
            table["multipliers"], table["source"],
        )
        for place, (name, table) in enumerate(tables.items())
    }  # fmt: skip


DEFINITIONS: Final[Mapping[str, Definition]] = _define_messages(_READ["messages"])
"""By name; FMT is the first."""


def encode_definitions(names: Sequence[str]) -> bytes:
    """The messages with which a log begins: FMT of `names` and of what defines them, then UNIT, MULT and FMTU."""
    fmt, unit, mult, fmtu = (DEFINITIONS[name] for name in ("FMT", "UNIT", "MULT", "FMTU"))
    defined = [fmt, unit, mult, fmtu, *(DEFINITIONS[name] for name in names)]
    return b"".join(
        [
            *(
                fmt.encode(each.number, each.layout.itemsize, each.name, each.format, ",".join(each.labels))
                for each in defined
            ),
            *(unit.encode(0, ord(mark), text) for mark, text in UNITS.items()),
            *(mult.encode(0, ord(mark), value) for mark, value in MULTIPLIERS.items()),
            *(fmtu.encode(0, each.number, each.units, each.multipliers) for each in defined),
        ]
    )
