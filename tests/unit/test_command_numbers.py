"""Numbers of commands as whole numbers: what an ArduPilot on x86 reads where a float does not fit."""

from __future__ import annotations

import math

import pytest

from skyrange.vehicle.builtin.commands.command import int32, uint8, uint32


@pytest.mark.parametrize(
    ("value", "byte"),
    [
        (81.9, 81),
        (300.0, 44),
        (-1.0, 255),
        (3e38, 0),
        (-3e38, 0),
        (math.inf, 0),
        (-math.inf, 0),
        (math.nan, 0),
        (1e-40, 0),
    ],
)
def test_a_byte_is_the_lowest_of_a_signed_number_of_32_bits(value: float, byte: int) -> None:
    """cvttss2si gives 0x80000000 where a float does not fit, so DO_SET_MODE with such a base mode is denied."""
    assert uint8(value) == byte


def test_numbers_of_32_bits_that_do_not_fit() -> None:
    assert [int32(value) for value in (3e38, -3e38, math.nan)] == [-(2**31)] * 3
    assert [uint32(value) for value in (3e38, -3e38, math.nan, -1.0)] == [2**32 - 1] * 4
