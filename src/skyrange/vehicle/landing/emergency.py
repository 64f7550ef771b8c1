"""Emergency landing: when the autopilot begins to land, the companion first looks for a flat place.

The autopilot goes to LAND in flight: by a failsafe, or because its operator says so. The companion takes control in
GUIDED, descends to a height from which its sensor sees the surface, and makes a grid of the heights below. It flies
above the nearest flat disc, looks again from nearer, and commands LAND. Where no place is flat, or the second look
says otherwise than the first, it moves on along a square spiral. It lands where it is when it has moved often enough
or sees nothing. Who changes the mode meanwhile has control: the companion yields, and does nothing until the aircraft
has left LAND.

What it knows of the autopilot is what `companion.control_handover` knows: modes from HEARTBEATs, up to a second late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.range_scans import RangeScan
from skyrange.contracts.alerts import Scalar
from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.vehicle.avoidance.contract import Vector
from skyrange.vehicle.landing.ground_grid import FlatRules, GroundGrid, Place, find_points
from skyrange.vehicle.sight.beams import SensorView

GUIDED: Final = int(mav.COPTER_MODE_GUIDED)
LAND: Final = int(mav.COPTER_MODE_LAND)
CONFIRM_NS: Final[Time] = 5 * NS_PER_S // 2
MAX_TRIES: Final = 3
REPEAT_NS: Final[Time] = 3 * NS_PER_S
"""As in `companion.control_handover`."""
MIN_HEIGHT_M: Final = 5.0
"""Below this height above home it does not take control: as `companion.companion` (assumed)."""
BLIND_NS: Final[Time] = 4 * NS_PER_S
"""Without a scan for so long it lands where it is (assumed)."""
LEG_NS: Final[Time] = 20 * NS_PER_S
"""It looks after this time, wherever it is by then (assumed)."""
SCANS: Final = 6
"""Scans of a look (assumed): the error of their median is less than half of that of one."""
CLOSE: Final = 0.75
"""Height of the second look over that of the first (assumed): the noise of a stereo camera is then a half."""
STRIDE: Final = 0.8
"""Length of a move over the height of the look (assumed): two thirds of the shorter side of a D435's field."""
STEP_M: Final = 3.0
"""How far it descends at once as long as it sees no surface: less than what remains of a D435's range (assumed)."""
HIGHEST: Final = 0.05
"""Share of the returns of a scan that may be above what it takes for the highest surface (assumed)."""
SEEN: Final = 0.05
"""Share of the beams of a scan that have to return: fewer are noise (assumed)."""
ARRIVED_M: Final = 0.4
STILL_MPS: Final = 0.3
SHIFT_M: Final = 0.5
"""By how much both looks may differ in the height of the place: errors of the own height in between (assumed)."""
OVER_M: Final = 0.3
"""How far from the middle of the disc it may be when it lands (assumed)."""
LOOKS: Final = 3
"""Second looks at one place, each nearer to its middle than the last (assumed)."""


@dataclass(frozen=True, slots=True)
class LandingRules:
    """How an aircraft lands in an emergency, and with which of its sensors."""

    sensors: tuple[MountedSensor, ...]
    """Those that look down."""
    flat: FlatRules
    look_m: float
    """Height above the highest surface below, from which it looks first."""
    moves: int
    """How often it moves on."""
    looks_twice: bool = True


class Phase(StrEnum):
    """What the companion does."""

    WATCHING = "watching"
    TAKING_OVER = "taking-over"
    DESCENDING = "descending"
    LOOKING = "looking"
    GOING = "going"
    CHECKING = "checking"
    LANDING = "landing"
    """LAND was commanded and is not confirmed yet."""


class OwnState(NamedTuple):
    """What the companion believes of its aircraft."""

    mode: int
    heartbeat_ns: Time
    is_flying: bool
    above_home_m: float
    place: Floats
    """(3,): east, north and up in m."""
    velocity: Floats
    """(3,)."""


@dataclass(slots=True)
class Order:
    """What to send: a mode, a position; and the note to write."""

    mode: int | None = None
    place: Vector | None = None
    note: str = ""
    data: dict[str, Scalar] = field(default_factory=dict)


class EmergencyLanding:
    """The emergency landing of one aircraft. Deep copies continue alike."""

    def __init__(self, rules: LandingRules) -> None:
        self._rules = rules
        self._views = {sensor.number: SensorView(sensor, 0) for sensor in rules.sensors}
        self.phase = Phase.WATCHING
        self.causes: tuple[FrameId, ...] = ()
        """The frame of the last scan that it used."""
        self._mode = LAND
        """The last one that was reported: one that flies in LAND from the beginning is left alone."""
        self._since_ns: Time = -NEVER
        self._asked_ns: Time = -NEVER
        self._tries = 0
        self._seen_ns: Time = -NEVER
        self._surface_m: float | None = None
        self._grid: GroundGrid | None = None
        self._start = np.zeros(3)
        self._target: Vector | None = None
        self._sent: tuple[Time, Vector] | None = None
        self._moved = 0
        self._looks = 0
        self._place: Place | None = None
        self._refused: list[Floats] = []

    @property
    def is_engaged(self) -> bool:
        """Whether it has control, or is about to."""
        return self.phase is not Phase.WATCHING

    # --- scans -----------------------------------------------------------------------------------

    def see(self, now: Time, scan: RangeScan, place: Floats, velocity: Floats, cause: FrameId) -> None:
        """Take in a scan, if it is one of a sensor that looks down."""
        view = self._views.get(scan.sensor)
        if view is None or not self.is_engaged:
            return
        beams = view.place_beams(scan, place, velocity, now)
        self._seen_ns, self.causes = now, (cause,)
        up = np.sort(find_points(beams)[:, 2])
        is_seen = len(up) > SEEN * len(scan.steps)
        self._surface_m = float(up[-1 - int(HIGHEST * len(up))]) if is_seen else None
        if self._grid is not None and self.phase in (Phase.LOOKING, Phase.CHECKING):
            self._grid.add(beams)

    # --- what to do ------------------------------------------------------------------------------

    def check(self, now: Time, own: OwnState) -> Order | None:
        """What has to be done now; None if nothing has."""
        before, self._mode = self._mode, own.mode
        if not own.is_flying:
            self._stop()
            return None
        if not self.is_engaged:
            begins = own.mode == LAND and before != LAND and own.above_home_m >= MIN_HEIGHT_M
            return self._take_over(now, own) if begins else None
        if self.phase in (Phase.TAKING_OVER, Phase.LANDING):
            return self._await_mode(now, own)
        if own.mode != GUIDED:
            self._stop()
            return Order(note="decision.landing_yield", data={"mode": own.mode})
        if now - max(self._seen_ns, self._asked_ns) > BLIND_NS:
            return self._land(now, own, "decision.landing_blind", {"reason": "no scans"})
        steps = {
            Phase.DESCENDING: self._descend,
            Phase.LOOKING: self._look,
            Phase.GOING: self._go,
            Phase.CHECKING: self._check_place,
        }
        return steps[self.phase](now, own)

    def _stop(self) -> None:
        self.phase, self._grid, self._sent = Phase.WATCHING, None, None

    def _take_over(self, now: Time, own: OwnState) -> Order:
        self._start, self._target = own.place, _vector(own.place)
        self._moved, self._refused, self._surface_m, self._place = 0, [], None, None
        self._enter(now, Phase.TAKING_OVER)
        self._asked_ns, self._tries = now, 1
        east, north, up = self._target
        data: dict[str, Scalar] = {"mode": own.mode, "east_m": east, "north_m": north, "up_m": up}
        return Order(GUIDED, self._target, "decision.landing_search", data)

    def _await_mode(self, now: Time, own: OwnState) -> Order | None:
        """Wait until the autopilot confirms the mode, and command it again."""
        wanted, other = (GUIDED, LAND) if self.phase is Phase.TAKING_OVER else (LAND, GUIDED)
        fresh = own.heartbeat_ns > self._asked_ns
        if fresh and own.mode == wanted:
            if wanted == LAND:
                self._stop()
                return None
            self._enter(now, Phase.DESCENDING)
            self._asked_ns = now
            return None
        if fresh and own.mode != other:
            self._stop()
            return Order(note="decision.landing_yield", data={"mode": own.mode})
        if now - self._asked_ns < CONFIRM_NS:
            return None
        if self._tries >= MAX_TRIES:
            self._stop()
            return Order(note="decision.landing_refused", data={"mode": own.mode})
        self._asked_ns, self._tries = now, self._tries + 1
        return Order(wanted)

    def _descend(self, now: Time, own: OwnState) -> Order | None:
        """Fly to the place of the look, at its height above the highest surface that is seen."""
        assert self._target is not None
        look_m = self._rules.look_m
        if self._surface_m is None:
            if own.above_home_m < 0.5 * look_m:
                return self._land(now, own, "decision.landing_blind", {"reason": "no surface in range"})
            up = float(own.place[2]) - STEP_M
        else:
            up = self._surface_m + look_m
        self._target = (self._target[0], self._target[1], up)
        # the height is that of a noisy surface, and need not be exact
        arrived = self._surface_m is not None and _is_at(own, self._target, up_m=0.15 * look_m)
        if arrived or now - self._since_ns > LEG_NS:
            self._enter(now, Phase.LOOKING)
            self._grid = GroundGrid(own.place)
        return self._steer(now)

    def _look(self, now: Time, own: OwnState) -> Order | None:
        """Look, then choose a place or move on."""
        assert self._grid is not None
        if self._grid.scans < SCANS:
            return self._steer(now)
        place = self._grid.find_place(own.place[:2], self._rules.flat, refused=self._refused)
        if place is None:
            return self._move_on(now, own, "nothing flat")
        self._place, self._looks = place, 0
        return self._approach(now, place, self._describe(own, place))

    def _approach(self, now: Time, place: Place, data: dict[str, Scalar] | None = None) -> Order | None:
        self._enter(now, Phase.GOING)
        east, north, up = place.centre
        self._target = (east, north, up + CLOSE * self._rules.look_m)
        order = self._steer(now) or Order()
        return order if data is None else Order(None, order.place, "decision.landing_place", data)

    def _go(self, now: Time, own: OwnState) -> Order | None:
        assert self._target is not None
        if _is_at(own, self._target, up_m=ARRIVED_M) or now - self._since_ns > LEG_NS:
            if not self._rules.looks_twice and self._place is not None:
                return self._land(now, own, "decision.landing", self._describe(own, self._place))
            self._enter(now, Phase.CHECKING)
            self._grid = GroundGrid(own.place)
        return self._steer(now)

    def _check_place(self, now: Time, own: OwnState) -> Order | None:
        """Look again: land if it is above a flat disc, of the height that it saw from farther away."""
        assert self._grid is not None
        assert self._place is not None
        if self._grid.scans < SCANS:
            return self._steer(now)
        rules = self._rules.flat
        found = self._grid.find_place(own.place[:2], rules, within_m=0.5 * rules.clear_m, refused=self._refused)
        reason = "not flat from near"
        if found is not None and abs(found.centre[2] - self._place.centre[2]) > SHIFT_M:
            reason, found = "another height from near", None
        self._looks += 1
        if found is not None:
            middle = np.array(found.centre) - own.place
            if elementary_python.hypot(float(middle[0]), float(middle[1])) <= OVER_M or self._looks >= LOOKS:
                return self._land(now, own, "decision.landing", self._describe(own, found))
            return self._approach(now, found)
        self._refused.append(np.array(self._place.centre[:2]))
        return self._move_on(now, own, reason)

    def _move_on(self, now: Time, own: OwnState, reason: str) -> Order | None:
        """Look elsewhere, or land where it is."""
        assert self._grid is not None
        if self._moved >= self._rules.moves:
            return self._land(now, own, "decision.landing_blind", {"reason": f"{reason}, after {self._moved} moves"})
        self._moved += 1
        stride = STRIDE * self._rules.look_m
        east, north = find_spiral(self._moved)
        self._target = (
            float(self._start[0]) + stride * east, float(self._start[1]) + stride * north, float(own.place[2]),
        )  # fmt: skip
        self._enter(now, Phase.DESCENDING)
        data: dict[str, Scalar] = {"reason": reason, "move": self._moved, "known": round(self._grid.known_share(), 3)}
        self._grid = None
        data |= dict(zip(("east_m", "north_m", "up_m"), self._target, strict=True))
        order = self._steer(now) or Order()
        return Order(None, order.place, "decision.landing_move", data)

    def _land(self, now: Time, own: OwnState, note: str, data: dict[str, Scalar]) -> Order:
        self._enter(now, Phase.LANDING)
        self._asked_ns, self._tries, self._grid = now, 1, None
        if "east_m" not in data:
            data |= dict(zip(("east_m", "north_m", "up_m"), own.place.tolist(), strict=True))
        return Order(LAND, None, note, data)

    def _enter(self, now: Time, phase: Phase) -> None:
        self.phase, self._since_ns = phase, now

    def _steer(self, now: Time) -> Order | None:
        """The target, if it is new or was sent some time ago."""
        assert self._target is not None
        if self._sent is not None:
            at_ns, sent = self._sent
            near = max(abs(a - b) for a, b in zip(sent, self._target, strict=True)) < 0.5 * ARRIVED_M
            if near and now - at_ns < REPEAT_NS:
                return None
        self._sent = now, self._target
        return Order(place=self._target)

    def _describe(self, own: OwnState, place: Place) -> dict[str, Scalar]:
        east, north, up = place.centre
        away = np.array(place.centre) - own.place
        return {
            "east_m": east,
            "north_m": north,
            "up_m": up,
            "rough_m": place.rough_m,
            "slope": place.slope,
            "away_m": elementary_python.hypot(float(away[0]), float(away[1])),
            "moves": self._moved,
        }


def find_spiral(number: int) -> tuple[int, int]:
    """The place on a square spiral around (0, 0) after so many steps: east, then north, west and south."""
    east = north = 0
    ways, leg, left = ((1, 0), (0, 1), (-1, 0), (0, -1)), 0, 1
    for _ in range(number):
        east, north = east + ways[leg % 4][0], north + ways[leg % 4][1]
        left -= 1
        if left == 0:
            leg += 1
            left = leg // 2 + 1
    return east, north


def _vector(place: Floats) -> Vector:
    east, north, up = place.tolist()
    return east, north, up


def _is_at(own: OwnState, target: Vector, up_m: float) -> bool:
    """Whether it is near a target, and hardly moves."""
    east, north, up = (own.place - np.array(target)).tolist()
    speed = elementary_python.hypot3(*own.velocity.tolist())
    return math.sqrt(east * east + north * north) <= ARRIVED_M and abs(up) <= up_m and speed <= STILL_MPS
