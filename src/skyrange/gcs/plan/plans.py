"""Flight plans: their construction from a shape, a path or a mission file, and alterations of one.

There are two kinds. An *auto* plan is a mission that is uploaded and that the autopilot flies in AUTO mode. A
*guided* plan is a list of targets that the ground station sends one by one in GUIDED mode. Every plan contains the
scenario's origin and the aircraft's home, so that its points are absolute positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import Mission, MissionItem, read_mission
from skyrange.codec.mission.differences import GLOBAL_FRAMES as GLOBAL_FRAMES
from skyrange.codec.mission.differences import HOME_FRAMES as HOME_FRAMES
from skyrange.codec.mission.differences import LOCATED as LOCATED
from skyrange.codec.mission.differences import MSL_FRAMES as MSL_FRAMES
from skyrange.codec.mission.differences import TERRAIN_FRAMES as TERRAIN_FRAMES
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.gcs.plan import paths
from skyrange.gcs.plan.paths import Leg, Point

Kind = Literal["auto", "guided"]
End = Literal["rtl", "land"]

CRUISE_MPS = 5.0
"""Ground speed of plans built from shapes and paths; that of the published demonstration."""
WPNAV_SPEED_MPS = 10.0
"""ArduCopter WPNAV_SPEED, default 1000 cm/s: the speed of a mission that sets none."""
ACCEPTANCE_M = 1.0
"""Distance in space at which a guided target counts as reached."""

TAKEOFFS = frozenset({mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_CMD_NAV_VTOL_TAKEOFF})
LANDINGS = frozenset({mav.MAV_CMD_NAV_LAND, mav.MAV_CMD_NAV_VTOL_LAND})
_MORE_NAVIGATION = frozenset(
    {mav.MAV_CMD_NAV_SET_YAW_SPEED, mav.MAV_CMD_NAV_SCRIPT_TIME, mav.MAV_CMD_NAV_ATTITUDE_TIME}
)


def is_navigation(command: int) -> bool:
    """Whether a command takes time and is flown by itself (AP_Mission::is_nav_cmd)."""
    return command <= mav.MAV_CMD_NAV_LAST or command in _MORE_NAVIGATION


class Unrolled(NamedTuple):
    """A mission as ArduCopter flies it: its legs, whether they are all, and whether it never ends by itself."""

    legs: tuple[Leg, ...]
    complete: bool
    endless: bool


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """The plan that one aircraft flies.

    `home_enu_m` is the aircraft's home relative to `origin`. An auto plan has a `mission` (without the home item).
    A guided plan has `targets_enu_m` (relative to the origin, not to home), an acceptance radius `acceptance_m`,
    the time `hold_s` that it stays at its first target, and the `end` of the flight. `cruise_mps` is the ground speed
    until the plan itself changes it.
    `plan.checks.check` finds the problems of a plan.
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
    hold_s: float = 0.0
    fence: tuple[MissionItem, ...] = ()
    """The items of its fence, which is uploaded with it."""
    rally: tuple[MissionItem, ...] = ()
    """Its rally points."""
    unrolled: Unrolled | None = field(default=None, init=False, repr=False, compare=False)
    """What `plan.routes` has found out about the mission, kept because a flight asks for it several times."""

    @property
    def items(self) -> tuple[MissionItem, ...]:
        """The mission's items; empty for a guided plan."""
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
    """A square of `side_m` at `alt_m` above home whose south-west corner is home; it ends with a landing there.

    The corners and their order are those of the published helper `create_square_path`.
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

    The aircraft takes off to the first point's height, flies through all points, then returns to launch (`rtl`) or
    lands at the last point (`land`). A first point straight above home is only the take-off.
    """
    home = Point(*map(float, home_enu_m))
    route = tuple(Point(*map(float, point)) for point in points)
    if kind == "guided":
        targets = tuple(Point(home.east_m + e, home.north_m + n, home.up_m + u) for e, n, u in route)
        return FlightPlan("guided", name, origin, home, cruise_mps, None, targets, acceptance_m, end)
    mission = Mission(_items(origin, home, route, cruise_mps, end), _home(origin, home), source=name)
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

    With `anchor` the mission keeps its shape in metres but is moved so that its planned home (or, without one, its
    first item with a position) coincides with the aircraft's home, and its altitudes become relative to home. A fence
    and rally points are moved with it.
    `cruise_mps` is used for estimates only; the aircraft flies the file's own speed changes. Raises `InputError`
    for an unreadable file, and for altitudes above mean sea level without a planned home.
    """
    home = Point(*map(float, home_enu_m))
    mission = read_mission(Path(file))
    if anchor:
        mission = anchored(mission, origin, home)
    plan_name = name or Path(file).name
    return FlightPlan("auto", plan_name, origin, home, cruise_mps, mission, fence=mission.fence, rally=mission.rally)


def anchored(mission: Mission, origin: Origin, home: Point) -> Mission:
    """`mission` moved to `home`, with altitudes relative to it; `InputError` if an altitude cannot be converted."""
    placed = [(item.x, item.y) for item in mission.items if _is_placed(item)]
    if not placed and (mission.home is None or not (mission.fence or mission.rally)):
        return mission
    planned = (mission.home[0], mission.home[1]) if mission.home is not None else placed[0]
    around = Origin(planned[0], planned[1])  # distances in metres are those at the place for which the plan was drawn

    def shifted(item: MissionItem) -> MissionItem:
        east_m, north_m = around.enu_of(item.x, item.y)
        lat, lon = origin.geodetic_of(home.east_m + east_m, home.north_m + north_m)
        return replace(item, x=lat, y=lon)

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
        items.append(shifted(moved) if _is_placed(item) else moved)
    fence, rally = (tuple(map(shifted, area)) for area in (mission.fence, mission.rally))
    return replace(mission, items=tuple(items), home=_home(origin, home), fence=fence, rally=rally)


def _is_placed(item: MissionItem) -> bool:
    """Whether the item has a position; ArduCopter reads latitude and longitude 0 as its current position."""
    return item.command in LOCATED and item.frame in GLOBAL_FRAMES and not (item.x == 0.0 and item.y == 0.0)


def _home(origin: Origin, home: Point) -> tuple[float, float, float]:
    lat, lon = origin.geodetic_of(home.east_m, home.north_m)
    return lat, lon, origin.alt_msl_m + home.up_m


def _items(origin: Origin, home: Point, route: Sequence[Point], cruise_mps: float, end: End) -> tuple[MissionItem, ...]:
    """Take-off, speed, one waypoint per point (unless the first is the take-off's own), and the end."""

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
            mav.MAV_FRAME_MISSION,
            mav.MAV_CMD_DO_CHANGE_SPEED,
            1.0,
            cruise_mps,
            -1.0,
            0.0,
            0.0,
            0.0,
            0.0,
            autocontinue=True,
        ),
    ]
    rest = route[1:] if (first.east_m, first.north_m) == (0.0, 0.0) else route
    items += [at(point, mav.MAV_CMD_NAV_WAYPOINT) for point in rest]
    if end == "land":
        items.append(at(Point(last.east_m, last.north_m, 0.0), mav.MAV_CMD_NAV_LAND))
    else:
        items.append(
            MissionItem(
                mav.MAV_FRAME_MISSION,
                mav.MAV_CMD_NAV_RETURN_TO_LAUNCH,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                autocontinue=True,
            )
        )
    return tuple(items)


def altered(plan: FlightPlan, climb_m: float, east_m: float, north_m: float) -> FlightPlan:
    """The plan with all that is flown between take-off and landing raised and shifted by these metres."""
    if plan.kind == "guided":
        last = len(plan.targets_enu_m) - 1
        targets = tuple(
            Point(target.east_m, target.north_m, target.up_m + climb_m)
            if plan.end == "land" and place == last
            else Point(target.east_m + east_m, target.north_m + north_m, target.up_m + climb_m)
            for place, target in enumerate(plan.targets_enu_m)
        )
        return replace(plan, targets_enu_m=targets)
    if plan.mission is None:
        return plan
    items = tuple(_altered_item(plan, item, climb_m, east_m, north_m) for item in plan.mission.items)
    return replace(plan, mission=replace(plan.mission, items=items))


def _altered_item(plan: FlightPlan, item: MissionItem, climb_m: float, east_m: float, north_m: float) -> MissionItem:
    """A waypoint moves; a take-off climbs higher; altitude 0 and position 0, 0 are the current ones and stay so."""
    if item.command not in LOCATED or not is_navigation(item.command) or item.frame not in GLOBAL_FRAMES:
        return item
    if item.command in LANDINGS:
        return item
    if item.z != 0.0:
        item = replace(item, z=item.z + climb_m)
    if item.command in TAKEOFFS or (item.x == 0.0 and item.y == 0.0):
        return item
    at = plan.origin.enu_of(item.x, item.y)
    lat, lon = plan.origin.geodetic_of(at[0] + east_m, at[1] + north_m)
    return replace(item, x=lat, y=lon)
