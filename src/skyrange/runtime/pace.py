"""Pace of simulated time: as fast as possible, or a multiple of wall time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import cast

from skyrange.contracts.components import Engine, WallEngine
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US, Time, to_seconds


def resolve_speed(speed: float, engines: Sequence[Engine]) -> float:
    """The speed to which a `Pace` has to hold a run that is asked for `speed`; 0 if an engine does so itself.

    If no engine on the wall clock waits, the speed is theirs.

    Raises `InputError` if two engines on the wall clock, or one and `speed`, contradict each other.
    """
    paces = {engine.name: cast("WallEngine", engine).pace for engine in engines if engine.clock == "wall"}
    if speed != 0.0:
        paces["--speed"] = speed
    if len(set(paces.values())) > 1:
        named = ", ".join(f"{name} {pace:g}" for name, pace in paces.items())
        hint = "Programs that run on the machine's clock set the pace: leave --speed out."
        raise InputError.one("speed", "value", named, "one speed", hint)
    walls = [engine for engine in engines if engine.clock == "wall"]
    if not walls:
        return speed
    return 0.0 if any(engine.paces_itself for engine in walls) else cast("WallEngine", walls[0]).pace


class Pace:
    """Holds a run to `speed` simulated seconds per wall second; 0 is as fast as possible.

    The kernel is the same either way: pacing only waits between its instants. A run that falls behind is not skipped
    ahead; `lag_s` is its largest delay.
    """

    MIN_SPEED = 1e-6
    """Slowest speed: a step of 1 µs then takes a second."""
    FREE_STEP_NS = 100 * NS_PER_MS
    """Simulated time between two checks of Ctrl-C and the progress bar in an unpaced run."""
    PACED_STEP_NS = 10 * NS_PER_MS
    """The step of a paced run, in simulated time at speed 1."""

    def __init__(
        self, speed: float, *, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        """`speed` is 0, or finite and at least `MIN_SPEED`; raises `InputError` for any other."""
        self.change(speed)
        self._clock = clock
        self._sleep = sleep
        self.lag_s = 0.0
        """The largest delay behind the wall clock, in wall seconds."""

    def change(self, speed: float) -> None:
        """Hold to another speed from the next `wait` on, or to the same one without the time lost before."""
        if not (speed == 0.0 or self.MIN_SPEED <= speed < math.inf):
            expected = f"0, which is as fast as it goes, or at least {self.MIN_SPEED:g}"
            raise InputError.one("speed", "value", str(speed), expected)
        self._speed = speed
        self._began: tuple[float, Time] | None = None

    @property
    def speed(self) -> float:
        """Simulated seconds per wall second; 0 is as fast as possible."""
        return self._speed

    @property
    def held(self) -> bool:
        """Whether the run is held to the wall clock."""
        return self._speed > 0.0

    @property
    def step_ns(self) -> Time:
        """Simulated time by which to advance the kernel before the next `wait`."""
        if self._speed <= 0.0:
            return self.FREE_STEP_NS
        return min(max(int(self.PACED_STEP_NS * self._speed), NS_PER_US), NS_PER_S)

    def wait(self, now: Time) -> None:
        """Wait until the wall clock has reached the time at which `now` is due."""
        if self._speed <= 0.0:
            return
        if self._began is None:
            self._began = (self._clock(), now)
        wall, simulated = self._began
        ahead_s = to_seconds(now - simulated) / self._speed - (self._clock() - wall)
        if ahead_s > 0.0:
            self._sleep(ahead_s)
        else:
            self.lag_s = max(self.lag_s, -ahead_s)
