"""Fixed turns of the builtin against ArduCopter's own arithmetic, written out (ArduCopter/autoyaw.cpp)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.vehicle.builtin.guidance.yaw_target import (
    FLT_EPSILON,
    reached_fixed_yaw_target,
    set_fixed_yaw_target,
    update_yaw_target,
)
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, new_records
from skyrange.vehicle.builtin.parameters.table import SETTINGS

F = np.float32
DT_S = 0.01
SLEW_CDEGPS = 6000.0


class ArduCopter:
    """`set_fixed_yaw_rad` and the case FIXED of `yaw_rad`: floats, but `wrap_PI`, which is of doubles in SITL."""

    def __init__(self, yaw: float) -> None:
        self.yaw, self.offset, self.rate = F(yaw), F(0.0), F(0.0)

    def turn(self, angle: float, rate: float, direction: int) -> None:
        offset = F(math.remainder(float(F(angle) - self.yaw), 2.0 * math.pi))
        if direction < 0 and offset >= F(FLT_EPSILON):
            offset = F(float(offset) - 2.0 * math.pi)
        elif direction > 0 and offset <= -F(FLT_EPSILON):
            offset = F(float(offset) + 2.0 * math.pi)
        self.offset, self.rate = offset, min(F(rate), F(math.radians(SLEW_CDEGPS / 100.0)))

    def step(self) -> None:
        most = F(DT_S) * self.rate
        step = min(max(self.offset, -most), most)
        self.offset, self.yaw = self.offset - step, self.yaw + step


class Builtin:
    """The same of the builtin, with its records."""

    def __init__(self, yaw: float) -> None:
        self.estimate, self.flight = new_records(ESTIMATE, 1), new_records(FLIGHT, 1)
        self.settings = new_records(SETTINGS, 1)
        self.settings["ATC_SLEW_YAW"] = SLEW_CDEGPS
        self.flight["target_yaw"] = 0.5 * math.pi - float(F(yaw))

    def turn(self, angle: float, rate: float, direction: int) -> None:
        set_fixed_yaw_target(self.estimate, self.flight, self.settings, 0, angle, rate, direction, False)

    def step(self) -> None:
        _, yaw, _ = update_yaw_target(self.estimate[0], self.flight[0], DT_S)
        assert -math.pi <= yaw <= math.pi

    @property
    def offset(self) -> float:
        return -float(self.flight["fixed_yaw_offset"][0])

    @property
    def yaw(self) -> float:
        return 0.5 * math.pi - float(self.flight["target_yaw"][0])


@given(
    start=st.floats(-3.125, 3.125, width=32),
    turns=st.lists(
        st.tuples(st.integers(0, 360), st.sampled_from((20, 30, 45)), st.sampled_from((-1, 0, 1))), max_size=3
    ),
    again=st.booleans(),
)
def test_turns_are_arducopters_to_the_bit(start: float, turns: list[tuple[int, int, int]], again: bool) -> None:
    """So a second turn to where the first one led goes round or not as ArduCopter's does."""
    mine, real = Builtin(start), ArduCopter(start)
    for degrees, rate, direction in [*turns, *(turns[-1:] if again else [])]:
        for one in (mine, real):
            one.turn(math.radians(degrees), math.radians(rate), direction)
        assert mine.offset == pytest.approx(float(real.offset), abs=1e-6)
        while real.offset:
            mine.step()
            real.step()
        assert mine.offset == 0.0
        assert mine.yaw == pytest.approx(float(real.yaw), abs=1e-9)


@given(st.floats(-3.0, 3.0), st.floats(-0.49, 0.49), st.sampled_from((-1, 1)))
def test_a_residue_below_single_precision_has_no_direction(angle: float, share: float, direction: int) -> None:
    """The rounding of doubles, of which the real one knows nothing, turns no circle."""
    mine = Builtin(angle)
    mine.flight["target_yaw"] += share * 1e-15
    mine.turn(float(F(angle)), 0.5, direction)
    assert abs(mine.offset) < FLT_EPSILON


@pytest.mark.parametrize("direction", [1, -1])
def test_the_boundary_is_flt_epsilon(direction: int) -> None:
    for residue, circles in ((0.9 * FLT_EPSILON, False), (1.1 * FLT_EPSILON, True)):
        mine = Builtin(direction * residue)
        mine.turn(0.0, 0.5, direction)
        assert (abs(mine.offset) > 6.0) is circles


def test_a_rest_below_flt_epsilon_is_reached_at_once() -> None:
    """In the pass in which the turn begins: ArduCopter then reports the turn and not the item before it."""
    for residue, reached in ((0.9 * FLT_EPSILON, True), (1.1 * FLT_EPSILON, False)):
        mine = Builtin(-residue)
        mine.estimate["yaw"] = mine.flight["target_yaw"]
        mine.turn(0.0, 0.5, 1)
        assert mine.offset != 0.0
        assert reached_fixed_yaw_target(mine.estimate, mine.flight, 0) is reached
