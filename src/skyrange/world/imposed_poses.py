"""Imposed poses: motion of bodies whose pose an engine reports, extrapolated by velocity between reports.

A pose holds for the tick at which it was imposed; the next tick takes the body to where its velocity brings it from
there. So a body moves only within a tick, and its path is swept like any other: it passes through nothing, and
sensors, collisions and radio see the same motion. Programs report their pose at 10 to 50 Hz: a held pose would lag 1 m
at 10 m/s; extrapolated by its velocity, with an unknown acceleration of 5 m/s² for 100 ms, it errs by 25 mm. After
`CARRY_S` without another report the body stops in the air: its position is unknown, and straight extrapolation would
soon leave the city.

The pose of a simulator (`Poses.at_next_tick`) is the end of the next tick already, and is not extrapolated. Its body
has the world's rotors and battery, so a crash stops its motors.

The specific force is that of the change of velocity between the last two poses. The body stands on the floor below it
if its gear is within `STAND_M`; it touches down and breaks by the same rules as a body that the world moves
(`multirotor`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Poses
from skyrange.core.compiled import compiled
from skyrange.world import multirotor
from skyrange.world.airframes import GRAVITY_MPS2
from skyrange.world.body_state import BodyState, Floats, Ints, Marks
from skyrange.world.collision.broad_phase import NEAR_M
from skyrange.world.multirotor import (
    ALOFT,
    BROKEN,
    CRASHED,
    EVENTS,
    JUMPED,
    MAX_TOUCHDOWN_MPS,
    ON_GROUND,
    TIPPED,
    TOUCHED,
)

CARRY_S = 0.25
"""Longest extrapolation by velocity: two poses missed at 10 Hz."""
JUMP_M = 0.5 * NEAR_M
"""A pose farther away than this is a jump, not motion (a simulator was reset, or silent for long): nothing on the way
is hit. The list of near pairs is valid only for ticks in which two aircraft come at most `NEAR_M` closer."""
STAND_M = 0.02
"""Gear this close to the ground counts as standing: ArduPilot reports heights in whole centimetres."""
MAX_M = 1e6
"""Limit of a coordinate; a pose beyond it results from wrong units or a wrong origin, as do values beyond the next
two."""
MAX_MPS = 1e3
MAX_RADPS = 1e3
_MAX_STEP_M = 1.0  # after a longer step another floor may be below
_UNIT = 0.01  # how far from 1 a quaternion's length may be

_POSITION, _VELOCITY, _ATTITUDE, _RATES, _CHANGE, _NUMBERS = 0, 3, 6, 10, 13, 16
"""Columns of the table of poses; CHANGE is the change of velocity since the previous pose, per second."""
_FINE, _NOT_IMPOSED, _BAD_POSITION, _BAD_VELOCITY, _BAD_ATTITUDE, _BAD_RATES = range(6)
_WRONG = {
    _BAD_POSITION: ("position_enu_m", f"finite metres, at most {MAX_M:g}"),
    _BAD_VELOCITY: ("vel_enu_mps", f"finite m/s, at most {MAX_MPS:g}"),
    _BAD_ATTITUDE: ("attitude", f"a quaternion of length 1, to {_UNIT:g}"),
    _BAD_RATES: ("rates_radps", f"finite rad/s, at most {MAX_RADPS:g}"),
}


class _Given(NamedTuple):
    """Poses as an engine reports them, of k bodies."""

    fresh: NDArray[np.bool_]
    position: Floats
    velocity: Floats
    attitude: Floats
    rates: Floats


class Reported(NamedTuple):
    """The last reported poses of n bodies."""

    poses: Floats
    """(n, 16): the table of poses."""
    pending: Marks
    """(n,) 1 where a pose waits."""
    since: Ints
    """(n,) ticks since the last one."""
    final: Marks
    """(n,) 1 where the pose is that at the end of the quantum."""
    jump_m: Floats
    """(n,) distance of the last jump."""


class ImposedPoses:
    """The imposed poses of a world's n bodies. Deep copies continue alike."""

    def __init__(self, is_imposed: Marks, step_s: float) -> None:
        """`is_imposed` is the bodies' own (n,), which `set_imposed` writes."""
        count = len(is_imposed)
        self._step_s = step_s
        self._is_imposed = is_imposed
        self.rows: Ints = np.zeros(0, dtype=np.int64)
        """The rows whose pose is imposed."""
        self._reported = Reported(
            poses=np.zeros((count, _NUMBERS)),
            pending=np.zeros(count, dtype=np.uint8),
            since=np.zeros(count, dtype=np.int64),
            final=np.zeros(count, dtype=np.uint8),
            jump_m=np.zeros(count),
        )

    @property
    def jump_m(self) -> Floats:
        """(n,) distance of the last jump."""
        return self._reported.jump_m

    def set_imposed(self, rows: Ints, is_imposed: int, velocity: Floats) -> None:
        """Set whether the poses of some bodies are imposed from now on: 0, `IMPOSED` or `SIMULATED`.

        `velocity` (n, 3) is that of all bodies now.
        """
        self._is_imposed[rows] = is_imposed
        self.rows = np.flatnonzero(self._is_imposed)
        reported = self._reported
        reported.pending[rows] = 0
        reported.since[rows] = 0
        reported.poses[rows] = 0.0
        reported.poses[rows, _VELOCITY:_ATTITUDE] = velocity[rows]

    def accept(self, rows: Ints, poses: Poses, vehicles: Sequence[str]) -> None:
        """Keep the fresh poses for the next tick. Raises `ValueError` for an invalid pose, and then takes none."""
        fresh = np.ascontiguousarray(poses.fresh, dtype=np.bool_)
        arrays = (poses.position_enu_m, poses.vel_enu_mps, poses.attitude, poses.rates_radps)
        given = _Given(fresh, *(np.ascontiguousarray(array, dtype=np.float64) for array in arrays))
        shapes = [array.shape for array in given]
        wanted = [(len(rows),), *((len(rows), width) for width in (3, 3, 4, 3))]
        if shapes != wanted:
            raise ValueError(f"imposed poses of the shapes {shapes}, expected {wanted}")
        row, wrong = _find_invalid(rows, self._is_imposed, given)
        if wrong == _NOT_IMPOSED:
            raise ValueError(f"imposed a pose on {vehicles[rows[row]]}, which the world moves")
        if wrong != _FINE:
            what, expected = _WRONG[wrong]
            raise ValueError(
                f"imposed on {vehicles[rows[row]]} the {what} {given[1 + wrong - _BAD_POSITION][row].tolist()}, "
                f"expected {expected}"
            )
        _accept(self._step_s, rows, given, self._reported)
        self._reported.final[rows] = poses.at_next_tick

    def follow(self, bodies: BodyState) -> int:
        """Take the bodies through one quantum; returns the number of flagged events."""
        return follow(self._step_s, self.rows, self._reported, bodies)


@compiled
def _beyond(vector: Floats, most: float) -> bool:
    """Whether any component exceeds `most` or is not a number."""
    beyond = False
    for k in range(vector.shape[0]):
        beyond |= not abs(vector[k]) <= most
    return beyond


@compiled
def _find_invalid(rows: Ints, is_imposed: Marks, given: _Given) -> tuple[int, int]:
    """The first row with an invalid pose, and what is wrong with it."""
    fresh, position, velocity, attitude, rates = given
    for k in range(rows.shape[0]):
        if not fresh[k]:
            continue
        if not is_imposed[rows[k]]:
            return k, _NOT_IMPOSED
        if _beyond(position[k], MAX_M):
            return k, _BAD_POSITION
        if _beyond(velocity[k], MAX_MPS):
            return k, _BAD_VELOCITY
        square = 0.0
        for axis in range(4):
            square += attitude[k, axis] * attitude[k, axis]
        if not abs(math.sqrt(square) - 1.0) <= _UNIT:
            return k, _BAD_ATTITUDE
        if _beyond(rates[k], MAX_RADPS):
            return k, _BAD_RATES
    return 0, _FINE


@compiled
def _accept(step_s: float, rows: Ints, given: _Given, reported: Reported) -> None:
    fresh, position, velocity, attitude, rates = given
    poses, pending, since = reported.poses, reported.pending, reported.since
    for k in range(rows.shape[0]):
        if not fresh[k]:
            continue
        i = rows[k]
        if not pending[i]:  # otherwise a pose of the same tick is replaced
            elapsed = since[i] * step_s
            for axis in range(3):
                change = velocity[k, axis] - poses[i, _VELOCITY + axis]
                poses[i, _CHANGE + axis] = change / elapsed if 0.0 < elapsed <= CARRY_S else 0.0
        pending[i] = 1
        square = 0.0
        for axis in range(4):
            square += attitude[k, axis] * attitude[k, axis]
        norm = math.sqrt(square)
        for axis in range(4):
            poses[i, _ATTITUDE + axis] = attitude[k, axis] / norm
        for axis in range(3):
            poses[i, _POSITION + axis] = position[k, axis]
            poses[i, _VELOCITY + axis] = velocity[k, axis]
            poses[i, _RATES + axis] = rates[k, axis]


@compiled
def follow(step_s: float, rows: Ints, reported: Reported, bodies: BodyState) -> int:
    """Take the bodies in `rows` (k,) through one quantum, after `multirotor.advance`; returns the number of flagged
    events.

    `jump_m` receives the distance of a jump; `max_step2_m2` grows where one of these moved farther.
    """
    poses, pending, since = reported.poses, reported.pending, reported.since
    position, velocity, attitude, rates = bodies.position, bodies.velocity, bodies.attitude, bodies.rates
    accel, flags, height, max_step2_m2 = bodies.accel, bodies.flags, bodies.height, bodies.max_step2_m2
    events = 0
    for k in range(rows.shape[0]):
        i = rows[k]
        fell = 0.0
        for axis in range(3):
            fell += velocity[i, axis] * velocity[i, axis]
        jumped = False
        ahead_s = step_s
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = px, py, pz
        ground = bodies.floor[i]
        if pending[i]:
            pending[i] = 0
            since[i] = 0
            if reported.final[i]:
                ahead_s = 0.0
            nx, ny, nz = poses[i, _POSITION], poses[i, _POSITION + 1], poses[i, _POSITION + 2]
            far = math.sqrt((nx - px) * (nx - px) + (ny - py) * (ny - py) + (nz - pz) * (nz - pz))
            for axis in range(3):
                velocity[i, axis] = poses[i, _VELOCITY + axis]
                rates[i, axis] = poses[i, _RATES + axis]
            for axis in range(4):
                attitude[i, axis] = poses[i, _ATTITUDE + axis]
            if far > _MAX_STEP_M:
                ground = 0.0  # the collision check finds the roof below, if there is one
            if far > JUMP_M:
                jumped = True
                reported.jump_m[i] = far
                flags[i, EVENTS] |= JUMPED
                events += 1
                for axis in range(3):
                    poses[i, _CHANGE + axis] = 0.0
        since[i] += 1
        if since[i] * step_s > CARRY_S:
            for axis in range(3):
                velocity[i, axis] = 0.0
                rates[i, axis] = 0.0
                poses[i, _CHANGE + axis] = 0.0
        qw, qx, qy, qz = attitude[i, 0], attitude[i, 1], attitude[i, 2], attitude[i, 3]
        fx, fy, fz = poses[i, _CHANGE], poses[i, _CHANGE + 1], poses[i, _CHANGE + 2] + GRAVITY_MPS2
        r20 = 2.0 * (qx * qz - qw * qy)
        r21 = 2.0 * (qy * qz + qw * qx)
        r22 = 1.0 - 2.0 * (qx * qx + qy * qy)
        accel[i, 0] = (1.0 - 2.0 * (qy * qy + qz * qz)) * fx + 2.0 * (qx * qy + qw * qz) * fy + r20 * fz
        accel[i, 1] = 2.0 * (qx * qy - qw * qz) * fx + (1.0 - 2.0 * (qx * qx + qz * qz)) * fy + r21 * fz
        accel[i, 2] = 2.0 * (qx * qz + qw * qy) * fx + 2.0 * (qy * qz - qw * qx) * fy + r22 * fz
        nx += velocity[i, 0] * ahead_s
        ny += velocity[i, 1] * ahead_s
        nz = max(nz + velocity[i, 2] * ahead_s, ground)  # no body is below the ground
        attitude[i, 0], attitude[i, 1], attitude[i, 2], attitude[i, 3] = multirotor.rotate_attitude(
            qw, qx, qy, qz, ahead_s * rates[i, 0], ahead_s * rates[i, 1], ahead_s * rates[i, 2]
        )

        height[i] = nz - ground
        standing = height[i] <= STAND_M
        flags[i, ON_GROUND] = standing
        flags[i, ALOFT] |= height[i] > multirotor.REARM_M
        if standing and flags[i, ALOFT]:
            flags[i, ALOFT] = 0
            falls = 0.0
            for axis in range(3):
                falls += velocity[i, axis] * velocity[i, axis]
            bodies.impact_mps[i] = math.sqrt(max(fell, falls))  # the pose on the ground may have lost its speed already
            flags[i, EVENTS] |= TOUCHED
            events += 1
            if bodies.impact_mps[i] > MAX_TOUCHDOWN_MPS and not flags[i, CRASHED]:
                flags[i, EVENTS] |= BROKEN
                flags[i, CRASHED] = 1
        if standing and r22 < bodies.parameters[bodies.airframe[i], multirotor.TIP_COS] and not flags[i, CRASHED]:
            flags[i, EVENTS] |= TIPPED
            flags[i, CRASHED] = 1
            events += 1

        dx, dy, dz = nx - px, ny - py, nz - pz
        bodies.odometer_m[i] += abs(dx) + abs(dy) + abs(dz)
        run = bodies.run[i]
        max_step2_m2[run] = max(max_step2_m2[run], dx * dx + dy * dy + dz * dz)
        position[i, 0], position[i, 1], position[i, 2] = nx, ny, nz
        if jumped:
            bodies.before[i, 0], bodies.before[i, 1], bodies.before[i, 2] = nx, ny, nz
    return events
