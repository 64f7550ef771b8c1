"""Contacts that a simulator reports: the damage that they do, and their rows for the contact tracker.

A touch faster than `GENTLE_MPS` breaks the propellers that touched, and all of an aircraft whose speed it changes by
more than `DESTRUCTION_MPS`; the energy is that of the relative motion, as in `response`. How fast a touch is, is how
fast the bodies close along its normal, or along the line between them: the normal of flat propellers that overlap at
their rims may point up. The frame that comes down on a building has landed there: `imposed_poses` notes that touchdown.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Contacts
from skyrange.world.collision.broad_phase import CG, MASS
from skyrange.world.collision.response import (
    DESTRUCTION_MPS,
    EAST,
    ENERGY,
    GENTLE_MPS,
    NO_DAMAGE,
    NORTH,
    SPEED,
    UP,
    WHO,
    WITH,
    CollisionState,
    Floats,
)

_NEAR_M = 1e-6
_LANDED_COS = 0.7
"""A normal that points up more than this is that of a roof: the friction of gear on it holds up to 45 degrees."""


def apply_contacts(rows: NDArray[np.int64], contacts: Contacts, after_mps: Floats, state: CollisionState) -> Floats:
    """Break what the contacts break in `state`, which is that before them; returns the hits (k, 7).

    `rows` are the world's rows of the engine's vehicles, `after_mps` (vehicles, 3) their velocities after the tick.
    """
    hits: list[list[float]] = []
    for k in range(len(contacts.vehicle)):
        place, other = int(contacts.vehicle[k]), int(contacts.other[k])
        normal = contacts.normal_enu[k]
        if other < 0 and contacts.rotor[k] < 0 and normal[2] > _LANDED_COS:
            continue
        i, j = int(rows[place]), int(rows[other]) if other >= 0 else -1
        apart = state.velocity[i] - (state.velocity[j] if other >= 0 else 0.0)
        speed = math.sqrt(float(apart @ apart))
        hit = [0.0] * 7
        hit[WHO], hit[WITH], hit[SPEED], hit[ENERGY] = i, j if other >= 0 else other, speed, NO_DAMAGE
        between = state.position[i] - (state.position[j] if other >= 0 else contacts.position_enu_m[k])
        if other < 0:
            between[2] += state.shape[state.airframe[i], CG]
        along = float(apart @ between) / max(math.sqrt(float(between @ between)), _NEAR_M)
        if max(-float(apart @ normal), -along) > GENTLE_MPS:
            mass = float(state.shape[state.airframe[i], MASS])
            if other >= 0:
                second = float(state.shape[state.airframe[j], MASS])
                mass *= second / (mass + second)
                _break_motors(j, int(contacts.other_rotor[k]), after_mps[other], state)
            _break_motors(i, int(contacts.rotor[k]), after_mps[place], state)
            hit[ENERGY] = 0.5 * mass * speed * speed
            hit[EAST], hit[NORTH], hit[UP] = contacts.position_enu_m[k].tolist()
        hits.append(hit)
        if other >= 0:
            twin = list(hit)
            twin[WHO], twin[WITH] = j, i
            hits.append(twin)
    return np.array(hits, dtype=np.float64).reshape(-1, 7)


def _break_motors(i: int, rotor: int, after_mps: Floats, state: CollisionState) -> None:
    change = after_mps - state.velocity[i]
    lost = slice(None) if math.sqrt(float(change @ change)) > DESTRUCTION_MPS else [rotor] if rotor >= 0 else []
    state.alive[i, lost] = 0
    state.limit[i, lost] = 0.0
    state.rotor_radps[i, lost] = 0.0
