"""Collision events: when collisions have to be checked, contacts that a simulator reports, and one event per contact.

Two bodies that touch, separate and touch again within a second are in one contact, and so is an aircraft that hits
several buildings within a second: it is noted once, with the first building.

Contacts that a simulator reports: the damage that they do, and their rows for the contact tracker. A touch faster than
`GENTLE_MPS` breaks the propellers that touched, and all of an aircraft whose speed it changes by more than
`DESTRUCTION_MPS`; the energy is that of the relative motion, as in `response`. How fast a touch is, is how fast the
bodies close along its normal, or along the line between them: the normal of flat propellers that overlap at their rims
may point up. The frame that comes down on a building has landed there: `imposed_poses` notes that touchdown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skyrange.city.wall_index import NO_WALLS
from skyrange.contracts.components import Contacts
from skyrange.contracts.mailboxes import Note
from skyrange.core import matrices
from skyrange.core.time import NS_PER_S, Time
from skyrange.world.body_state import BodyState, Floats, Ints
from skyrange.world.collision import broad_phase, response
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
)

if TYPE_CHECKING:
    from skyrange.city.city import City

ContactSearch = tuple[bool, Floats, Floats, Ints, Floats, Floats]
"""Whether no tick ever has contacts; by run, how far aircraft have travelled, and from where on near pairs are
searched; the near pairs; and from where on each pair and the walls around each aircraft are checked."""
SEPARATION_NS = NS_PER_S
"""A contact is over after this time without a touch."""
_NO_NOTES: tuple[tuple[int, Note], ...] = ()
_WALL = -1


class ContactTracker:
    """The contacts of one world: `begin` with the first state, then `resolve_tick` after every tick. Deep copies
    continue alike.
    """

    def __init__(self, vehicles: Sequence[str], rows: Sequence[slice], city: City | None) -> None:
        """`rows` are those of each run of a batch; the contacts of a run depend on no other run."""
        self._vehicles = vehicles
        self._rows = rows
        self._city = city
        names = [sorted(range(own.start, own.stop), key=vehicles.__getitem__) for own in rows]
        self._order = np.array(list(chain.from_iterable(names)), dtype=np.int64)
        self._pairs = np.empty((0, 2), dtype=np.int64)
        self._pair_due = np.empty(0)
        self._wall_due = np.empty(0 if city is None else len(vehicles))
        self._travelled = np.zeros(len(rows))
        self._far = np.zeros(len(rows))  # `_travelled` with the tick that is being resolved
        self._census_due = np.array([-1.0 if own.stop - own.start > 1 else math.inf for own in rows])
        self._idle = city is None and all(own.stop - own.start == 1 for own in rows)
        self._touched: dict[tuple[int, int], Time] = {}

    def begin(self, bodies: BodyState) -> None:
        """Find the floor below each aircraft and its distance to the walls."""
        if self._city is not None:
            walls = self._city.walls()
            broad_phase.find_floors(walls, bodies.position, bodies.shape, bodies.airframe, bodies.floor, self._wall_due)

    @property
    def search(self) -> ContactSearch:
        """What tells whether a tick needs `resolve_tick`."""
        return self._idle, self._travelled, self._census_due, self._pairs, self._pair_due, self._wall_due

    def resolve_tick(self, now: Time, step_s: float, bodies: BodyState) -> Sequence[tuple[int, Note]]:
        """Resolve the collisions of the tick that ended; returns its notes, each with its run."""
        if self._idle:
            return _NO_NOTES
        far = self._far
        if broad_phase.is_search_due(self._travelled, bodies.max_step2_m2, self._census_due, far):
            for run in np.flatnonzero(far > self._census_due).tolist():
                self._search_run(run, bodies)
        self._travelled, self._far = far, self._travelled
        if not broad_phase.count_due(far, bodies.run, self._pairs, self._pair_due, bodies.odometer_m, self._wall_due):
            return _NO_NOTES
        walls = NO_WALLS if self._city is None else self._city.walls()
        hits = response.resolve_collisions(
            far, step_s, self._pairs, self._pair_due, self._order, walls, self._wall_due, bodies
        )
        return self.note_contacts(now, hits, bodies) if len(hits) else _NO_NOTES

    def _search_run(self, run: int, bodies: BodyState) -> None:
        """List the near pairs of a run anew, from the state before the tick: a pair that is not listed could not touch
        during it.
        """
        travelled = float(self._travelled[run])
        found, due = broad_phase.list_near_pairs(
            self._order[self._rows[run]], bodies.shape, bodies.airframe, bodies.before, travelled
        )
        begin, end = np.searchsorted(bodies.run[self._pairs[:, 0]], [run, run + 1]).tolist()
        self._pairs = np.concatenate([self._pairs[:begin], found, self._pairs[end:]])
        self._pair_due = np.concatenate([self._pair_due[:begin], due, self._pair_due[end:]])
        self._census_due[run] = travelled + 0.5 * broad_phase.NEAR_M

    def note_contacts(self, now: Time, hits: Floats, bodies: BodyState) -> Sequence[tuple[int, Note]]:
        """Notes of the touches, rows of `hits` (k, 7), that begin a contact, each with its run."""
        notes = []
        for hit in hits.tolist():
            who, other = int(hit[WHO]), int(hit[WITH])
            key = (who, other if other >= 0 else _WALL)
            last = self._touched.get(key)
            goes_on = last is not None and now - last <= SEPARATION_NS
            gentle = hit[ENERGY] == NO_DAMAGE
            if goes_on or not gentle:
                self._touched[key] = now
            if goes_on or gentle:
                continue
            data = {
                "with": self._vehicles[other] if other >= 0 else f"building:{-1 - other}",
                "speed_mps": hit[SPEED],
                "east_m": hit[response.EAST],
                "north_m": hit[response.NORTH],
                "up_m": hit[response.UP],
                "energy_j": hit[ENERGY],
            }
            notes.append((int(bodies.run[who]), Note("event.collision", self._vehicles[who], data)))
        return notes


_NEAR_M = 1e-6
_LANDED_COS = 0.7
"""A normal that points up more than this is that of a roof: the friction of gear on it holds up to 45 degrees."""


def apply_contacts(rows: NDArray[np.int64], contacts: Contacts, after_mps: Floats, state: BodyState) -> Floats:
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
        speed = math.sqrt(matrices.dot(apart, apart))
        hit = [0.0] * 7
        hit[WHO], hit[WITH], hit[SPEED], hit[ENERGY] = i, j if other >= 0 else other, speed, NO_DAMAGE
        between = state.position[i] - (state.position[j] if other >= 0 else contacts.position_enu_m[k])
        if other < 0:
            between[2] += state.shape[state.airframe[i], CG]
        along = matrices.dot(apart, between) / max(math.sqrt(matrices.dot(between, between)), _NEAR_M)
        if max(-matrices.dot(apart, normal), -along) > GENTLE_MPS:
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


def _break_motors(i: int, rotor: int, after_mps: Floats, state: BodyState) -> None:
    change = after_mps - state.velocity[i]
    lost = slice(None) if math.sqrt(matrices.dot(change, change)) > DESTRUCTION_MPS else [rotor] if rotor >= 0 else []
    state.alive[i, lost] = 0
    state.limit[i, lost] = 0.0
    state.rotor_radps[i, lost] = 0.0
