"""Alternatives to an intent that cannot be accepted: later, at another height, beside, or a combination.

For each change of the route the least delay is exact. A change of height or place is searched with volumes that are a
little larger than those of the altered plan, which only its operator knows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import shapely

from skyrange.core import elementary_python
from skyrange.core.geodesy import longitude_near, unwrap_outline, wrap_longitude
from skyrange.core.time import Time, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace.claimed_airspace import Query
from skyrange.utm.contract import Alternative

Outline = tuple[tuple[float, float], ...]

_M_PER_DEG: Final = 111_320.0
"""Metres of a degree of latitude, and of longitude at the equator; a metre more or less does not matter here."""
_CLIMB_MPS: Final = 2.5
"""ArduCopter's WPNAV_SPEED_UP: what a change of height costs, up and down again."""
_SPEED_MPS: Final = 5.0
"""A usual ground speed in a city: what a way aside costs, out and back."""
_LATE: Final = 1.5
"""By how much longer than estimated a change may take, margins included, so that the altered plan stays within."""
_LATER_S_PER_M: Final = _LATE * (1.0 / _CLIMB_MPS + 1.0 / 1.5)
"""Of a climb: up at WPNAV_SPEED_UP, and down again at ArduCopter's WPNAV_SPEED_DN, 1.5 m/s."""
_SPARE_S_PER_M: Final = 2.0 * _LATE / _SPEED_MPS
"""Of a way aside, before and after."""
_GROUND_M: Final = 1.0
"""A volume that begins no higher above the lowest one touches the ground there."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What alternatives may be."""

    delay_s: float
    climbs_m: tuple[float, ...]
    aside_m: tuple[float, ...]
    ceiling_m: float
    """Greatest height above the lowest volume of the intent."""
    count: int


Search = Callable[[Sequence[Query]], Sequence[Time | None]]
"""`search(queries)`: the least delay of each, as `Airspace.find_least_delays` finds it."""


def find_alternatives(volumes: Sequence[Volume4D], search: Search, limits: Limits) -> list[Alternative]:
    """Alternatives, the cheapest first; their cost is the time by which the flight ends later. Of each kind of change
    those are among them that cost less than all smaller changes of the kind.

    Every operator can fly the delayed flight, but perhaps none of the others. So a mere delay is always among them if
    there is one, and what costs more is not offered.
    """
    most_ns = from_seconds(limits.delay_s)
    (delay_ns,) = search([Query(volumes, most_ns)])
    most_s = math.inf if delay_ns is None else to_seconds(delay_ns)
    priced = [] if delay_ns is None else [(most_s, 0, Alternative(tuple(volumes), delay_ns))]
    changes = [candidate for candidate in _changes(volumes, limits) if _cost_s(candidate) < most_s]
    spare_ns = [from_seconds(min(limits.delay_s, most_s - _cost_s(candidate))) for candidate in changes]
    scales = _scales_of(volumes)
    queries = [
        Query(_changed(volumes, candidate, scales), spare) for candidate, spare in zip(changes, spare_ns, strict=True)
    ]
    best: dict[tuple[bool, bool], float] = {}
    for number, (change, query, delay_ns) in enumerate(zip(changes, queries, search(queries), strict=True), 1):
        if delay_ns is None:
            continue
        cost_s = _cost_s(change) + to_seconds(delay_ns)
        kind = (change.climb_m != 0.0, change.east_m != 0.0 or change.north_m != 0.0)
        if cost_s < best.get(kind, math.inf):
            best[kind] = cost_s
            offered = Alternative(tuple(query.volumes), delay_ns, change.climb_m, change.east_m, change.north_m)
            priced.append((cost_s, number, offered))
    priced.sort(key=lambda entry: entry[:2])
    offers = priced[: limits.count]
    if offers and math.isfinite(most_s) and all(number > 0 for _, number, _ in offers):
        offers[-1] = next(entry for entry in priced if entry[1] == 0)
    return [
        replace(alternative, volumes=delayed(alternative.volumes, alternative.delay_ns)) for _, _, alternative in offers
    ]


def reach(volumes: Sequence[Volume4D], limits: Limits) -> Volume4D:
    """The volume that encloses an intent and all alternatives to it."""
    lats, lngs = zip(*(corner for outline in _unwrapped(volumes) for corner in outline), strict=True)
    aside_deg = (max(map(abs, limits.aside_m), default=0.0) + 1.0) / _M_PER_DEG
    south, north = max(min(lats) - aside_deg, -90.0), min(max(lats) + aside_deg, 90.0)
    wide_deg = aside_deg / max(elementary_python.cos(math.radians(max(abs(south), abs(north)))), 1e-6)
    west, east = min(lngs) - wide_deg, max(lngs) + wide_deg
    if east - west < 180.0:
        west, east = wrap_longitude(west), wrap_longitude(east)
    else:  # near a pole
        west, east = max(west, -180.0), min(east, 180.0)
    spare_ns = from_seconds(_SPARE_S_PER_M * max(map(abs, limits.aside_m), default=0.0))
    climb_m = max(limits.climbs_m, default=0.0)
    return Volume4D(
        ((south, west), (south, east), (north, east), (north, west)),
        min(volume.lower_m for volume in volumes),
        max(volume.upper_m for volume in volumes) + climb_m,
        min(volume.start_ns for volume in volumes) - spare_ns,
        max(volume.end_ns for volume in volumes) + spare_ns + from_seconds(limits.delay_s + _LATER_S_PER_M * climb_m),
    )


def _unwrapped(volumes: Sequence[Volume4D]) -> list[list[tuple[float, float]]]:
    """The outlines with longitudes that all are within half a turn of the first one."""
    first = volumes[0].outline[0][1]
    return [[(lat, longitude_near(lng, first)) for lat, lng in volume.outline] for volume in volumes]


def delayed(volumes: Sequence[Volume4D], delay_ns: Time) -> tuple[Volume4D, ...]:
    """The volumes that much later."""
    return tuple(
        Volume4D(volume.outline, volume.lower_m, volume.upper_m, volume.start_ns + delay_ns, volume.end_ns + delay_ns)
        for volume in volumes
    )


class _Change(NamedTuple):
    climb_m: float = 0.0
    east_m: float = 0.0
    north_m: float = 0.0


def _changes(volumes: Sequence[Volume4D], limits: Limits) -> Iterator[_Change]:
    """Higher and beside, the least change of each kind first."""
    ground_m = min(volume.lower_m for volume in volumes)
    top_m = max(volume.upper_m for volume in volumes) - ground_m
    for climb_m in limits.climbs_m:
        if top_m + climb_m <= limits.ceiling_m:
            yield _Change(climb_m=climb_m)
    east, north = _right_of(volumes)
    for aside_m in limits.aside_m:
        yield _Change(0.0, round(east * aside_m, 2), round(north * aside_m, 2))


def _cost_s(change: _Change) -> float:
    return (
        2.0 * abs(change.climb_m) / _CLIMB_MPS
        + 2.0 * elementary_python.hypot(change.east_m, change.north_m) / _SPEED_MPS
    )


def _changed(volumes: Sequence[Volume4D], change: _Change, scales: Sequence[Sequence[float]]) -> tuple[Volume4D, ...]:
    ground_m = min(volume.lower_m for volume in volumes)
    if change.climb_m:
        return tuple(_raised(volume, change.climb_m, ground_m) for volume in volumes)
    return _shifted(volumes, change.east_m, change.north_m, ground_m, scales)


def _scales_of(volumes: Sequence[Volume4D]) -> list[list[float]]:
    """By how much a degree of longitude is shorter at each corner than at the equator."""
    return [[max(elementary_python.cos(math.radians(lat)), 1e-6) for lat, _ in volume.outline] for volume in volumes]


def _raised(volume: Volume4D, climb_m: float, ground_m: float) -> Volume4D:
    """A volume higher; one at the ground reaches higher. It lasts until a slower one would have climbed and sunk."""
    at_ground = volume.lower_m <= ground_m + _GROUND_M
    return replace(
        volume,
        lower_m=volume.lower_m + (0.0 if at_ground else climb_m),
        upper_m=volume.upper_m + climb_m,
        end_ns=volume.end_ns + from_seconds(_LATER_S_PER_M * climb_m),
    )


def _shifted(
    volumes: Sequence[Volume4D], east_m: float, north_m: float, ground_m: float, scales: Sequence[Sequence[float]]
) -> tuple[Volume4D, ...]:
    """The volumes beside; those at the ground stay, and their neighbours reach from the old place to the new one."""
    at_ground = [volume.lower_m <= ground_m + _GROUND_M for volume in volumes]
    spare_ns = from_seconds(_SPARE_S_PER_M * elementary_python.hypot(east_m, north_m))
    shifted = []
    for place, volume in enumerate(volumes):
        outline = volume.outline
        if not at_ground[place]:
            outline = _moved(outline, scales[place], east_m, north_m)
            if any(at_ground[max(place - 1, 0) : place + 2]):
                outline = _hull(outline + volume.outline)
        start_ns, end_ns = volume.start_ns - spare_ns, volume.end_ns + spare_ns
        shifted.append(Volume4D(outline, volume.lower_m, volume.upper_m, start_ns, end_ns))
    return tuple(shifted)


def _moved(outline: Outline, scales: Sequence[float], east_m: float, north_m: float) -> Outline:
    d_lat, east_deg = north_m / _M_PER_DEG, east_m / _M_PER_DEG
    moved = [(lat + d_lat, lng + east_deg / scale) for (lat, lng), scale in zip(outline, scales, strict=True)]
    lats, lngs = zip(*moved, strict=True)
    if max(lats) > 90.0 or min(lats) < -90.0 or max(lngs) > 180.0 or min(lngs) < -180.0:
        moved = [(min(max(lat, -90.0), 90.0), wrap_longitude(lng)) for lat, lng in moved]
    return tuple(moved)


def _hull(corners: Outline) -> Outline:
    """The convex hull of some corners; these themselves if they have no area."""
    hull = shapely.convex_hull(shapely.linestrings(unwrap_outline(corners)))
    if hull.geom_type != "Polygon":
        return corners
    return tuple((lat, wrap_longitude(lng)) for lat, lng in hull.exterior.coords[:-1])


def _right_of(volumes: Sequence[Volume4D]) -> tuple[float, float]:
    """The direction (east, north) to the right of the way from the first volume to the farthest one."""
    lat, lng = _middle(volumes[0])
    scale = elementary_python.cos(math.radians(lat))
    ways = [((longitude_near(point[1], lng) - lng) * scale, point[0] - lat) for point in map(_middle, volumes)]
    east, north = max(ways, key=lambda direction: elementary_python.hypot(*direction))
    length = elementary_python.hypot(east, north)
    return (north / length, -east / length) if length > 1e-9 else (1.0, 0.0)


def _middle(volume: Volume4D) -> tuple[float, float]:
    lats, lngs = zip(*unwrap_outline(volume.outline), strict=True)
    return (min(lats) + max(lats)) / 2.0, (min(lngs) + max(lngs)) / 2.0
