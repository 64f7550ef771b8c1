"""The list of kernels that flights use, made anew: `python tools/record_kernels.py`.

The script flies every shipped scenario, the rehearsal and a pair, with their reports, and writes all kernels that the
cache then has for this version. It takes some minutes. Kernels that only tests use are in the list if the tests ran
before in this checkout. Before it, remove the folder `src/skyrange/__pycache__/kernels`, which may have kernels that
are no longer used.
"""

from __future__ import annotations

import importlib
import pkgutil
import tempfile
from pathlib import Path

from numba.core.dispatcher import Dispatcher
from pydantic import JsonValue

import skyrange
from skyrange.core.compiled import find_cached
from skyrange.runtime.compilation import KERNELS, describe_arguments, name_function, write_list
from skyrange.runtime.warm_up import REHEARSAL
from skyrange.scenario.shipped import DEFENCE_EXAMPLES, EXAMPLES, FAULT_EXAMPLES, SHIPPED, load
from skyrange.study.execution.flight import fly_runs
from skyrange.study.execution.plan import PlannedRun
from skyrange.study.pairing import pair


def fly_scenarios() -> None:
    """Fly what uses as many kernels as possible, with reports."""
    names = [str(REHEARSAL), *SHIPPED, *EXAMPLES, *FAULT_EXAMPLES, *DEFENCE_EXAMPLES]
    with tempfile.TemporaryDirectory() as folder:
        flights = [PlannedRun(str(number), load(name), report=True) for number, name in enumerate(names)]
        for number, error in fly_runs(flights, Path(folder)).errors.items():
            print(f"{names[int(number)]}: {error}")
        pair(load("rid-spoofing"), Path(folder, "pair"))


def find_functions() -> list[Dispatcher]:
    """All compiled functions of the package."""
    found: set[Dispatcher] = set()
    for module in pkgutil.walk_packages(skyrange.__path__, "skyrange."):
        found |= {one for one in vars(importlib.import_module(module.name)).values() if isinstance(one, Dispatcher)}
    return sorted(found, key=name_function)


def describe_cached() -> dict[str, list[list[JsonValue]]]:
    """The kernels in the cache, by function; those without a description are printed and left out."""
    listed: dict[str, list[list[JsonValue]]] = {}
    for function in find_functions():
        for arguments in find_cached(function):
            try:
                listed.setdefault(name_function(function), []).append(describe_arguments(arguments))
            except TypeError as error:
                print(f"left out: {name_function(function)}: {error}")
    return listed


if __name__ == "__main__":
    fly_scenarios()
    listed = describe_cached()
    write_list(listed)
    print(f"{sum(map(len, listed.values()))} kernels of {len(listed)} functions: {KERNELS}")
