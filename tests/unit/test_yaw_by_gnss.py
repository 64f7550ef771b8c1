"""Yaw from the acceleration by GNSS: what it learns from, and when EKF3's filter is reset with it."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.estimation import yaw_by_gnss
from skyrange.vehicle.builtin.estimation.state import HISTORY_LENGTH, Aiding, EstimatorEvent, new_filters
from skyrange.vehicle.builtin.layout import ESTIMATE, new_records

FIX_NS = NS_PER_S // 5


class Aircraft:
    """One filter, fed with fixes whose velocity is that of the inertial sensors, turned by `yaw_error`."""

    def __init__(self) -> None:
        filters, self.history = new_filters(1)
        self.filter: Any = filters.view(np.recarray)[0]
        self.estimate: Any = new_records(ESTIMATE, 1).view(np.recarray)[0]
        self.filter.sacc_good = 1
        self.filter.spd_acc = 0.3
        self.filter.aiding = int(Aiding.ABSOLUTE)
        self.settings = SimpleNamespace(EK3_VELNE_M_NSE=0.3, EK3_POSNE_M_NSE=0.5)
        self.now = NS_PER_S

    def fly(self, speeds_mps: list[float], yaw_error: float = 0.0, error_mps: float = 0.0) -> None:
        """Fly east with these speeds, one for each fix; the receiver's speed is wrong by `error_mps`."""
        for speed in speeds_mps:
            self.now += FIX_NS
            self.filter.fix_at = self.filter.fix_time = self.now
            self.history[0, :, 3] = speed * math.cos(yaw_error)
            self.history[0, :, 4] = -speed * math.sin(yaw_error)
            self.filter.gnss_vel[:] = (speed + error_mps, 0.0, 0.0)
            fuse = yaw_by_gnss.fuse_velocity.py_func  # type: ignore[attr-defined]
            fuse(self.filter, self.now, self.history, 0, HISTORY_LENGTH, self.now, True)

    def ask(self) -> bool:
        """Ask for a reset; whether it came."""
        self.filter.events = 0
        self.estimate.yaw_reset = 1
        yaw_by_gnss.reset_on_request.py_func(self.estimate, self.filter, self.settings, self.now)  # type: ignore[attr-defined]
        return bool(self.filter.events)


RAMP = [0.5 * step for step in range(13)] + [6.0] * 10


@pytest.mark.parametrize("error_deg", [-25.0, 0.0, 20.0])
def test_a_change_of_speed_shows_the_yaw(error_deg: float) -> None:
    one = Aircraft()
    one.fly(RAMP, math.radians(error_deg))
    assert math.degrees(one.filter.gsf_yaw) == pytest.approx(error_deg, abs=3.0)
    assert math.degrees(math.sqrt(one.filter.gsf_cov[5])) < 15.0


def test_an_aircraft_that_never_left_its_place_has_no_yaw_to_reset_to() -> None:
    one = Aircraft()
    one.fly([0.0] * 100)
    assert math.degrees(math.sqrt(one.filter.gsf_cov[5])) > 30.0
    assert not one.ask()


def test_it_resets_to_the_fix_twice_and_gives_up_the_compass() -> None:
    one = Aircraft()
    one.fly(RAMP)
    assert one.ask()
    assert one.filter.events & int(EstimatorEvent.EMERGENCY_YAW_RESET)
    assert one.filter.compass_failed == 1
    assert one.filter.vel[0] == pytest.approx(6.0)
    assert one.ask()
    assert one.filter.events & int(EstimatorEvent.YAW_ALIGNED_BY_GNSS)
    assert not one.ask()


def test_a_velocity_that_the_acceleration_contradicts_delays_the_reset() -> None:
    one = Aircraft()
    one.fly(RAMP)
    one.fly([6.0], error_mps=5.0)
    assert not one.ask()
    one.fly([6.0] * 10, error_mps=5.0)  # by then the filter follows it
    assert one.filter.gsf_innovation < 2.0
    yaw_by_gnss.reset_on_request.py_func(one.estimate, one.filter, one.settings, one.now)  # type: ignore[attr-defined]
    assert one.filter.events != 0


def test_a_request_is_forgotten_after_five_seconds() -> None:
    one = Aircraft()
    one.fly([0.0] * 5)
    assert not one.ask()
    one.fly(RAMP * 2)
    assert one.filter.gsf_request_at != 0
    yaw_by_gnss.reset_on_request.py_func(one.estimate, one.filter, one.settings, one.now)  # type: ignore[attr-defined]
    assert one.filter.events == 0
    assert one.filter.gsf_request_at == 0
