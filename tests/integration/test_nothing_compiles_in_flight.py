"""Is everything compiled, or loaded, by the time that the clock runs? A kernel more in flight takes up to seconds."""

from __future__ import annotations

import subprocess
import sys

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
