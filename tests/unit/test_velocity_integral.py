"""Integral of the velocity error while the lean is limited (AC_PID_2D::update_i)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin.control.position import _update_vel_i

DT_S = 0.01


class Record:
    """Fields by name."""

    def __init__(self, **fields: object) -> None:
        self.__dict__.update(fields)


def integrated(vel_i: tuple[float, float], error: tuple[float, float], limited: tuple[float, float]) -> np.ndarray:
    flight = Record(vel_i=np.array(vel_i), vel_err=np.array(error), limited_accel=np.array(limited))
    _update_vel_i.py_func(flight, Record(vel_i=1.0, vel_imax=10.0), DT_S)
    return np.asarray(flight.vel_i)


def test_it_grows_where_nothing_is_limited() -> None:
    assert integrated((1.0, 0.0), (100.0, 0.0), (0.0, 0.0)) == pytest.approx([2.0, 0.0])


def test_it_turns_but_does_not_grow_towards_the_limit() -> None:
    found = integrated((1.0, 0.0), (0.0, 100.0), (0.0, 8.0))
    assert math.hypot(*found) == pytest.approx(1.0)
    assert found == pytest.approx([math.sqrt(0.5), math.sqrt(0.5)])


def test_it_shrinks_towards_the_limit() -> None:
    assert integrated((1.0, 0.0), (-50.0, 0.0), (-8.0, 0.0)) == pytest.approx([0.5, 0.0])
