"""Are the loops over lanes compiled to vector instructions? A call or a branch in one would undo it unnoticed."""

from __future__ import annotations

import re
from typing import Any

import numba
import pytest

from skyrange.vehicle.builtin.control import (
    motor_control,
    position,
)
from skyrange.vehicle.builtin.estimation import strapdown
from skyrange.world import multirotor

pytestmark = pytest.mark.rotating

LANES, NUMBER = numba.float64[::1], numba.float64
LOOPS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "motion": (multirotor._move_lanes, (NUMBER, LANES)),
    "rotors": (multirotor.spin_rotors, (LANES,) * 6),
    "strapdown": (strapdown._integrate_lanes, (LANES, NUMBER)),
    "position": (position._request_attitude, (LANES,)),
    "attitude targets": (position._shape_rates, (LANES,)),
    "errors of attitude": (motor_control._find_errors, (LANES, NUMBER)),
    "motors": (motor_control._command_motors, (LANES,)),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_loop_over_lanes_is_vectorised(name: str) -> None:
    function, signature = LOOPS[name]
    compiled: Any = numba.njit(fastmath=False, error_model="numpy")(function.py_func)
    compiled.compile(signature)
    code = compiled.inspect_llvm(signature)
    assert re.search(r"= fmul <\d+ x double>", code)
    assert not re.search(r"fmuladd|@llvm\.fma|f(add|sub|mul|div) (fast|reassoc|contract|arcp)", code)
