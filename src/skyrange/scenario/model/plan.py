"""Plans of aircraft: a square, a path or a mission file, flown as a mission or as a sequence of guided targets.

Squares and paths are relative to the aircraft's start: east, north and up in metres, with up counted from the
ground there.
"""

from __future__ import annotations

from os import PathLike, fspath
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from skyrange.core.errors import Problem
from skyrange.scenario.model.base import FileName, Model, Number, items, refuse, wrong

Point = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]

FILE_SUFFIXES = (".plan", ".waypoints", ".txt")
"""Suffixes of the mission files that skyrange reads: QGroundControl plans, and the two usual ones of QGC WPL 110."""


class Square(Model):
    """A square. The aircraft takes off at its south-west corner and flies the sides north, east, south and west."""

    side_m: Number = Field(gt=0, le=100_000, description="Length of a side in metres.")
    alt_m: Number = Field(gt=0, le=10_000, description="Flight height above the ground at the start, in metres.")


class Path(Model):
    """A path. The aircraft takes off at its start and flies from point to point."""

    points: Annotated[tuple[Point, ...], BeforeValidator(items)] = Field(
        min_length=1,
        max_length=700,
        description="Points [east_m, north_m] or [east_m, north_m, up_m] in metres from the start, in order of flight.",
    )
    alt_m: Number | None = Field(
        default=None, gt=0, le=10_000, description="Height in metres of the points without an up_m."
    )

    @model_validator(mode="after")
    def _above_ground(self) -> Path:
        problems = []
        for index, point in enumerate(self.points):
            if len(point) == 3 and not 0 < point[2] <= 10_000:
                problems.append(
                    Problem(f"points.{index}", repr(list(point)), "an up_m more than 0 and at most 10000 m")
                )
            elif len(point) == 2 and self.alt_m is None:
                problems.append(
                    Problem(
                        f"points.{index}", repr(list(point)), "[east_m, north_m, up_m]", "Or set alt_m of the path."
                    )
                )
        if problems:
            raise refuse(*problems)
        return self

    @property
    def points_enu_m(self) -> tuple[tuple[float, float, float], ...]:
        """Every point as (east, north, up) in metres from the start."""
        alt_m = self.alt_m or 0.0
        return tuple((point[0], point[1], point[2] if len(point) == 3 else alt_m) for point in self.points)


Ground = tuple[Number, Number]
Place = Annotated[tuple[Number, Number, Number], BeforeValidator(items)]


class Route(Model):
    """A route that skyrange plans around the buildings of the city. The aircraft takes off at its start."""

    to: Ground = Field(description="Where it ends, [east_m, north_m] in metres from the start.")
    via: Annotated[tuple[Ground, ...], BeforeValidator(items)] = Field(
        default=(), max_length=64, description="Places that it leads through, in order, as `to`."
    )
    alt_m: Number = Field(gt=0, le=10_000, description="Height above the ground in metres that it keeps where it can.")
    ceiling_m: Number = Field(default=120.0, gt=0, le=10_000, description="Its greatest height in metres.")
    clearance_m: Number = Field(default=5.0, ge=1, le=15, description="Least distance from walls and roofs, in metres.")
    minimize: Literal["time", "energy"] = Field(
        default="time",
        description="time: the quickest way; energy: the one that takes the least from the battery in the mean wind.",
    )
    planner: Literal["lattice", "ompl"] = Field(
        default="lattice",
        description="lattice: A* on a lattice of 3 m, for large fleets; ompl: BIT* of the Open Motion Planning "
        "Library, which is slower, and may find gaps that the lattice misses. It needs skyrange[planning].",
    )
    iterations: int = Field(
        default=20_000, ge=100, le=1_000_000, description="How long ompl searches each leg, in iterations."
    )

    @model_validator(mode="after")
    def _below_the_ceiling(self) -> Route:
        if self.alt_m > self.ceiling_m:
            raise wrong(f"{self.alt_m:g}", f"at most the ceiling_m of {self.ceiling_m:g} m", where="alt_m")
        if self.to == (0.0, 0.0) and not self.via:
            raise wrong("[0, 0]", "another place than the start", where="to")
        return self


class FenceCircle(Model):
    """A circle of a fence."""

    center: Ground = Field(description="Centre, [east_m, north_m] in metres from the start.")
    radius_m: Number = Field(gt=0, le=100_000, description="Radius in metres.")
    inclusion: bool = Field(default=True, description="Whether the aircraft has to stay inside, or outside.")


class FencePolygon(Model):
    """A polygon of a fence."""

    points: Annotated[tuple[Ground, ...], BeforeValidator(items)] = Field(
        min_length=3, max_length=255, description="Corners [east_m, north_m] in metres from the start, in order."
    )
    inclusion: bool = Field(default=True, description="Whether the aircraft has to stay inside, or outside.")


class Fence(Model):
    """A fence that the ground station uploads. It acts where the autopilot's FENCE_ENABLE is 1."""

    circles: Annotated[tuple[FenceCircle, ...], BeforeValidator(items)] = Field(
        default=(), max_length=32, description="Circles."
    )
    polygons: Annotated[tuple[FencePolygon, ...], BeforeValidator(items)] = Field(
        default=(), max_length=32, description="Polygons."
    )

    @model_validator(mode="after")
    def _not_empty(self) -> Fence:
        if not (self.circles or self.polygons):
            raise wrong("none", "a circle or a polygon")
        return self


class Plan(Model):
    """A flight plan: exactly one of `square`, `path`, `route` and `file`, and how to fly it."""

    square: Square | None = Field(default=None, description="Square to fly.")
    path: Path | None = Field(default=None, description="Path to fly.")
    route: Route | None = Field(default=None, description="Route to plan around buildings, and fly.")
    file: FileName | None = Field(
        default=None,
        description="Mission file to fly: a QGroundControl .plan, or QGC WPL 110 (.waypoints, .txt). "
        "The path is relative to the scenario file.",
    )
    mode: Literal["auto", "guided"] = Field(
        default="auto",
        description="auto: the ground station uploads a mission, which the autopilot flies; guided: the ground "
        "station sends one target after another.",
    )
    end: Literal["land", "rtl"] | None = Field(
        default=None,
        description="End of the flight: land in place, or return to launch. Default: land for a square or a route, rtl "
        "for a path. A mission file sets its own end.",
    )
    speed_mps: Number | None = Field(
        default=None,
        gt=0,
        le=50,
        description="Ground speed in m/s, except of a mission file, which sets its own; default: 5 m/s.",
    )
    anchor: Literal["file", "start"] | None = Field(
        default=None,
        description="Position of a mission file. file: fly at the coordinates in the file (the default); start: shift "
        "the mission so that its home is at the start of the aircraft.",
    )
    fence: Fence | None = Field(
        default=None,
        description="Fence that the ground station uploads with the plan. A .plan file may have one of its own.",
    )
    rally: Annotated[tuple[Place, ...], BeforeValidator(items)] = Field(
        default=(),
        max_length=100,
        description="Rally points that the ground station uploads with the plan, [east_m, north_m, up_m] in metres "
        "from the start. A .plan file may have its own.",
    )
    rejection_expected: bool = Field(
        default=False,
        description="Whether the autopilot is expected to reject the mission. Otherwise an item that it will reject is "
        "an error, and a run in which it rejects the mission falls short.",
    )
    failure_expected: bool = Field(
        default=False,
        description="Whether the mission is expected to fail without an attack or a fault too. Otherwise a pair, a "
        "comparison, a matrix or a study in which it does falls short.",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Plan:
        kinds = ("square", "path", "route", "file")
        given = [name for name in kinds if getattr(self, name) is not None]
        if len(given) != 1:
            raise wrong(" and ".join(given) or "none", "exactly one of square, path, route and file")
        if self.file is None:
            if self.anchor is not None:
                raise wrong(
                    self.anchor, "no anchor, because only a mission file has coordinates of its own", where="anchor"
                )
            if self.end is None:
                object.__setattr__(self, "end", "rtl" if self.path is not None else "land")
            return self
        problems = []
        if self.mode != "auto":
            problems.append(Problem("mode", self.mode, "auto, because the autopilot flies a mission file"))
        if self.end is not None:
            problems.append(Problem("end", self.end, "no end, because the mission file sets it"))
        if self.speed_mps is not None:
            hint = "To change the speed, set the autopilot parameter WPNAV_SPEED, in cm/s."
            problems.append(
                Problem("speed_mps", repr(self.speed_mps), "no speed, because the mission file sets it", hint)
            )
        if not self.file.lower().endswith(FILE_SUFFIXES):
            problems.append(Problem("file", self.file, f"a name that ends in {' or '.join(FILE_SUFFIXES)}"))
        if problems:
            raise refuse(*problems)
        if self.anchor is None:
            object.__setattr__(self, "anchor", "file")
        return self


def square(side_m: float, alt_m: float, **how: Any) -> Plan:
    """A plan to fly a square of `side_m` at `alt_m`; `how` accepts `mode`, `end` and `speed_mps`."""
    return Plan(square=Square(side_m=side_m, alt_m=alt_m), **how)


def path(points: Any, alt_m: float | None = None, **how: Any) -> Plan:
    """A plan to fly `points`, a sequence or (n, 2) or (n, 3) array of metres from the start; `how` as in `square`."""
    return Plan(path=Path(points=points, alt_m=alt_m), **how)


def mission_file(name: str | PathLike[str], **how: Any) -> Plan:
    """A plan to fly a mission file; `how` accepts `anchor`."""
    return Plan(file=fspath(name), **how)


def route(to: Any, alt_m: float, **how: Any) -> Plan:
    """A plan to fly to `to`, [east_m, north_m] from the start, around buildings; `how` accepts those of `Route` and of
    `square`.
    """
    route_fields = {name: how.pop(name) for name in Route.model_fields if name in how}
    return Plan(route=Route(to=to, alt_m=alt_m, **route_fields), **how)
