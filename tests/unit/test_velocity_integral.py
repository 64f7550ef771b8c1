"""Integral of the velocity error while the lean is limited (AC_PID_2D::update_i)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin.control.position import integrate_velocity_error

DT_S = 0.01


def integrated(vel_i: tuple[float, float], error: tuple[float, float], limited: tuple[float, float]) -> np.ndarray:
    more = error[0] * DT_S, error[1] * DT_S
    return np.asarray(integrate_velocity_error(*vel_i, *more, *limited, 10.0))


def test_it_grows_where_nothing_is_limited() -> None:
    assert integrated((1.0, 0.0), (100.0, 0.0), (0.0, 0.0)) == pytest.approx([2.0, 0.0])


def test_it_turns_but_does_not_grow_towards_the_limit() -> None:
    found = integrated((1.0, 0.0), (0.0, 100.0), (0.0, 8.0))
    assert math.hypot(*found) == pytest.approx(1.0)
    assert found == pytest.approx([math.sqrt(0.5), math.sqrt(0.5)])


def test_it_shrinks_towards_the_limit() -> None:
    assert integrated((1.0, 0.0), (-50.0, 0.0), (-8.0, 0.0)) == pytest.approx([0.5, 0.0])
