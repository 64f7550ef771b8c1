"""How fast does simulated time pass? As fast as it can, or held to a multiple of wall time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import cast

from skyrange.agent.contracts import Engine, WallEngine
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, NS_PER_US, Time, to_seconds


def held_to(speed: float, engines: Sequence[Engine]) -> float:
    """The speed at which a `Pace` has to hold a run that is asked for `speed`: 0 where an engine does so itself.

    Where engines on the wall clock are there of which none waits, it is theirs.

    `InputError` where two of those on the wall clock, or one and `speed`, contradict each other.
    """
    found = {engine.name: cast("WallEngine", engine).pace for engine in engines if engine.clock == "wall"}
    if speed != 0.0:
        found["--speed"] = speed
    if len(set(found.values())) > 1:
        told = ", ".join(f"{name} {pace:g}" for name, pace in found.items())
        hint = "Programs that run on the machine's clock set the pace: leave --speed out."
        raise InputError.one("speed", "value", told, "one speed", hint)
    walls = [engine for engine in engines if engine.clock == "wall"]
    if not walls:
        return speed
    return 0.0 if any(engine.waits for engine in walls) else cast("WallEngine", walls[0]).pace


class Pace:
    """Holds a run to `speed` simulated seconds per wall second; 0 is as fast as it goes.

    The kernel is the same either way: pacing only waits between its instants. When the run falls
    behind it is not skipped ahead; `lag_s` says by how much it was behind at most.
    """

    FREE_STEP_NS = 100 * NS_PER_MS
    """How much an unpaced run advances between looks at Ctrl-C and the progress bar."""
    PACED_STEP_NS = 10 * NS_PER_MS
    """The grain of a paced run, in simulated time at speed 1."""

    def __init__(
        self, speed: float, *, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        """`speed` is finite and 0 or more; `InputError` for another."""
        if not 0.0 <= speed < math.inf:
            raise InputError.one("speed", "value", str(speed), "a number of 0 or more, 0 being as fast as it goes")
        self._speed = speed
        self._clock = clock
        self._sleep = sleep
        self._began: tuple[float, Time] | None = None
        self.lag_s = 0.0
        """The most the run was behind the wall clock, in wall seconds."""

    @property
    def held(self) -> bool:
        """Whether there is anything to wait for."""
        return self._speed > 0.0

    @property
    def step_ns(self) -> Time:
        """How far to advance the kernel before the next `wait`."""
        if self._speed <= 0.0:
            return self.FREE_STEP_NS
        return min(max(int(self.PACED_STEP_NS * self._speed), NS_PER_US), NS_PER_S)

    def wait(self, now: Time) -> None:
        """Wait until the wall clock has reached what `now` should be at."""
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
