"""Files that skyrange or its users wrote, damaged in some place: readers raise an error of skyrange, or go on.

`tests.written_files.FILES` has each kind of file with its readers; a new kind belongs there.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from skyrange.core.errors import SkyrangeError
from tests.file_mutations import mutate
from tests.processor_time import CLOCK
from tests.tiers import examples, is_fuzzing
from tests.written_files import FILES, call, make_files

pytestmark = [pytest.mark.rotating, pytest.mark.filterwarnings("ignore")]

_KINDS = {
    ".json": "json", ".geojson": "json", ".plan": "json", ".toml": "toml", ".waypoints": "words",
    ".parquet": "parquet", ".arrows": "arrows",
}  # fmt: skip
_MOST = 12
"""Examples of the profile `full` for each file."""


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files, made where they are read: plans name their scenarios by whole paths."""
    folder = tmp_path_factory.mktemp("damaged") / "work"
    with CLOCK.timed("shared"):
        make_files(folder)
    return folder


@pytest.mark.parametrize("name", FILES)
@settings(
    max_examples=100 if is_fuzzing() else examples(_MOST),
    derandomize=not is_fuzzing(),
    phases=set(Phase) - {Phase.shrink, Phase.explain},
)
@given(number=st.integers(0, 2**32 - 1))
def test_what_reads_a_damaged_file_says_so(name: str, work: Path, number: int) -> None:
    """Each of these files ended in a `KeyError`, a `TypeError` or an error of Arrow for some of its mutations."""
    file = FILES[name]
    path = next(work.glob(file.path.replace("SPLIT", "*")))
    data = path.read_bytes()
    number = crc32(f"{name} {number}".encode())  # hypothesis tries small numbers first, and the same for all files
    reader = file.read[number % len(file.read)]
    try:
        path.write_bytes(mutate(data, _KINDS[path.suffix], number))
        with contextlib.suppress(SkyrangeError):  # as of missions that failed, by a file that says so
            call(reader, work)
    finally:
        path.write_bytes(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_whole_files_are_read(name: str, work: Path) -> None:
    for reader in FILES[name].read:
        call(reader, work)
