"""Is the list of kernels that of this version, and does filling the cache compile all that flights use, once?"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core import types as numba_types
from numba.core.typing import typeof as numba_typeof

from skyrange.city.wall_index import WallIndex
from skyrange.cli.output import progress
from skyrange.core.compiled import find_callees
from skyrange.runtime import compilation
from skyrange.runtime.compilation import (
    KERNELS,
    describe_arguments,
    load_kernels,
    read_list,
    rebuild_kernel,
    write_list,
)

pytestmark = pytest.mark.rotating

types: Any = numba_types  # numba has no annotations
typeof: Any = numba_typeof.typeof
RECORD = np.dtype({"names": ["a", "b"], "formats": ["int8", "float64"], "offsets": [0, 4], "itemsize": 16})

# what two processes compile of a list; the folder of the cache and the list are arguments
FILL = """
import json, sys
from pathlib import Path
from skyrange.core import compiled
from skyrange.runtime import compilation
compiled.cache_folder = compilation.cache_folder = lambda: sys.argv[1]
compilation.KERNELS = Path(sys.argv[2])
steps, cold = [], compilation.is_cold()
compiled_now = compilation.fill_cache(2, lambda *step: steps.append(step))
found = {"cold": cold, "compiled": compiled_now, "steps": steps, "cold after": compilation.is_cold()}
print(json.dumps(found | {"counts": compilation.count_kernels()}))
"""
CALL = """
import json, sys
import numpy as np
from skyrange.core import compiled
compiled.cache_folder = lambda: sys.argv[1]
from skyrange.core.chance import philox, uniform4
uniform4(*np.ones(5, dtype=np.uint64))
print(json.dumps([sum(one.stats.cache_misses.values()) for one in (philox, uniform4)]))
"""
CHANCE = "skyrange.core.chance"
UINT64 = "uint64"


def run(program: str, *words: object) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, words)], stdout=subprocess.PIPE, text=True, timeout=300, check=True
    )
    return json.loads(done.stdout)


def write_kernels(path: Path, listed: dict[str, Any]) -> Path:
    path.write_text(json.dumps(listed))
    return path


@pytest.mark.parametrize(
    "kinds",
    [
        (types.float64, types.int32, types.boolean, types.uint8, types.complex128),
        (types.Array(types.float64, 2, "C"), types.Array(types.int8, 1, "A", readonly=True, aligned=False)),
        (types.UniTuple(types.float64, 3), types.Tuple((types.int64, types.Array(types.bool_, 1, "F")))),
        (types.literal(3), types.literal(True)),
        (typeof(np.zeros(1, RECORD)), typeof(np.zeros(1, RECORD)[0])),
        (types.NestedArray(types.float64, (3, 2)),),
        (types.BaseTuple.from_types((types.float64,) * len(WallIndex._fields), WallIndex),),
        (),
    ],
)
def test_types_are_the_same_when_rebuilt(kinds: tuple[Any, ...]) -> None:
    signature = json.loads(json.dumps(describe_arguments(kinds)))
    kernel = rebuild_kernel(f"{CHANCE}:philox", signature)
    assert kernel is not None
    assert kernel.arguments == kinds


def test_a_type_without_description_is_not_written() -> None:
    with pytest.raises(TypeError, match="has no description"):
        describe_arguments((types.ListType(types.float64),))


def test_every_entry_of_the_list_is_of_this_version() -> None:
    listed = {(name, json.dumps(one)) for name, signatures in read_list().items() for one in signatures}
    found = {(one.name, json.dumps(one.signature)) for one in load_kernels()}
    assert listed - found == set(), "make the list anew: python tools/record_kernels.py"
    assert len(found) > 400
    for kernel in load_kernels():
        assert len(kernel.arguments) == kernel.function.py_func.__code__.co_argcount, kernel.name


def test_the_list_is_written_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed, text = read_list(), KERNELS.read_bytes()
    monkeypatch.setattr("skyrange.runtime.compilation.KERNELS", tmp_path / "kernels.json")
    write_list(listed)
    assert (tmp_path / "kernels.json").read_bytes() == text


def test_callees_are_compiled_before_callers_and_a_circle_ends() -> None:
    functions = list(dict.fromkeys(one.function for one in load_kernels()))
    sorter, lengths = compilation._sort(functions)
    assert set(lengths) == set(functions)
    done: set[Any] = set()
    while sorter.is_active():
        for function in sorter.get_ready():
            called = set(find_callees(function)).intersection(functions) - {function}
            assert called <= done
            assert all(lengths[callee] > lengths[function] for callee in called)
            done.add(function)
            sorter.done(function)
    assert done == set(functions)

    names: dict[str, Any] = {"__name__": "circle"}
    text = (
        "@compiled\ndef even(n):\n    return n == 0 or odd(n - 1)\n@compiled\ndef odd(n):\n    return n and even(n - 1)"
    )
    exec(f"from skyrange.core.compiled import compiled\n{text}", names)
    sorter, _ = compilation._sort([names["even"], names["odd"]])
    first = sorter.get_ready()
    sorter.done(*first)
    assert {*first, *sorter.get_ready()} == {names["even"], names["odd"]}


def test_filling_compiles_all_once_and_leaves_out_what_is_not_there(tmp_path: Path) -> None:
    folder = tmp_path / "kernels"
    folder.mkdir()
    kernels: dict[str, list[Any]] = {
        f"{CHANCE}:uniform4": [[UINT64] * 5],
        f"{CHANCE}:philox": [[UINT64] * 6],
        f"{CHANCE}:_mulhi": [[UINT64] * 2],
    }
    kernels[f"{CHANCE}:philox"].append([{"tuple": [UINT64], "named": f"{CHANCE}:Removed"}])
    old: dict[str, Any] = {f"{CHANCE}:removed": [[]], "skyrange.removed:philox": [[]], "os:getpid": [[]]}
    listed = write_kernels(tmp_path / "kernels.json", kernels | old)
    found = run(FILL, folder, listed)
    assert (found["cold"], found["compiled"]) == (True, 3)
    assert found["steps"] == [[0, 3], [1, 3], [2, 3], [3, 3]]
    assert (found["cold after"], found["counts"]) == (False, [3, 3])
    assert len(list(folder.glob("*.nbc"))) == 3
    assert run(FILL, folder, listed) == {
        "cold": False,
        "compiled": 0,
        "steps": [],
        "cold after": False,
        "counts": [3, 3],
    }
    assert run(CALL, folder) == [0, 0]


def test_a_kernel_that_does_not_compile_does_not_end_the_rest(tmp_path: Path) -> None:
    folder = tmp_path / "kernels"
    folder.mkdir()
    kernels = {f"{CHANCE}:_mulhi": [[UINT64] * 2, [UINT64], [{"array": UINT64, "ndim": 1, "layout": "C"}, "bool"]]}
    found = run(FILL, folder, write_kernels(tmp_path / "kernels.json", kernels))
    assert (found["compiled"], found["steps"][-1], found["counts"]) == (1, [3, 3], [1, 3])


def test_commands_compile_what_is_missing_if_most_is(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def fill(jobs: int | None, on_kernel: compilation.OnKernel | None) -> int:
        for done in range(3):
            if on_kernel is not None:
                on_kernel(done, 2)
        return 2

    monkeypatch.setattr(compilation, "fill_cache", fill)
    monkeypatch.setattr(compilation, "is_cold", lambda: False)
    progress.compile_if_cold(quiet=False)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(compilation, "is_cold", lambda: True)
    progress.compile_if_cold(quiet=False)
    assert capsys.readouterr().err == "".join(f"compiling: {done} of 2 kernels\n" for done in range(3))
    progress.compile_if_cold(quiet=True)
    assert capsys.readouterr().err == ""


def test_without_a_folder_nothing_is_compiled_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "cache_folder", lambda: "")
    assert not compilation.is_cold()
    assert compilation.fill_cache() == 0
