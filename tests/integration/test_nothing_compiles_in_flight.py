"""Is everything compiled, or loaded, by the time that the clock runs? A kernel more in flight takes up to seconds.

And is all that flights use in the list of kernels that are compiled ahead?
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

WATCHED = """
import sys
from numba.core.dispatcher import Dispatcher
from skyrange.kernel import Kernel
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.shipped import load
from skyrange.assembly.build import build

def known():
    modules = [module for name, module in sys.modules.items() if name.startswith("skyrange")]
    kernels = {id(one): one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)}
    return {
        f"{one.py_func.__module__}.{one.py_func.__qualname__} {types}"
        for one in kernels.values()
        for types in one.signatures
    }

scenario = load(sys.argv[1])
warm_up(scenario)
before = known()
Kernel(build(scenario).wiring).advance(round(float(sys.argv[2]) * 1e9))
print(len(before), *sorted(known() - before), sep="\\n")
"""


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("survey", 185.0), ("crossing", 140.0), ("head-on", 50.0), ("rid-spoofing", 155.0), ("gnss-drift", 80.0)],
)
def test_what_a_flight_needs_is_there_when_it_begins(name: str, seconds: float) -> None:
    command = [sys.executable, "-c", WATCHED, name, str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    known, *late = done.stdout.splitlines()
    assert int(known) > 50
    assert late == []


LISTED = """
import sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from skyrange.runtime.compilation import load_kernels
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly

fly(load(sys.argv[1]), Path(sys.argv[2], "run"), report=True)
modules = [module for name, module in list(sys.modules.items()) if name.startswith("skyrange")]
used = {id(one): one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)}
listed = {(id(one.function), one.arguments) for one in load_kernels()}
for one in used.values():
    for types in one.signatures:
        print((id(one), types) in listed, one.py_func.__module__, one.py_func.__qualname__, types)
"""


@pytest.mark.parametrize("name", ["rid-spoofing", "crossing", "chain", "gnss-pull-off", "squares"])
def test_what_a_flight_uses_is_in_the_list(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-c", LISTED, name, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) > 25
    assert [line for line in lines if line.startswith("False")] == [], "python tools/record_kernels.py makes it anew"
