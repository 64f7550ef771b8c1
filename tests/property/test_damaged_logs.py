"""Logs that are damaged: an `InputError`, or a flight of what can be read."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.flightlog import read_log, split_flights
from skyrange.flightlog.conversion import convert_flight
from tests.file_mutations import mutate
from tests.tiers import examples, is_fuzzing
from tests.written_logs import hop, write_dataflash, write_tlog, write_ulog

WRITERS: dict[str, Callable[..., Path]] = {"a.tlog": write_tlog, "a.BIN": write_dataflash, "a.ulg": write_ulog}


@cache
def contents(name: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        WRITERS[name](path, hop(20.0, 2.0))
        return path.read_bytes()


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=100 if is_fuzzing() else examples(30), derandomize=not is_fuzzing(), deadline=None)
@given(number=st.integers(0, 2**32 - 1))
def test_a_damaged_log_is_refused_or_read(name: str, number: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(mutate(contents(name), "bytes", crc32(f"{name} {number}".encode())))
        with contextlib.suppress(InputError):
            for flight in split_flights(read_log(path)):
                convert_flight(flight, "x").write(Path(folder, str(flight.number)))
