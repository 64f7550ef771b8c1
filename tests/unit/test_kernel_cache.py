"""Do processes that compile and load kernels side by side each run the code of what they call?"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

# one kernel for two types of arrays: code made for neighbouring numbers reads wrong ones of every second
KERNEL = """
import json, sys, time
import numpy as np
from skyrange.core import compiled
compiled._cache_folder = lambda: sys.argv[1]

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


def started(folder: Path, text: str, *words: str) -> subprocess.Popen[str]:
    """Runs `text` with the kernel of a file: what has no file is not kept."""
    command = [sys.executable, "-c", "from a_kernel import *\n" + text, str(folder), *words]
    return subprocess.Popen(command, cwd=folder.parent, stdout=subprocess.PIPE, text=True)


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


def test_two_that_compile_at_once_leave_both_signatures(folder: Path) -> None:
    program = SLOWLY + "calls(NEIGHBOURS if sys.argv[2] == 'a' else EVERY_SECOND)"
    a, b = started(folder, program, "a"), started(folder, program, "b")
    assert [ended(a)["results"], ended(b)["results"]] == [RIGHT[:1], RIGHT[1:]]
    assert ended(started(folder, BOTH)) == {"results": RIGHT, "found": 2, "compiled": 0}
