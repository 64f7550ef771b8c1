"""File of a loss table: one Parquet file with a row for each transmitter place, and its provenance in the metadata.

Columns: `east_m`, `north_m`, `up_m` (float64) of the place, and `loss_db`, a list of float32 over the points of the
grid, heights slowest and east fastest, not-a-number where there is no value. The key `skyrange.loss_table` of the
schema's metadata holds the `LossTableHeader` as JSON. The file has no date, so equal maps are equal bytes.
"""

from __future__ import annotations

import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, parse_json, read_input
from skyrange.radio.propagation.loss_table import LossGrid, LossTable, loss_table

VERSION: Final = 1
MAX_BYTES: Final = 512 * MIB
MAX_PLACES: Final = 1_000
MAX_AWAY_M: Final = 1e6
"""How far from the origin a place may be in each direction."""
MAX_VALUES: Final = 256 * MIB
"""Most losses in one table: 1 GiB of them."""
BAND_MHZ: Final = (2_400.0, 2_483.5)
"""The 2.4 GHz ISM band, in which the medium transmits."""
_KEY: Final = b"skyrange.loss_table"
_SCHEMA: Final = pa.schema(
    [
        pa.field("east_m", pa.float64(), nullable=False),
        pa.field("north_m", pa.float64(), nullable=False),
        pa.field("up_m", pa.float64(), nullable=False),
        pa.field("loss_db", pa.list_(pa.field("item", pa.float32(), nullable=False)), nullable=False),
    ]
)

_Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e7, le=1e7)]
_Length = Annotated[float, Field(allow_inf_nan=False, ge=1, le=1e6)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class GridHeader(_Part):
    """The grid of receivers; see `LossGrid`."""

    west_m: _Finite
    south_m: _Finite
    spacing_m: _Length
    columns: Annotated[int, Field(ge=1, le=100_000)]
    rows: Annotated[int, Field(ge=1, le=100_000)]
    heights_m: Annotated[tuple[_Finite, ...], Field(min_length=1, max_length=100)]

    @model_validator(mode="after")
    def _ascending(self) -> GridHeader:
        if any(high <= low for low, high in zip(self.heights_m, self.heights_m[1:], strict=False)):
            raise ValueError("heights must ascend")
        return self

    @property
    def grid(self) -> LossGrid:
        """The grid as kernels take it."""
        return LossGrid(self.west_m, self.south_m, self.spacing_m, self.columns, self.rows, self.heights_m)


class LossTableHeader(_Part):
    """Provenance and geometry of a table."""

    version: Literal[1] = VERSION
    skyrange: Annotated[str, Field(max_length=100)]
    """Version of skyrange that wrote it."""
    tracer: Annotated[dict[str, Any], Field(max_length=50)]
    """Name, version and settings of the ray tracer."""
    buildings: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """`City.digest` of the buildings."""
    frequency_mhz: Annotated[float, Field(gt=0, le=1e6)]
    reach_m: _Length
    reach_up_m: _Length
    grid: GridHeader


@dataclass(frozen=True, slots=True)
class LossTableFile:
    """The content of a file: `places_enu_m` (t, 3) and `loss_db` (t, heights, rows, columns)."""

    header: LossTableHeader
    places_enu_m: NDArray[np.float64]
    loss_db: NDArray[np.float32]

    @property
    def table(self) -> LossTable:
        """The table as kernels take it."""
        header = self.header
        return loss_table(
            self.places_enu_m, self.loss_db, header.grid.grid, header.frequency_mhz, header.reach_m, header.reach_up_m
        )


def encode_loss_table(content: LossTableFile) -> bytes:
    """The bytes of the file; the same for the same content and version of Arrow."""
    flat = content.loss_db.reshape(len(content.places_enu_m), -1)
    starts = np.arange(len(flat) + 1, dtype=np.int32) * flat.shape[1]
    losses = pa.ListArray.from_arrays(pa.array(starts), pa.array(np.ascontiguousarray(flat).ravel()))
    columns = [*(pa.array(content.places_enu_m[:, k]) for k in range(3)), losses.cast(_SCHEMA.field("loss_db").type)]
    described = json.dumps(content.header.model_dump(mode="json"), sort_keys=True).encode()
    table = pa.Table.from_arrays(columns, schema=_SCHEMA.with_metadata({_KEY: described}))
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", use_dictionary=False, row_group_size=64)
    return sink.getvalue()


def write_loss_table(path: Path, content: LossTableFile) -> None:
    """Write the file, whole or not at all. Raises `OSError` if it cannot be written."""
    with atomic_write(path) as file:
        file.write(encode_loss_table(content))


def read_loss_table(path: Path, who: str = "loss table") -> LossTableFile:
    """Read a file. Raises `InputError` if it is missing, damaged, too large, or no loss table of this version."""
    return decode_loss_table(read_input(path, who, max_bytes=MAX_BYTES, expected="a loss table"), who, str(path))


def decode_loss_table(data: bytes, who: str = "loss table", where: str = "file") -> LossTableFile:
    """The content of a file's bytes; raises `InputError` as `read_loss_table`."""
    hint = "Make it anew: `skyrange radio map`."
    try:
        file = pq.ParquetFile(pa.BufferReader(data))
        described = (file.schema_arrow.metadata or {}).get(_KEY)
        if described is None or [field.name for field in file.schema_arrow] != _SCHEMA.names:
            raise InputError.one(who, where, "another Parquet file", "a loss table of skyrange", hint)
        header = _header(described, who, where)
        grid = header.grid.grid
        values = math.prod(grid.shape)
        sizes = sum(file.metadata.row_group(g).total_byte_size for g in range(file.metadata.num_row_groups))
        if not 1 <= file.metadata.num_rows <= MAX_PLACES or file.metadata.num_rows * values > MAX_VALUES:
            raise InputError.one(who, where, f"{file.metadata.num_rows} places", f"1 to {MAX_PLACES} places", hint)
        if sizes > 8 * file.metadata.num_rows * (values + 64) + MIB:
            raise InputError.one(who, where, f"{sizes} bytes", "the losses of its grid", hint)
        table = file.read().cast(_SCHEMA)
        places = np.stack([table.column(k).to_numpy() for k in range(3)], axis=1).astype(np.float64)
        losses = table.column("loss_db").combine_chunks()
        lengths = losses.value_lengths().to_numpy(zero_copy_only=False)
        flat = losses.flatten().to_numpy(zero_copy_only=False).astype(np.float32)
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise InputError.one(who, where, _first_line(error), "an undamaged loss table", hint) from None
    if (lengths != values).any():
        raise InputError.one(who, where, "rows of other lengths", f"{values} losses for each place", hint)
    if not (np.abs(places) <= MAX_AWAY_M).all() or (np.abs(flat[~np.isnan(flat)]) > 1_000.0).any():
        raise InputError.one(who, where, "a number out of range", "finite places, and losses in dB", hint)
    return LossTableFile(header, places, flat.reshape(len(places), *grid.shape))


def _header(described: bytes, who: str, where: str) -> LossTableHeader:
    header = parse_json(described, who, where)
    version = header.get("version") if isinstance(header, dict) else None
    if version != VERSION:
        hint = "Make it anew with this version of skyrange: `skyrange radio map`."
        raise InputError.one(who, where, f"version {version!r}", f"a loss table of version {VERSION}", hint)
    try:
        return LossTableHeader.model_validate(header)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        raise InputError.one(who, where, f"{name}: {first['msg']}", "the header of a loss table") from None


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
