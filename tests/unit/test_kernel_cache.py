"""Do processes that compile and load kernels side by side each run the code of what they call?"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numba
import pytest

from skyrange.core.compiled import compiled

pytestmark = pytest.mark.rotating

# one kernel for two types of arrays: code made for neighbouring numbers reads wrong ones of every second
KERNEL = """
import json, sys, time
import numpy as np
from skyrange.core import compiled
compiled.cache_folder = lambda: sys.argv[1]

@compiled.compiled
def total(values):
    amount = 0.0
    for index in range(values.shape[0]):
        amount += values[index]
    return amount

NEIGHBOURS, EVERY_SECOND = np.arange(10.0), np.arange(20.0)[::2]
def calls(*arguments):
    for _ in range(3):
        results = [float(total(one)) for one in arguments]
    found, compiled_anew = (sum(counts.values()) for counts in (total.stats.cache_hits, total.stats.cache_misses))
    print(json.dumps({"results": results, "found": found, "compiled": compiled_anew}))
"""
BOTH = "calls(NEIGHBOURS, EVERY_SECOND)"
RIGHT = [45.0, 90.0]

# between reading its index and writing it back, a process waits until the other one has read it too; that one is kept
# from it by a lock, or will never come
SLOWLY = """
from pathlib import Path
from numba.core.caching import IndexDataCacheFile
at_once = IndexDataCacheFile._save_index
def slowly(self, overloads):
    Path(sys.argv[1], "read-" + sys.argv[2]).touch()
    for _ in range(400):
        if len(list(Path(sys.argv[1]).glob("read-*"))) == 2:
            break
        time.sleep(0.01)
    at_once(self, overloads)
IndexDataCacheFile._save_index = slowly
"""


# two functions of one file, and a third of another file that calls one of them
PAIR = """
import json, sys
from skyrange.core import compiled
compiled.cache_folder = lambda: sys.argv[1]
import second
@compiled.compiled
def once(x):
    return x + 1
@compiled.compiled
def twice(x):
    return x * 2
def calls():
    functions = once, twice, second.caller
    results = [one(10) for one in functions]
    print(json.dumps({"results": results, "compiled": [sum(one.stats.cache_misses.values()) for one in functions]}))
"""
SECOND = """
from skyrange.core import compiled
LIMIT = 5
@compiled.inlined
def callee(x):
    return x - 3
@compiled.compiled
def caller(x):
    return callee(x) + LIMIT
"""


def started(folder: Path, text: str, *words: str) -> subprocess.Popen[str]:
    """Runs `text` with the kernels of a file."""
    return started_in(folder.parent, folder, text, *words)


def started_in(place: Path, folder: Path, text: str, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", "from a_kernel import *\n" + text, str(folder), *words]
    # Python's own cache would not notice an edit within a second that leaves the length of a file
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(command, cwd=place, env=environment, stdout=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen[str]) -> Any:
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return json.loads(out)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "kernels"
    path.mkdir()
    (tmp_path / "a_kernel.py").write_text(KERNEL)
    return path


@pytest.mark.slow
def test_what_was_compiled_once_is_found(folder: Path) -> None:
    assert ended(started(folder, BOTH)) == {"results": RIGHT, "found": 0, "compiled": 2}
    assert ended(started(folder, BOTH)) == {"results": RIGHT, "found": 2, "compiled": 0}


def test_code_under_anothers_name_is_not_run_and_is_put_right(folder: Path) -> None:
    ended(started(folder, BOTH))
    first, second = sorted(folder.rglob("*.nbc"))
    texts = first.read_bytes(), second.read_bytes()
    first.write_bytes(texts[1])
    second.write_bytes(texts[0])
    assert ended(started(folder, "calls(EVERY_SECOND, NEIGHBOURS)"))["results"] == RIGHT[::-1]
    assert ended(started(folder, BOTH)) == {"results": RIGHT, "found": 2, "compiled": 0}


@pytest.mark.slow
def test_two_that_compile_at_once_leave_both_signatures(folder: Path) -> None:
    program = SLOWLY + "calls(NEIGHBOURS if sys.argv[2] == 'a' else EVERY_SECOND)"
    a, b = started(folder, program, "a"), started(folder, program, "b")
    assert [ended(a)["results"], ended(b)["results"]] == [RIGHT[:1], RIGHT[1:]]
    assert ended(started(folder, BOTH)) == {"results": RIGHT, "found": 2, "compiled": 0}


def write_pair(place: Path, **edits: tuple[str, str]) -> Path:
    """Writes both files into a folder, in each of which one text may be replaced."""
    place.mkdir(exist_ok=True)
    for name, text in (("a_kernel", PAIR), ("second", SECOND)):
        old, new = edits.get(name, (text, text))
        assert old in text
        (place / f"{name}.py").write_text(text.replace(old, new))
    return place / "kernels"


@pytest.mark.slow
def test_one_change_compiles_one_function_of_a_file(tmp_path: Path) -> None:
    folder = write_pair(tmp_path)
    assert ended(started(folder, "calls()")) == {"results": [11, 20, 12], "compiled": [1, 1, 1]}
    write_pair(tmp_path, a_kernel=("x + 1", "x + 2"))
    assert ended(started(folder, "calls()")) == {"results": [12, 20, 12], "compiled": [1, 0, 0]}
    write_pair(tmp_path)
    assert ended(started(folder, "calls()")) == {"results": [11, 20, 12], "compiled": [0, 0, 0]}


@pytest.mark.parametrize(
    ("old", "new", "result"),
    [pytest.param("x - 3", "x - 4", 11, marks=pytest.mark.slow), ("LIMIT = 5", "LIMIT = 6", 13)],
)
def test_a_change_in_another_file_is_not_missed(tmp_path: Path, old: str, new: str, result: int) -> None:
    folder = write_pair(tmp_path)
    ended(started(folder, "calls()"))
    write_pair(tmp_path, second=(old, new))
    assert ended(started(folder, "calls()")) == {"results": [11, 20, result], "compiled": [0, 0, 1]}


@pytest.mark.slow
def test_another_place_and_time_of_the_files_compile_nothing(tmp_path: Path) -> None:
    folder = write_pair(tmp_path / "one")
    ended(started(folder, "calls()"))
    moved = write_pair(tmp_path / "other")
    os.utime(moved.parent / "a_kernel.py", (1e9, 1e9))
    folder.rename(moved)
    assert ended(started(moved, "calls()")) == {"results": [11, 20, 12], "compiled": [0, 0, 0]}


@pytest.mark.slow
def test_two_versions_at_once_share_a_folder(tmp_path: Path) -> None:
    write_pair(tmp_path / "old")
    write_pair(tmp_path / "new", a_kernel=("x + 1", "x + 2"), second=("x - 3", "x - 4"))
    folder = tmp_path / "kernels"
    expected = {"old": [11, 20, 12], "new": [12, 20, 11]}

    for _ in range(2):
        processes = {name: started_in(tmp_path / name, folder, "calls()") for name in expected}
        done = {name: ended(process) for name, process in processes.items()}
        assert {name: one["results"] for name, one in done.items()} == expected
    assert [one["compiled"] for one in done.values()] == [[0, 0, 0]] * 2


@pytest.mark.slow
def test_an_edit_after_the_import_does_not_change_the_name(tmp_path: Path) -> None:
    folder = write_pair(tmp_path)
    edit = "Path('a_kernel.py').write_text(Path('a_kernel.py').read_text().replace('x + 1', 'x + 2'))"
    ended(started(folder, f"from pathlib import Path\n{edit}\ncalls()"))
    assert ended(started(folder, "calls()")) == {"results": [12, 20, 12], "compiled": [1, 0, 0]}


@pytest.mark.slow
def test_what_was_compiled_with_a_replaced_value_is_not_kept(tmp_path: Path) -> None:
    folder = write_pair(tmp_path)
    replaced = "second.caller._cache._impl\nsecond.LIMIT = 7\ncalls()"
    assert ended(started(folder, replaced)) == {"results": [11, 20, 14], "compiled": [1, 1, 1]}
    assert ended(started(folder, "calls()")) == {"results": [11, 20, 12], "compiled": [0, 0, 1]}


@pytest.mark.slow
def test_unused_versions_are_removed_when_another_is_kept(tmp_path: Path) -> None:
    folder = write_pair(tmp_path)
    ended(started(folder, "calls()"))
    (old,) = folder.glob("a_kernel.once-*.nbi")
    (recent,) = folder.glob("a_kernel.twice-*.nbi")
    earlier = tmp_path / "kernels-0123"
    earlier.mkdir()
    for path in (old, earlier):
        os.utime(path, (1e9, 1e9))
    ended(started(folder, "calls()"))  # used
    write_pair(tmp_path, a_kernel=("x + 1", "x + 2"))
    ended(started(folder, "calls()"))
    assert old.exists()
    assert not earlier.exists()
    os.utime(old, (1e9, 1e9))
    write_pair(tmp_path, a_kernel=("x + 1", "x + 3"))
    ended(started(folder, "calls()"))
    assert recent.exists()
    assert len(list(folder.glob("a_kernel.once-*.nbi"))) == len(list(folder.glob("a_kernel.once-*.nbc"))) == 2
    assert not old.exists()


def test_a_named_tuple_with_its_fields_in_another_order_is_another_type() -> None:
    """Both have the same class name and types, by which alone numba would find the code of the other."""

    class Pair(NamedTuple):
        first: float
        second: float

    class Turned(NamedTuple):
        second: float
        first: float

    @compiled
    def difference(pair: Any) -> float:
        less: float = pair.first - pair.second
        return less

    codegen = difference.targetctx.codegen()  # type: ignore[attr-defined]

    def key(*arguments: Any) -> Any:
        types = tuple(numba.typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]
        return difference._cache._index_key(types, codegen)[2]  # type: ignore[attr-defined]

    assert key(Pair(1.0, 2.0)) != key(Turned(2.0, 1.0))
    assert key((0, (Pair(1.0, 2.0),))) != key((0, (Turned(2.0, 1.0),)))
    assert key(Pair(1.0, 2.0)) == key(Pair(3.0, 4.0))
    assert key(1.0) == key(2.0)
