"""Files that skyrange or its users wrote, damaged in some place: whatever reads them raises `InputError`, or goes on.

`tests.written_files.FILES` has each kind of file with its readers; a new kind belongs there.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from zlib import crc32

import pytest

from skyrange.core.errors import InputError
from tests.file_mutations import mutate
from tests.flights import shared_folder
from tests.written_files import FILES, call, make_files

pytestmark = [pytest.mark.rotating, pytest.mark.filterwarnings("ignore")]

_KINDS = {".json": "json", ".geojson": "json", ".toml": "toml", ".parquet": "parquet"}
_QUICK = 3
_MANY = 120


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("damaged") / "work"
    shutil.copytree(shared_folder("written-files", make_files), folder)
    yield folder
    shutil.rmtree(folder)


def _read_damaged(name: str, work: Path, numbers: range, *, all_readers: bool) -> list[str]:
    """What other readers than one with `InputError` raise for a file after some mutations."""
    file = FILES[name]
    path = next(work.glob(file.path.replace("SPLIT", "*")))
    data, found = path.read_bytes(), []
    try:
        for number in numbers:
            damaged = mutate(data, _KINDS[path.suffix], crc32(f"{name} {number}".encode()))
            readers = file.read if all_readers else [file.read[number % len(file.read)]]
            for reader in readers:
                path.write_bytes(damaged)
                try:
                    call(reader, work)
                except InputError:
                    pass
                except Exception as error:
                    found.append(f"{name}, number {number}, {reader}: {error!r}")
    finally:
        path.write_bytes(data)
    return found


@pytest.mark.parametrize("name", FILES)
def test_what_reads_a_damaged_file_says_so(name: str, work: Path) -> None:
    """Each of these files ended in a `KeyError`, a `TypeError` or an error of Arrow for some of its mutations."""
    assert _read_damaged(name, work, range(_QUICK), all_readers=False) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_what_reads_a_file_that_is_damaged_in_many_ways_says_so(name: str, work: Path) -> None:
    assert _read_damaged(name, work, range(_QUICK, _MANY), all_readers=True) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_whole_files_are_read(name: str, work: Path) -> None:
    for reader in FILES[name].read:
        call(reader, work)
