"""A run in progress is read as it grows: every row once, in the order recorded, wherever the spool keeps it."""

from __future__ import annotations

import random
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import InputError
from skyrange.record import Recorder, load
from skyrange.record.read.growth import GrowingRun, GrowingSegment
from skyrange.record.spool import SPOOL, Spool

HEADER = {"name": "growth", "vehicles": [], "links": []}


def spooled(tmp: Path, sizes: list[int]) -> tuple[bytes, list[str]]:
    """The bytes of a segment of batches of names, whose dictionary grows, and the names."""
    (tmp / SPOOL).mkdir(parents=True)
    spool, names, known = Spool(tmp), list[str](), list[str]()
    for size in sizes:
        known += [f"n{len(known) + k}" for k in range(size % 3)] or (["first"] if not known else [])
        numbers = [k % len(known) for k in range(size)]
        column = pa.DictionaryArray.from_arrays(pa.array(numbers, pa.int32()), pa.array(known, pa.string()))
        spool.append("names", pa.record_batch([column], names=["name"]))
        names += [known[number] for number in numbers]
    spool.end_segment()
    return (tmp / SPOOL / "names-0000.arrows").read_bytes(), names


@given(st.lists(st.integers(0, 5), min_size=1, max_size=6), st.lists(st.integers(1, 400), max_size=20), st.booleans())
def test_a_segment_that_is_cut_anywhere_gives_its_whole_batches_and_later_the_rest(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], steps: list[int], damaged: bool
) -> None:
    tmp = tmp_path_factory.mktemp("segment")
    data, names = spooled(tmp / "whole", sizes)
    path = tmp / "growing.arrows"
    path.touch()
    segment, found, at = GrowingSegment(path), list[str](), 0
    for step in [*steps, len(data)]:
        with path.open("ab") as file:
            part = data[at : at + step]
            file.write(part[::-1] if damaged and at else part)
        at += step
        found += [name for batch in segment.read() for name in batch.column("name").to_pylist()]
    segment.close()
    if damaged:
        assert found == names[: len(found)]
    else:
        assert found == names
        assert segment.ended


def test_a_column_whose_name_is_no_text_ends_a_segment(tmp_path: Path) -> None:
    data, _ = spooled(tmp_path, [3])
    path = tmp_path / "growing.arrows"
    path.write_bytes(data.replace(b"name", b"na\xffe"))
    segment = GrowingSegment(path)
    assert segment.read() == []
    assert segment.ended
    segment.close()


def test_a_column_whose_name_is_no_text_is_damage_of_a_killed_run(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER, part_rows=7)
    recorder.on_note(1, "someone", Note("event.mode", "blue/b1", {}))
    recorder.flush()
    (path,) = (tmp_path / "run" / SPOOL).glob("events-*.arrows")
    path.write_bytes(path.read_bytes().replace(b"about", b"ab\xffut"))
    with pytest.raises(InputError, match="events"):
        load(tmp_path / "run").table("events")


def test_a_name_that_is_no_text_is_damage_of_a_run(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    recorder.on_note(1, "someone", Note("event.mode", "blue/b1", {}))
    recorder.close()
    (path,) = (tmp_path / "run").glob("events*.parquet")
    table = pq.read_table(path)
    place = table.schema.get_field_index("about")
    damaged = pa.array([b"bl\xffe"]).view(pa.string()).dictionary_encode()
    pq.write_table(table.set_column(place, "about", damaged), path)
    for encoded in (True, False):
        with pytest.raises(InputError, match="UTF"):
            list(load(tmp_path / "run").tables.batches("events", encoded=encoded))


@pytest.mark.parametrize("seed", range(4))
def test_rows_are_read_once_from_segments_and_from_the_parts_that_replace_them(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    recorder = Recorder.open(tmp_path / "run", HEADER, part_rows=7)
    growing, found = GrowingRun(tmp_path / "run"), list[int]()

    def add(table: str, batch: pa.RecordBatch, _recorder: int) -> None:
        if table == "events":
            found.extend(batch.column("time_ns").to_pylist())

    for number in range(120):
        recorder.on_note(number, "someone", Note("event.mode", "blue/b1", {}))
        if chance.random() < 0.3:
            recorder.flush()
        if chance.random() < 0.05:
            growing.read(add)
    recorder.flush()
    growing.read(add)
    assert found == list(range(120))
    assert growing.read(add) == 0
    recorder.close()
    assert load(tmp_path / "run").rows("events") == 120
