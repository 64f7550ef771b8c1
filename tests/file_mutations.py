"""Mutations of files that a program writes: of what JSON, TOML, Parquet, Arrow streams and lists of words hold, and of
their bytes.

A case is a function of its number alone, so that a failure is repeated by it.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import random
import tomllib
from collections.abc import Iterator
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

DEEP: Final = 100_000
VALUES: Final[tuple[Any, ...]] = (
    None, True, 0, -1, 2.5, 2**53 + 1, 2**70, -(2**200), 1e308, float("nan"), float("inf"), "", "text", "\0", "\ud800",
    "../../etc", "x" * 300, [], {}, [None], [[]], [1, "a"], {"": None}, {"key": [1]},
)  # fmt: skip
"""What stands where something else was."""

Path = tuple[str | int, ...]


def mutate(data: bytes, kind: str, number: int) -> bytes:
    """The bytes of a file of a kind (json, toml, words, parquet, arrows, else bytes) after mutation `number`."""
    chance = random.Random(number)
    if chance.random() < 0.2:
        return _damage_bytes(data, chance, text=kind not in ("parquet", "arrows", "bytes"))
    return _MUTATIONS[kind](data, chance)


def _damage_bytes(data: bytes, chance: random.Random, *, text: bool) -> bytes:
    at = chance.randrange(len(data))
    flipped = bytes([data[at] ^ (1 << chance.randrange(8))])
    ways = [b"", data[:at], data[:at] + flipped + data[at + 1 :],
            data[:at] + b"\xff\xfe" + data[at:], data[:at] + data[: len(data) // 2], b"\0" * 64,
            b"PAR1" * 4]  # fmt: skip
    if text:
        ways += [b"[" * DEEP, b'{"a":' * DEEP, b"a = " + b"[" * DEEP, b"null", b"[]", b"{}", b"0", b'"text"',
                 b"9" * 5_000, b"\xef\xbb\xbf" + data, data + data]  # fmt: skip
    return chance.choice(ways)


def _mutate_json(data: bytes, chance: random.Random) -> bytes:
    document = json.loads(data)
    if chance.random() < 0.1:  # a number that is no number of Python's int, and nesting that no parser follows
        marked = json.dumps(_changed(document, chance, "@@")).encode()
        return marked.replace(b'"@@"', chance.choice([b"9" * 5_000, b"[" * DEEP + b"]" * DEEP, b"1e999"]))
    return json.dumps(_changed(document, chance, chance.choice(VALUES))).encode()


def _mutate_toml(data: bytes, chance: random.Random) -> bytes:
    document = tomllib.loads(data.decode())
    if chance.random() < 0.1:
        marked = tomli_w.dumps(_changed(document, chance, "@@")).encode()
        return marked.replace(b'"@@"', chance.choice([b"9" * 5_000, b"[" * 500 + b"]" * 500, b"1979-13-40", b"1e999"]))
    values = [value for value in VALUES if "None" not in repr(value) and value != "\ud800"]
    return tomli_w.dumps(_changed(document, chance, chance.choice(values))).encode()


def _changed(document: Any, chance: random.Random, value: Any) -> Any:
    """The document with a value at one place, or without it; places of one kind are as likely as a single one."""
    kinds: dict[Path, list[Path]] = {}
    for path in _paths(document):
        kinds.setdefault(tuple("*" if isinstance(key, int) else key for key in path), []).append(path)
    path = chance.choice(kinds[chance.choice(list(kinds))])
    document = copy.deepcopy(document)
    if not path:
        return value if isinstance(value, dict) else {"only": value}
    part: Any = document
    for key in path[:-1]:
        part = part[key]
    way = chance.random()
    if way < 0.2:
        del part[path[-1]]
    elif way < 0.25 and isinstance(part, dict):
        part["unknown"] = part.pop(path[-1])
    elif way < 0.3 and isinstance(part, list):
        part.append(copy.deepcopy(part[-1]))
    else:
        part[path[-1]] = value
    return document


def _paths(part: Any, path: Path = ()) -> Iterator[Path]:
    yield path
    if isinstance(part, dict):
        for key, value in part.items():
            yield from _paths(value, (*path, key))
    elif isinstance(part, list):
        for index, value in enumerate(part):
            yield from _paths(value, (*path, index))


_EXTREMES: Final = (-(2**63), 2**63 - 1, -1, 0)
_NUMBERS: Final = (float("nan"), float("inf"), -1e308, -1.0, 0.0)
_TEXTS: Final = ("", "text", "{", "[1]", "null", "x" * 300, '{"a": NaN}', "9" * 5_000, "[" * 50_000)


def _mutate_parquet(data: bytes, chance: random.Random) -> bytes:
    sink = io.BytesIO()
    pq.write_table(_mutate_table(pq.read_table(io.BytesIO(data)), chance), sink)
    return sink.getvalue()


def _mutate_stream(data: bytes, chance: random.Random) -> bytes:
    with pa.ipc.open_stream(data) as stream:
        batches = []
        with contextlib.suppress(pa.ArrowInvalid):  # the stream of a killed run has no end
            batches += list(stream)
        table = _mutate_table(pa.Table.from_batches(batches, stream.schema), chance)
    sink = io.BytesIO()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


_WORDS: Final = ("-1", "0", "2.5", "1e308", "nan", "inf", "9" * 5_000, "text", "\0", str(2**70), "0x1")


def _mutate_words(data: bytes, chance: random.Random) -> bytes:
    lines = [line.split() for line in data.decode().splitlines()]
    line = chance.choice(lines)
    place = chance.randrange(len(line))
    way = chance.random()
    if way < 0.15:
        del line[place]
    elif way < 0.3:
        lines.insert(chance.randrange(len(lines) + 1), list(line))
    elif way < 0.4:
        lines.remove(line)
    else:
        line[place] = chance.choice(
            ["-1", "0", "2.5", "1e308", "nan", "inf", "9" * 5_000, "text", "\0", str(2**70), "0x1"]
        )
    return "\n".join("\t".join(words) for words in lines).encode()


def _mutate_table(table: pa.Table, chance: random.Random) -> pa.Table:
    way, place = chance.randrange(9), chance.randrange(table.num_columns)
    field, rows = table.schema.field(place), table.num_rows
    if way == 0:
        table = table.remove_column(place)
    elif way == 1:
        table = table.rename_columns([f"{name}_" if k == place else name for k, name in enumerate(table.column_names)])
    elif way == 2:
        other = chance.choice(
            [pa.array(["text"] * rows, pa.string()), pa.array([7] * rows, pa.int64()), pa.array([[1]] * rows),
             pa.array([{"a": 1}] * rows), pa.nulls(rows), pa.array([True] * rows), pa.array([b"\xff"] * rows)]
        )  # fmt: skip
        table = table.set_column(place, field.name, other)
    elif way == 3:
        table = table.set_column(place, pa.field(field.name, field.type), pa.nulls(rows, field.type))
    elif way == 4:
        table = table.slice(0, 0)
    elif way == 5:
        table = pa.concat_tables([table, table])
    elif way == 6:
        table = pa.table({"only": [1]})
    elif way == 7:
        table = table.append_column("more", pa.nulls(rows))
    else:
        table = table.set_column(place, field.with_nullable(True), _extremes(field.type, rows, chance))
    return table


def _extremes(kind: pa.DataType, rows: int, chance: random.Random) -> pa.Array:
    if pa.types.is_floating(kind):
        values: list[Any] = [chance.choice(_NUMBERS)]
    elif pa.types.is_integer(kind):
        width = kind.bit_width if not pa.types.is_signed_integer(kind) else kind.bit_width - 1
        values = [chance.choice([2**width - 1, 0, *([] if width == kind.bit_width else [-(2**width), -1])])]
    elif pa.types.is_string(kind) or pa.types.is_dictionary(kind) or pa.types.is_large_string(kind):
        values = [chance.choice(_TEXTS)]
    else:
        return pa.nulls(rows, kind)
    return pa.array(values * rows, pa.string() if pa.types.is_dictionary(kind) else kind).cast(kind)


def _mutate_bytes(data: bytes, chance: random.Random) -> bytes:
    """Numbers anywhere in a file: some bytes are overwritten, with extremes or at random."""
    changed = bytearray(data)
    for _ in range(chance.choice([1, 3, 30])):
        at = chance.randrange(len(changed))
        size = chance.choice([1, 2, 4, 8])
        changed[at : at + size] = chance.choice([b"\0" * size, b"\xff" * size, b"\x7f" * size, chance.randbytes(size)])
    return bytes(changed)


_MUTATIONS: Final = {
    "json": _mutate_json, "toml": _mutate_toml, "words": _mutate_words, "parquet": _mutate_parquet,
    "arrows": _mutate_stream, "bytes": _mutate_bytes,
}  # fmt: skip
