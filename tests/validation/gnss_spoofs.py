"""Settings of false GNSS and ArduCopter's reactions to them, to be flown by any autopilot of the range.

Measured on ArduCopter V4.7.0-dev (ArduPilot 2598e9d4), simulated over its JSON backend at 800 steps a second with a
quad of SIM_Frame's formulas and ideal inertial sensors, GNSS by GPS_INPUT at 5 Hz, 12 satellites, GPS1_DELAY_MS 1, all
parameters of the estimator and the failsafes as shipped but EK3_YAW_M_NSE 0.05 (it shortens the warm-up). The aircraft
hovers 20 m above its start in GUIDED, 15 s after take-off. Times are in seconds after the first false fix; flags and
ratios were read from EKF_STATUS_REPORT at 20 Hz, resets from jumps of GLOBAL_POSITION_INT.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

SECONDS: Final = 40.0
"""How long each is flown."""
TIME_S: Final = 0.3
"""Tolerance of times: one interval of the fixes, 0.2 s, and one of the checks at 10 Hz that follow."""
RATIO: Final = 0.05
"""Tolerance of ratios, absolute, and relative where they are above 1."""
MOVED: Final = 0.05
"""Tolerance of distances, relative, and 0.5 m."""
RESET: Final = 0.1
"""Tolerance of what a reset moves, relative: ten seconds of dead reckoning lie in it."""

FINE: Final = (0.4, 0.6, 0.2)
USUAL: Final = (1.5, 2.5, 0.2)
"""What the receiver claims: horizontal m, vertical m, speed m/s. USUAL is what the range's own receivers say."""
EAST, UP = 0, 2


@dataclass(frozen=True)
class Reaction:
    """What was seen. `None` is never; ratios are the largest, as EKF_STATUS_REPORT gives them (1 is the gate)."""

    moved_m: float | None
    """How far the true aircraft went in all, along the axis of the lie; `None`: not compared."""
    pos_ratio: float
    vel_ratio: float
    glitch_s: float | None = None
    cleared_s: float | None = None
    resets: Mapping[float, float] = field(default_factory=dict)
    """When belief was reset, and by how many metres."""
    land_s: float | None = None
    """When the failsafe of the estimator changed to LAND."""


@dataclass(frozen=True)
class Spoof:
    """One setting: a kind of attack and its parameters (without `vehicles`), and the reaction."""

    name: str
    kind: str
    params: Mapping[str, Any]
    accuracy: tuple[float, float, float]
    seen: Reaction
    axis: int = EAST
    at_place: bool = False
    """Whether the aircraft was sent to a place of the map; otherwise it holds where it is after take-off."""


def _jump(east_m: float, accuracy: tuple[float, float, float], seen: Reaction, at_place: bool = False) -> Spoof:
    name = f"jump {east_m:g} m, claimed {accuracy[0]:g} m" + (", at a place" if at_place else "")
    return Spoof(name, "gnss.jump", {"offset_m": [east_m, 0.0, 0.0]}, accuracy, seen, at_place=at_place)


def _drift(mps: float, velocity: str, accuracy: tuple[float, float, float], seen: Reaction, axis: int = EAST) -> Spoof:
    rate = [0.0, 0.0, 0.0]
    rate[axis] = mps
    name = f"drift {mps:g} m/s {'up' if axis == UP else 'east'}, {velocity} velocity, claimed {accuracy[0]:g} m"
    return Spoof(name, "gnss.drift", {"rate_mps": rate, "velocity": velocity}, accuracy, seen, axis)


SPOOFS: Final = (
    # inside the gate, five standard deviations of what is claimed and believed: fused at once
    _jump(3.5, FINE, Reaction(-3.5, 0.94, 0.20)),
    # outside, until belief has become as unsure as that: fused then
    _jump(4.0, FINE, Reaction(-4.0, 1.07, 0.19, glitch_s=1.25, cleared_s=12.65)),
    _jump(4.5, FINE, Reaction(-4.5, 1.21, 0.11, glitch_s=1.25, cleared_s=17.45)),
    # beyond: reset after posRetryTimeUseVel_ms
    _jump(5.0, FINE, Reaction(0.0, 1.34, 0.01, 1.25, 20.05, {9.95: 5.0})),
    _jump(30.0, FINE, Reaction(0.0, 8.03, 0.01, 1.25, 20.05, {9.95: 30.0})),
    _jump(30.0, FINE, Reaction(-30.0, 8.03, 0.01, 1.25, 20.25, {9.95: 30.0}), at_place=True),
    _drift(1.0, "unaltered", FINE, Reaction(-37.7, 0.43, 0.21)),
    _drift(2.0, "unaltered", FINE, Reaction(-75.3, 0.85, 0.43)),
    _drift(3.0, "unaltered", FINE, Reaction(-14.8, 6.94, 0.27, 3.45, None, {12.15: 33.0, 25.15: 33.0, 38.15: 33.0})),
    _drift(3.0, "consistent", FINE, Reaction(-119.4, 0.60, 1.11)),
    # the velocity's gate, and twice FS_EKF_THRESH; how far it goes while it lands blind depends on its drag
    _drift(5.0, "consistent", FINE, Reaction(None, 2.66, 1.84, 1.25, 21.45, {11.15: 13.6}, land_s=1.12)),
    _jump(10.0, USUAL, Reaction(-10.0, 0.92, 0.12)),
    _jump(11.0, USUAL, Reaction(-11.0, 1.02, 0.10, glitch_s=1.25, cleared_s=14.85)),
    _jump(12.0, USUAL, Reaction(0.0, 1.11, 0.01, 1.25, 20.05, {9.95: 12.0})),
    _jump(30.0, USUAL, Reaction(-30.0, 2.77, 0.01, 1.25, 20.25, {9.95: 30.0}), at_place=True),
    _drift(1.0, "unaltered", USUAL, Reaction(-33.9, 0.47, 0.05)),
    _drift(3.0, "unaltered", USUAL, Reaction(-30.2, 3.59, 0.18, 7.65, None, {16.35: 40.2, 35.55: 40.3})),
    _drift(4.0, "unaltered", USUAL, Reaction(-32.6, 4.42, 0.16, 5.25, None, {13.95: 50.3, 30.15: 50.3})),
    _drift(6.0, "unaltered", USUAL, Reaction(-25.6, 6.21, 0.10, 3.45, None, {12.15: 69.7, 25.95: 69.8, 39.75: 69.8})),
    _drift(2.0, "consistent", USUAL, Reaction(-79.6, 0.01, 0.73)),
    _drift(3.0, "consistent", USUAL, Reaction(-119.4, 0.36, 1.10, glitch_s=1.25, cleared_s=11.85)),
    _drift(4.0, "consistent", USUAL, Reaction(-159.2, 0.60, 1.46, glitch_s=1.25, cleared_s=12.85)),
    _drift(6.0, "consistent", USUAL, Reaction(None, 0.90, 2.19, 1.25, 13.85, land_s=1.02)),
    # height is the barometer's: GNSS height alone does nothing, a false climb rate does
    Spoof("jump 30 m up", "gnss.jump", {"offset_m": [0.0, 0.0, 30.0]}, USUAL, Reaction(0.0, 0.0, 0.01), UP),
    _drift(1.0, "unaltered", USUAL, Reaction(0.0, 0.0, 0.01), UP),
    _drift(1.0, "consistent", USUAL, Reaction(-2.7, 0.0, 0.36), UP),
    _drift(3.0, "consistent", USUAL, Reaction(-8.1, 0.01, 1.09, glitch_s=1.25, cleared_s=13.45), UP),
)
