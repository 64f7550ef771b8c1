"""Places that `placing = "clear"` moved: from where, how far, and which other start is nearest now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core import elementary_python
from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.radio import Avoidance
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.avoidance.contract import AvoidanceLimits


def describe_moves(before: Scenario, after: Scenario) -> list[dict[str, Any]]:
    """A row for each aircraft and each ground receiver that stands elsewhere in `after`; none where none was moved.

    Distances are horizontal, in metres. `nearest` is the aircraft whose start is nearest to that of a moved one,
    `nearest_m` how far it is away, and `declared_m` how far it would be without any move. `protected_m` is the radius
    that avoidance keeps, of the two aircraft's the larger one, where the start is within it. So of two aircraft that
    stand nearer to each other than they were declared, at least one has a row.
    """
    rows = _aircraft(before, after) if before.operators != after.operators else []
    if before.radio is not None and after.radio is not None:
        for old, new in zip(before.radio.receivers, after.radio.receivers, strict=True):
            if old.place != new.place:
                moved = _move(old.place[:2], new.place[:2])
                rows.append({"receiver": old.id, **moved})
    return rows


def _aircraft(before: Scenario, after: Scenario) -> list[dict[str, Any]]:
    names = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in after.fleet]
    protected_m = [_protected_m(vehicle.avoidance) for _, vehicle in after.fleet]
    old, new = _starts(before), _starts(after)
    moved = np.flatnonzero((old != new).any(axis=1))
    if not len(moved):
        return []
    points = shapely.points(new)
    (rows, nearest), apart_m = shapely.STRtree(points).query_nearest(
        points[moved], exclusive=True, return_distance=True, all_matches=False
    )
    nearest_by_row = dict(zip(rows.tolist(), zip(nearest.tolist(), apart_m.tolist(), strict=True), strict=True))
    entries = []
    for row, place in enumerate(moved.tolist()):
        entry: dict[str, Any] = {"vehicle": names[place], **_move(old[place].tolist(), new[place].tolist())}
        if row in nearest_by_row:
            other, distance_m = nearest_by_row[row]
            entry |= {
                "nearest": names[other],
                "nearest_m": round(distance_m, 3),
                "declared_m": round(elementary_python.distance(old[place].tolist(), old[other].tolist()), 3),
            }
            kept_m = max(protected_m[place], protected_m[other])
            entry |= {"protected_m": kept_m} if distance_m < kept_m else {}
        entries.append(entry)
    return entries


def _protected_m(avoidance: Avoidance | None) -> float:
    """The radius that an avoidance keeps; 0 if none is declared in the parameters of its kind."""
    if avoidance is None or avoidance.kind == "none":
        return 0.0
    settings = avoidance.settings
    return settings.protected_m if isinstance(settings, AvoidanceLimits) else 0.0


def _starts(scenario: Scenario) -> NDArray[np.float64]:
    """(n, 2) east and north of the starts, in metres."""
    places = [(vehicle.start.east_m, vehicle.start.north_m) for _, vehicle in scenario.fleet]
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def _move(old: Any, new: Any) -> dict[str, Any]:
    return {"from_enu_m": list(old), "to_enu_m": list(new), "moved_m": round(elementary_python.distance(old, new), 3)}


def describe_placing(moves: Iterable[Mapping[str, Any]]) -> list[str]:
    """A line for each row of the manifest's `placing`: aircraft that are nearer to another one than declared first,
    the nearest first, then by how far they were moved.
    """
    return [_line(row) for row in sorted(moves, key=_urgency)]


def _urgency(row: Mapping[str, Any]) -> tuple[bool, float, float]:
    near = _is_nearer(row)
    return not near, row["nearest_m"] if near else 0.0, -row["moved_m"]


def _is_nearer(row: Mapping[str, Any]) -> bool:
    return {"nearest", "nearest_m", "declared_m"} <= row.keys() and bool(row["nearest_m"] < row["declared_m"])


def _line(row: Mapping[str, Any]) -> str:
    text = f"{row.get('vehicle') or row.get('receiver')} moved by {row['moved_m']:.0f} m"
    if _is_nearer(row):
        text += f", now {row['nearest_m']:.0f} m from {row['nearest']} (declared: {row['declared_m']:.0f} m)"
    if "protected_m" in row:
        text += f", within the {row['protected_m']:g} m that avoidance keeps"
    return text
