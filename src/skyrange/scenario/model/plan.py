"""Plans of aircraft: a square, a path, or a mission file, sent as a mission or as targets.

Squares and paths are relative to the aircraft's start: east, north and up in metres, up measured from
the ground there.
"""

from __future__ import annotations

from os import PathLike, fspath
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from skyrange.core.errors import Problem
from skyrange.scenario.model.base import FileName, Model, Number, items, refuse, wrong

Point = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]

FILE_SUFFIXES = (".plan", ".waypoints", ".txt")
"""Mission files that can be read: QGroundControl plans, and QGC WPL 110 under its two usual names."""


class Square(Model):
    """Up at the start, which is the south-west corner; then north, east, south and west along one side each."""

    side_m: Number = Field(gt=0, le=100_000, description="Length of a side in metres.")
    alt_m: Number = Field(gt=0, le=10_000, description="Height of flight above the start's ground, in metres.")


class Path(Model):
    """Up at the start, then from point to point."""

    points: Annotated[tuple[Point, ...], BeforeValidator(items)] = Field(
        min_length=1,
        max_length=700,
        description="Points [east_m, north_m] or [east_m, north_m, up_m] in metres from the start, in order of flight.",
    )
    alt_m: Number | None = Field(
        default=None, gt=0, le=10_000, description="Height in metres of the points that give no up_m of their own."
    )

    @model_validator(mode="after")
    def _above_ground(self) -> Path:
        faults = []
        for index, point in enumerate(self.points):
            if len(point) == 3 and not 0 < point[2] <= 10_000:
                faults.append(Problem(f"points.{index}", repr(list(point)), "an up_m more than 0 and at most 10000 m"))
            elif len(point) == 2 and self.alt_m is None:
                faults.append(
                    Problem(
                        f"points.{index}", repr(list(point)), "[east_m, north_m, up_m]", "Or give the path an alt_m."
                    )
                )
        if faults:
            raise refuse(*faults)
        return self

    @property
    def points_enu_m(self) -> tuple[tuple[float, float, float], ...]:
        """Every point as (east, north, up) in metres from the start."""
        alt_m = self.alt_m or 0.0
        return tuple((point[0], point[1], point[2] if len(point) == 3 else alt_m) for point in self.points)


class Plan(Model):
    """Exactly one of `square`, `path` and `file`, and how to fly it."""

    square: Square | None = Field(default=None, description="Fly a square.")
    path: Path | None = Field(default=None, description="Fly from point to point.")
    file: FileName | None = Field(
        default=None,
        description="Fly a mission file: a QGroundControl .plan, or QGC WPL 110 (.waypoints, .txt). "
        "The name is relative to the scenario's file.",
    )
    mode: Literal["auto", "guided"] = Field(
        default="auto",
        description="auto: the autopilot holds the mission; guided: the ground station sends one target after another.",
    )
    end: Literal["land", "rtl"] | None = Field(
        default=None,
        description="How it ends: land where it is, or return to launch. Default: land for a square, rtl for a path; "
        "a file says it itself.",
    )
    speed_mps: Number | None = Field(
        default=None,
        gt=0,
        le=50,
        description="Speed over ground in m/s of a square or path; default: 5 m/s. A file sets its own.",
    )
    anchor: Literal["file", "start"] | None = Field(
        default=None,
        description="Files only. file: fly at the coordinates in the file (the default); start: shift the mission so "
        "that its home lies where the aircraft starts.",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Plan:
        kinds = ("square", "path", "file")
        given = [name for name in kinds if getattr(self, name) is not None]
        if len(given) != 1:
            raise wrong(" and ".join(given) or "none of them", "exactly one of square, path and file")
        if self.file is None:
            if self.anchor is not None:
                raise wrong(self.anchor, "no anchor: a square or path is relative to the start", where="anchor")
            if self.end is None:
                object.__setattr__(self, "end", "land" if self.square is not None else "rtl")
            return self
        faults = []
        if self.mode != "auto":
            faults.append(Problem("mode", self.mode, "auto: a mission file is flown by the autopilot"))
        if self.end is not None:
            faults.append(Problem("end", self.end, "no end: the mission file says how it ends"))
        if self.speed_mps is not None:
            hint = "Or set the autopilot's parameter WPNAV_SPEED, in cm/s."
            faults.append(Problem("speed_mps", repr(self.speed_mps), "no speed: the mission file sets its own", hint))
        if not self.file.lower().endswith(FILE_SUFFIXES):
            faults.append(Problem("file", self.file, f"a name that ends in {', '.join(FILE_SUFFIXES)}"))
        if faults:
            raise refuse(*faults)
        if self.anchor is None:
            object.__setattr__(self, "anchor", "file")
        return self


def square(side_m: float, alt_m: float, **how: Any) -> Plan:
    """A plan to fly a square of `side_m` at `alt_m`; `how` takes `mode`, `end` and `speed_mps`."""
    return Plan(square=Square(side_m=side_m, alt_m=alt_m), **how)


def path(points: Any, alt_m: float | None = None, **how: Any) -> Plan:
    """A plan to fly `points`, a sequence or (n, 2) or (n, 3) array of metres from the start; `how` as `square`."""
    return Plan(path=Path(points=points, alt_m=alt_m), **how)


def mission_file(name: str | PathLike[str], **how: Any) -> Plan:
    """A plan to fly a mission file; `how` takes `anchor`."""
    return Plan(file=fspath(name), **how)
