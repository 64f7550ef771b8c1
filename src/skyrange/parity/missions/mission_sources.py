"""Missions to be flown: random legal ones and simpler ones made from them, and those of mission files.

A mission is one that ArduCopter accepts, takes off in, and ends within some minutes over flat ground. It is a function
of its number alone, so a mission can be flown again by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import Mission, MissionItem, read_mission
from skyrange.core.errors import InputError, Problem
from skyrange.core.geodesy import Origin
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import LANDINGS, LOCATED, TAKEOFFS, anchored, is_navigation

REACH_M: Final = 90.0
"""No place is farther east, west, north or south of the start."""
LOWEST_M: Final = 6.0
HIGHEST_M: Final = 30.0
MOST_ITEMS: Final = 9
"""Items between take-off and end, besides those of a turn to the present heading."""
TURNS_AGAIN: Final = 0.05
"""Share of the missions with a turn to the present heading."""
_RELATIVE: Final = int(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT)
_ABSOLUTE: Final = int(mav.MAV_FRAME_GLOBAL)
_JUMPS: Final = (mav.MAV_CMD_DO_JUMP,)


@dataclass(frozen=True, slots=True)
class PlacedItem:
    """A mission item; `place_m` is east, north and altitude above the start in metres, 0 where it is left out."""

    command: int
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    place_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: int = _RELATIVE

    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> MissionItem:
        """The item for an aircraft that starts at `start_enu_m`, at the height of the origin."""
        east_m, north_m, alt_m = self.place_m
        lat = lon = 0.0
        if self.command in LOCATED and (east_m, north_m) != (0.0, 0.0):
            lat, lon = origin.geodetic_of(start_enu_m[0] + east_m, start_enu_m[1] + north_m)
        up = alt_m + origin.alt_msl_m if self.frame == _ABSOLUTE and alt_m else alt_m
        if self.command not in LOCATED:
            lat, lon, up = self.place_m
        return MissionItem(self.frame, self.command, *self.params, lat, lon, up)


@dataclass(frozen=True, slots=True)
class RandomMission:
    """A mission with its number. Item 0 of `items` has sequence number 1."""

    number: int
    items: tuple[PlacedItem, ...]

    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> Mission:
        """The mission for an aircraft that starts at `start_enu_m`."""
        lat, lon = origin.geodetic_of(*start_enu_m)
        items = tuple(item.at(origin, start_enu_m) for item in self.items)
        return Mission(items, (lat, lon, origin.alt_msl_m), source=f"mission {self.number}")

    @property
    def commands(self) -> tuple[int, ...]:
        """The commands of its items."""
        return tuple(item.command for item in self.items)

    @property
    def words(self) -> str:
        """The items in one line: command and what is not 0."""
        return "; ".join(_words(item) for item in self.items)


def _words(item: PlacedItem) -> str:
    name = mav.enums["MAV_CMD"][item.command].name.removeprefix("MAV_CMD_")
    last = max((n for n, value in enumerate(item.params, start=1) if value), default=0)
    params = ",".join(f"{value:g}" for value in item.params[:last])
    place = f" @{','.join(f'{value:g}' for value in item.place_m)}" if any(item.place_m) else ""
    return f"{name}{f'({params})' if params else ''}{place}{' abs' if item.frame == _ABSOLUTE else ''}"


def random_mission(number: int) -> RandomMission:
    """The mission with this number."""
    chance = Random(number)  # noqa: S311  # the same number gives the same mission
    up_m = round(chance.uniform(LOWEST_M, 20.0), 1)
    take_off = mav.MAV_CMD_NAV_VTOL_TAKEOFF if chance.random() < 0.1 else mav.MAV_CMD_NAV_TAKEOFF
    items = []
    if chance.random() < 0.08:
        items.append(PlacedItem(mav.MAV_CMD_NAV_DELAY, (float(chance.randint(1, 4)), 0.0, 0.0, 0.0)))
    items.append(PlacedItem(take_off, place_m=(0.0, 0.0, up_m), frame=_frame(chance)))
    for _ in range(chance.randint(2, MOST_ITEMS)):
        items += _draw(chance, items)
    again = Random(f"turn {number}")  # noqa: S311  # of its own, so that other missions stay what they were
    if again.random() < TURNS_AGAIN:
        items += _turn_again(again)
    items += _draw_end(chance)
    return RandomMission(number, tuple(items))


def _frame(chance: Random) -> int:
    return _ABSOLUTE if chance.random() < 0.25 else _RELATIVE


def _place(chance: Random, open_place: float = 0.08) -> tuple[float, float, float]:
    """A place; with some chance the horizontal or the vertical part is left out."""
    east_m, north_m = (round(chance.uniform(-REACH_M, REACH_M), 1) for _ in range(2))
    up_m = round(chance.uniform(LOWEST_M, HIGHEST_M), 1)
    if chance.random() < open_place:
        east_m = north_m = 0.0
    return east_m, north_m, 0.0 if chance.random() < open_place else up_m


def _waypoint(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    wait_s = float(chance.randint(1, 5)) if chance.random() < 0.25 else 0.0
    place = _place(chance)
    placed = [item for item in items if item.command == mav.MAV_CMD_NAV_WAYPOINT and any(item.place_m)]
    if placed and chance.random() < 0.06:  # the same place again
        place = placed[-1].place_m
    return [PlacedItem(mav.MAV_CMD_NAV_WAYPOINT, (wait_s, 0.0, 0.0, 0.0), place, _frame(chance))]


def _spline(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    wait_s = float(chance.randint(1, 3)) if chance.random() < 0.2 else 0.0
    place = _place(chance, 0.0)
    return [PlacedItem(mav.MAV_CMD_NAV_SPLINE_WAYPOINT, (wait_s, 0.0, 0.0, 0.0), place, _frame(chance))]


def _loiter_time(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    wait_s = float(chance.randint(1, 6))
    return [PlacedItem(mav.MAV_CMD_NAV_LOITER_TIME, (wait_s, 0.0, 0.0, 0.0), _place(chance, 0.3), _frame(chance))]


def _loiter_turns(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    radius_m = float(chance.randint(5, 15)) * chance.choice((1.0, -1.0))
    turns = chance.choice((0.5, 1.0, 2.0))
    return [PlacedItem(mav.MAV_CMD_NAV_LOITER_TURNS, (turns, 0.0, radius_m, 0.0), _place(chance), _frame(chance))]


def _loiter_to_alt(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    east_m, north_m, _ = _place(chance, 0.2)
    up_m = round(chance.uniform(LOWEST_M, HIGHEST_M), 1)
    return [PlacedItem(mav.MAV_CMD_NAV_LOITER_TO_ALT, place_m=(east_m, north_m, up_m), frame=_frame(chance))]


def _delay(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    return [PlacedItem(mav.MAV_CMD_NAV_DELAY, (float(chance.randint(1, 6)), 0.0, 0.0, 0.0))]


def _speed(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    kind, low, high = chance.choice(((1.0, 2.0, 10.0), (1.0, 2.0, 10.0), (2.0, 1.0, 3.0), (3.0, 0.5, 2.0)))
    return [PlacedItem(mav.MAV_CMD_DO_CHANGE_SPEED, (kind, round(chance.uniform(low, high), 1), -1.0, 0.0))]


def _yaw(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    relative = float(chance.random() < 0.5)
    angle = float(chance.randint(10, 170)) if relative else float(chance.randint(0, 359))
    rate = float(chance.choice((0, 20, 45)))
    return [PlacedItem(mav.MAV_CMD_CONDITION_YAW, (angle, rate, float(chance.choice((-1, 1))), relative))]


def _turn_again(chance: Random) -> list[PlacedItem]:
    """A turn, with a direction, to the heading that the aircraft has: along a leg, or by the same turn before.

    Whether an autopilot turns a whole circle then depends on the sign of a residue.
    """
    degrees, (east, north) = chance.choice(((0.0, (0, 1)), (90.0, (1, 0)), (180.0, (0, -1)), (270.0, (-1, 0))))
    rate, sense = float(chance.choice((30, 45))), float(chance.choice((-1, 1)))
    up_m = round(chance.uniform(LOWEST_M, HIGHEST_M), 1)
    from_e_m, from_n_m = (round(chance.uniform(-20.0, 20.0), 1) for _ in range(2))
    leg_m = round(chance.uniform(20.0, 60.0), 1)
    turn = PlacedItem(mav.MAV_CMD_CONDITION_YAW, (degrees, rate, sense, 0.0))
    wait = PlacedItem(mav.MAV_CMD_NAV_DELAY, (8.0, 0.0, 0.0, 0.0))
    places = [(from_e_m, from_n_m, up_m), (from_e_m + leg_m * east, from_n_m + leg_m * north, up_m)]
    legs = [PlacedItem(mav.MAV_CMD_NAV_WAYPOINT, place_m=place) for place in places]
    return [*legs, turn, wait, *([turn, wait] if chance.random() < 0.5 else [])]


def _condition(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    """A condition, and a command that it delays."""
    if chance.random() < 0.5:
        first = PlacedItem(mav.MAV_CMD_CONDITION_DELAY, (float(chance.randint(1, 5)), 0.0, 0.0, 0.0))
    else:
        first = PlacedItem(mav.MAV_CMD_CONDITION_DISTANCE, (float(chance.randint(5, 40)), 0.0, 0.0, 0.0))
    return [first, *_speed(chance, items)]


def _roi(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    if chance.random() < 0.3:
        return [PlacedItem(mav.MAV_CMD_DO_SET_ROI_NONE)]
    return [PlacedItem(mav.MAV_CMD_DO_SET_ROI_LOCATION, place_m=_place(chance, 0.0))]


def _jump(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    """A jump back to one of the last three navigation commands after the take-off.

    ArduCopter repeats a jump among the DO commands of one navigation command for ever: a known difference.
    """
    climb = next(n for n, item in enumerate(items, start=1) if item.command in TAKEOFFS)
    places = [n for n, item in enumerate(items, start=1) if n > climb and is_navigation(item.command)][-3:]
    if not places:
        return []
    target = chance.choice(places)
    return [PlacedItem(mav.MAV_CMD_DO_JUMP, (float(target), float(chance.randint(0, 2)), 0.0, 0.0))]


def _skipped(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    """A command of other vehicles, or for a device that is not fitted."""
    command = chance.choice(
        (
            mav.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT,
            mav.MAV_CMD_NAV_ALTITUDE_WAIT,
            mav.MAV_CMD_NAV_SET_YAW_SPEED,
            mav.MAV_CMD_DO_SET_REVERSE,
            mav.MAV_CMD_DO_INVERTED_FLIGHT,
            mav.MAV_CMD_DO_VTOL_TRANSITION,
            mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
            mav.MAV_CMD_IMAGE_START_CAPTURE,
            mav.MAV_CMD_JUMP_TAG,
            mav.MAV_CMD_DO_LAND_START,
        )
    )
    return [PlacedItem(command, (float(chance.randint(0, 5)), 0.0, 0.0, 0.0))]


def _held(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    """Guided mode with a time limit, a script's time, or an attitude for a time."""
    seconds = float(chance.randint(2, 5))
    kind = chance.randint(0, 2)
    if kind == 0:
        limits = PlacedItem(mav.MAV_CMD_DO_GUIDED_LIMITS, (seconds, 0.0, 0.0, 0.0))
        return [limits, PlacedItem(mav.MAV_CMD_NAV_GUIDED_ENABLE, (1.0, 0.0, 0.0, 0.0))]
    if kind == 1:
        return [PlacedItem(mav.MAV_CMD_NAV_SCRIPT_TIME, (1.0, seconds, 0.0, 0.0))]
    lean = (float(chance.randint(-8, 8)), float(chance.randint(-8, 8)))
    return [PlacedItem(mav.MAV_CMD_NAV_ATTITUDE_TIME, (seconds, *lean, float(chance.randint(0, 359))))]


_KINDS: Final[tuple[tuple[float, Callable[[Random, Sequence[PlacedItem]], list[PlacedItem]]], ...]] = (
    (0.42, _waypoint),
    (0.12, _spline),
    (0.06, _loiter_time),
    (0.04, _loiter_turns),
    (0.04, _loiter_to_alt),
    (0.04, _delay),
    (0.09, _speed),
    (0.05, _yaw),
    (0.03, _condition),
    (0.03, _roi),
    (0.04, _jump),
    (0.03, _skipped),
    (0.01, _held),
)


def _draw(chance: Random, items: Sequence[PlacedItem]) -> list[PlacedItem]:
    (kind,) = chance.choices([kind for _, kind in _KINDS], [share for share, _ in _KINDS])
    return kind(chance, items)


def _draw_end(chance: Random) -> list[PlacedItem]:
    """A landing there or elsewhere, a return, or none, after which the ground station orders the return."""
    kind = chance.randint(0, 4)
    if kind == 0:
        return [PlacedItem(mav.MAV_CMD_NAV_LAND)]
    if kind == 1:
        east_m, north_m, _ = _place(chance, 0.0)
        command = chance.choice((mav.MAV_CMD_NAV_LAND, mav.MAV_CMD_NAV_VTOL_LAND))
        return [PlacedItem(command, place_m=(east_m, north_m, 0.0))]
    return [] if kind == 2 else [PlacedItem(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)]


def simpler(mission: RandomMission) -> Iterator[RandomMission]:
    """Missions one step simpler: without an item, a delay, a curve or an absolute altitude, or at tens of metres."""
    for place, item in enumerate(mission.items):
        rest = mission.items[:place] + mission.items[place + 1 :]
        if item.command not in TAKEOFFS:
            yield replace(mission, items=_renumbered(rest, place + 1))
    for place, item in enumerate(mission.items):
        for other in _simpler_items(item):
            yield replace(mission, items=(*mission.items[:place], other, *mission.items[place + 1 :]))


def _renumbered(items: tuple[PlacedItem, ...], removed: int) -> tuple[PlacedItem, ...]:
    """Items with the targets of jumps as they are without the item of number `removed`."""
    return tuple(
        replace(item, params=(max(item.params[0] - float(item.params[0] > removed), 1.0), *item.params[1:]))
        if item.command in _JUMPS
        else item
        for item in items
    )


def _simpler_items(item: PlacedItem) -> Iterator[PlacedItem]:
    if item.frame != _RELATIVE:
        yield replace(item, frame=_RELATIVE)
    waits = (mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_CMD_NAV_SPLINE_WAYPOINT)
    if item.command in waits and item.params[0]:
        yield replace(item, params=(0.0, *item.params[1:]))
    if item.command == mav.MAV_CMD_NAV_SPLINE_WAYPOINT:
        yield replace(item, command=int(mav.MAV_CMD_NAV_WAYPOINT))
    tens = tuple(math.copysign(max(round(abs(part), -1), 10.0), part) if part else 0.0 for part in item.place_m)
    if tens != item.place_m and is_navigation(item.command) and item.command not in LANDINGS:
        yield replace(item, place_m=(tens[0], tens[1], tens[2]))


@dataclass(frozen=True, slots=True)
class GivenMission:
    """A mission file with a number, which starts at 1."""

    number: int
    file: Path
    mission: Mission

    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> Mission:
        """The mission for an aircraft that starts at `start_enu_m`, with altitudes relative to the start."""
        return anchored(self.mission, origin, Point(*start_enu_m, 0.0))

    @property
    def commands(self) -> tuple[int, ...]:
        """The commands of its items."""
        return tuple(item.command for item in self.mission.items)

    @property
    def words(self) -> str:
        """The name of the file."""
        return str(self.file)


@dataclass(frozen=True, slots=True)
class RefusedMission:
    """A mission file that is not flown, and all that is wrong with it."""

    file: Path
    reason: str

    @classmethod
    def of(cls, file: Path, problems: Sequence[Problem]) -> RefusedMission:
        """The refusal for these problems."""
        return cls(file, "; ".join(map(str, problems)))


def read_missions(files: Sequence[Path]) -> tuple[list[GivenMission], list[RefusedMission]]:
    """The missions in `.waypoints`, `.txt` and `.plan` files, and the files that cannot be read."""
    missions, refused = [], []
    for number, file in enumerate(files, start=1):
        try:
            missions.append(GivenMission(number, file, read_mission(file)))
        except InputError as error:
            refused.append(RefusedMission.of(file, error.problems))
    return missions, refused
