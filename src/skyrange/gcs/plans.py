"""What is an aircraft to fly? A flight plan, and how one is made from a shape, a path or a file.

Two kinds. *auto*: a mission that is uploaded and flown by the autopilot in AUTO. *guided*: targets that
the ground station sends one by one in GUIDED. Every plan is anchored: it knows the scenario's origin
and the aircraft's home, so its points are places and not just offsets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from skyrange.codec import missions
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.missions import Mission, MissionItem
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.gcs import paths
from skyrange.gcs.paths import Point

Kind = Literal["auto", "guided"]
End = Literal["rtl", "land"]

CRUISE_MPS = 5.0
"""Ground speed of built plans, that of the published demonstration."""
WPNAV_SPEED_MPS = 10.0
"""ArduCopter WPNAV_SPEED, default 1000 cm/s: what a mission flies that sets no speed."""
ACCEPTANCE_M = 1.0
"""How near a guided target counts as reached, in space."""

MSL_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT})
HOME_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
TERRAIN_FRAMES = frozenset({mav.MAV_FRAME_GLOBAL_TERRAIN_ALT, mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT})
GLOBAL_FRAMES = MSL_FRAMES | HOME_FRAMES | TERRAIN_FRAMES
"""Frames whose x and y are latitude and longitude."""

LOCATED = frozenset(
    {
        mav.MAV_CMD_NAV_WAYPOINT,
        mav.MAV_CMD_NAV_LOITER_UNLIM,
        mav.MAV_CMD_NAV_LOITER_TURNS,
        mav.MAV_CMD_NAV_LOITER_TIME,
        mav.MAV_CMD_NAV_LAND,
        mav.MAV_CMD_NAV_TAKEOFF,
        mav.MAV_CMD_NAV_LOITER_TO_ALT,
        mav.MAV_CMD_NAV_SPLINE_WAYPOINT,
        mav.MAV_CMD_DO_SET_HOME,
        mav.MAV_CMD_DO_LAND_START,
        mav.MAV_CMD_DO_SET_ROI_LOCATION,
        mav.MAV_CMD_DO_SET_ROI,
        mav.MAV_CMD_NAV_PAYLOAD_PLACE,
    }
)
"""Commands with which ArduCopter stores a place (`AP_Mission::stored_in_location`); others' x, y, z are lost."""


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What one aircraft is to fly.

    `home_enu_m` is its home from `origin`. An auto plan has a `mission` (without the home item); a
    guided one has `targets_enu_m` (from the origin, not from home), how near counts as reached, and how
    it ends. `cruise_mps` is the ground speed it is flown at until the plan itself changes it.
    `checks.check` says what is wrong with a plan.
    """

    kind: Kind
    name: str
    origin: Origin
    home_enu_m: Point
    cruise_mps: float = CRUISE_MPS
    mission: Mission | None = None
    targets_enu_m: tuple[Point, ...] = ()
    acceptance_m: float = ACCEPTANCE_M
    end: End = "rtl"

    @property
    def items(self) -> tuple[MissionItem, ...]:
        """The mission's items; none of a guided plan."""
        return self.mission.items if self.mission is not None else ()


def square(
    origin: Origin,
    home_enu_m: Sequence[float],
    *,
    side_m: float,
    alt_m: float,
    kind: Kind = "auto",
    clockwise: bool = True,
    cruise_mps: float = CRUISE_MPS,
    end: End = "land",
    name: str = "square",
) -> FlightPlan:
    """A square of `side_m` at `alt_m` above home, home its south-west corner; ends by landing there.

    Corners and their order are those of the published helper `create_square_path`.
    """
    points = paths.square(side_m, alt_m, clockwise=clockwise)
    return path(origin, home_enu_m, points, kind=kind, cruise_mps=cruise_mps, end=end, name=name)


def path(
    origin: Origin,
    home_enu_m: Sequence[float],
    points: Sequence[Sequence[float]],
    *,
    kind: Kind = "auto",
    cruise_mps: float = CRUISE_MPS,
    acceptance_m: float = ACCEPTANCE_M,
    end: End = "rtl",
    name: str = "path",
) -> FlightPlan:
    """A path through `points`, each (east, north, up) in metres from home.

    It takes off to the first point's height (a first point straight above home is that and no more),
    flies through all points, then returns to launch (`rtl`) or lands at the last one (`land`).
    """
    home = Point(*map(float, home_enu_m))
    route = tuple(Point(*map(float, point)) for point in points)
    if kind == "guided":
        targets = tuple(Point(home.east_m + e, home.north_m + n, home.up_m + u) for e, n, u in route)
        return FlightPlan("guided", name, origin, home, cruise_mps, None, targets, acceptance_m, end)
    mission = Mission(_items(origin, home, route, cruise_mps, end), _home(origin, home), None, None, name)
    return FlightPlan("auto", name, origin, home, cruise_mps, mission, end=end)


def from_file(
    origin: Origin,
    home_enu_m: Sequence[float],
    file: str | Path,
    *,
    anchor: bool = True,
    cruise_mps: float = WPNAV_SPEED_MPS,
    name: str = "",
) -> FlightPlan:
    """The auto plan in a mission file (`.waypoints`, `.txt`, `.plan`).

    With `anchor` the mission is shifted, keeping its shape in metres, so that its planned home (else its
    first placed item) comes to lie on the aircraft's home, and its altitudes become relative to home.
    `cruise_mps` only serves estimates: the file's own speed changes are what is flown. Raises
    `InputError` for an unreadable file, and for altitudes above sea level without a planned home.
    """
    home = Point(*map(float, home_enu_m))
    mission = missions.read(Path(file))
    if anchor:
        mission = anchored(mission, origin, home)
    return FlightPlan("auto", name or Path(file).name, origin, home, cruise_mps, mission)


def anchored(mission: Mission, origin: Origin, home: Point) -> Mission:
    """`mission` shifted onto `home`, altitudes relative to it; `InputError` where they cannot be."""
    placed = [(item.x, item.y) for item in mission.items if _is_placed(item)]
    if not placed:
        return mission
    planned = (mission.home[0], mission.home[1]) if mission.home is not None else placed[0]
    around = Origin(planned[0], planned[1])  # metres are measured where the plan was drawn
    items: list[MissionItem] = []
    for seq, item in enumerate(mission.items, start=1):
        if item.command not in LOCATED or item.frame not in GLOBAL_FRAMES:
            items.append(item)
            continue
        moved = replace(item, frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT)
        if item.frame in MSL_FRAMES:
            if mission.home is None:
                raise InputError.one(
                    mission.source,
                    f"item {seq}",
                    f"altitude {item.z:g} m above mean sea level",
                    "an altitude relative to home, or a planned home",
                    "Without a planned home this altitude cannot be re-anchored.",
                )
            moved = replace(moved, z=item.z - mission.home[2])
        if _is_placed(item):
            east_m, north_m = around.enu_of(item.x, item.y)
            lat, lon = origin.geodetic_of(home.east_m + east_m, home.north_m + north_m)
            moved = replace(moved, x=lat, y=lon)
        items.append(moved)
    return replace(mission, items=tuple(items), home=_home(origin, home))


def _is_placed(item: MissionItem) -> bool:
    """Whether it names a place; ArduCopter reads latitude and longitude 0 as "where I am"."""
    return item.command in LOCATED and item.frame in GLOBAL_FRAMES and not (item.x == 0.0 and item.y == 0.0)


def _home(origin: Origin, home: Point) -> tuple[float, float, float]:
    lat, lon = origin.geodetic_of(home.east_m, home.north_m)
    return lat, lon, origin.alt_msl_m + home.up_m


def _items(origin: Origin, home: Point, route: Sequence[Point], cruise_mps: float, end: End) -> tuple[MissionItem, ...]:
    """Take-off, speed, one waypoint per point (the first only if it is not the take-off's own), the end."""

    def at(point: Point, command: int) -> MissionItem:
        lat, lon = origin.geodetic_of(home.east_m + point.east_m, home.north_m + point.north_m)
        return MissionItem(
            mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, command, 0.0, 0.0, 0.0, 0.0, lat, lon, point.up_m, autocontinue=True
        )

    if not route:
        return ()
    first, last = route[0], route[-1]
    items = [
        at(Point(0.0, 0.0, first.up_m), mav.MAV_CMD_NAV_TAKEOFF),
        MissionItem(
            mav.MAV_FRAME_MISSION, mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, cruise_mps, -1.0, 0.0, 0.0, 0.0, 0.0, True
        ),
    ]
    rest = route[1:] if (first.east_m, first.north_m) == (0.0, 0.0) else route
    items += [at(point, mav.MAV_CMD_NAV_WAYPOINT) for point in rest]
    if end == "land":
        items.append(at(Point(last.east_m, last.north_m, 0.0), mav.MAV_CMD_NAV_LAND))
    else:
        items.append(
            MissionItem(
                mav.MAV_FRAME_MISSION, mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True
            )
        )
    return tuple(items)
