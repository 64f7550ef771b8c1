"""Pacing waits, never skips; interruption is obeyed between instants."""

from __future__ import annotations

import math
import os
import signal

import pytest

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.pace import Pace


class Wall:
    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def test_unpaced_never_waits() -> None:
    wall = Wall()
    pace = Pace(0.0, clock=wall.clock, sleep=wall.sleep)
    for second in range(5):
        pace.wait(second * NS_PER_S)
    assert wall.slept == []


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_paced_runs_at_its_speed(speed: float) -> None:
    wall = Wall()
    pace = Pace(speed, clock=wall.clock, sleep=wall.sleep)
    for step in range(101):
        wall.now += 0.001 / speed  # the kernel's own time
        pace.wait(step * 10 * NS_PER_MS)
    assert wall.now - 100.0 == pytest.approx(1.0 / speed, rel=0.01)
    assert pace.lag_s == pytest.approx(0.0, abs=0.002)


def test_falling_behind_is_reported_not_skipped() -> None:
    wall = Wall()
    pace = Pace(1.0, clock=wall.clock, sleep=wall.sleep)
    pace.wait(0)
    wall.now += 3.0
    pace.wait(1 * NS_PER_S)
    assert wall.slept == []
    assert pace.lag_s == pytest.approx(2.0)


@pytest.mark.parametrize("speed", [-1.0, math.inf, math.nan])
def test_what_is_no_speed_is_refused(speed: float) -> None:
    with pytest.raises(InputError, match=f"speed: value: {speed} — expected 0, which is as fast as it goes"):
        Pace(speed)


def test_the_first_signal_is_noted_and_the_second_raises() -> None:
    before = signal.getsignal(signal.SIGINT)
    with Interruptible() as interrupt:
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    with Interruptible() as interrupt:
        os.kill(os.getpid(), signal.SIGTERM)
        assert interrupt.requested


@pytest.mark.parametrize("speed", [0.0001, 0.01, 0.5, 1.0, 30.0, 1000.0])
def test_a_paced_run_is_between_steps_twenty_times_a_second_at_least(speed: float) -> None:
    assert 0 < Pace(speed).step_ns / speed <= NS_PER_S / 20
