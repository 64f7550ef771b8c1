"""Making of a radio map: its area, receivers and transmitters, one transmitter computed after the other.

Beside the file FILE the folder FILE.parts holds the map's header and one file of losses for each finished transmitter.
A map that was interrupted continues there, if its header is the same. The folder is removed when the file is written.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import monotonic
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import MIB, atomic_write, read_input
from skyrange.radio.propagation.loss_table import LossGrid
from skyrange.radio.propagation.loss_table_file import GridHeader, LossTableFile, LossTableHeader, write_loss_table

MAX_TRANSMITTERS: Final = 400
"""Most transmitters of one map: half an hour to an hour of tracing on two cores."""
MAX_RECEIVERS: Final = 500_000
REACH_OF_SPACING: Final = 0.75
"""Reach of a place as a share of the spacing of the transmitters: a little more than half of a square's diagonal."""

Area = tuple[float, float, float, float]
"""West, south, east and north edge in metres."""


@dataclass(frozen=True, slots=True)
class MapLayout:
    """What a map covers. Lengths are metres; heights are above the ground."""

    area: Area
    spacing_m: float = 10.0
    """Spacing of the receivers."""
    heights_m: tuple[float, ...] = (1.5, 30.0, 60.0, 90.0, 120.0)
    """Heights of the receivers: a person's hand, and aircraft up to the 120 m of most rules."""
    transmitter_spacing_m: float = 100.0
    transmitter_heights_m: tuple[float, ...] = (60.0,)
    reach_up_m: float = 15.0
    """Vertical reach of a transmitter place."""

    @property
    def reach_m(self) -> float:
        """Horizontal reach of a transmitter place."""
        return REACH_OF_SPACING * self.transmitter_spacing_m

    @property
    def grid(self) -> LossGrid:
        """The grid of receivers: points in the middle of squares that fill the area."""
        west, south, east, north = self.area
        columns, rows = (max(1, math.ceil(round(w / self.spacing_m, 6))) for w in (east - west, north - south))
        first_east = 0.5 * (west + east) - 0.5 * (columns - 1) * self.spacing_m
        first_north = 0.5 * (south + north) - 0.5 * (rows - 1) * self.spacing_m
        return LossGrid(first_east, first_north, self.spacing_m, columns, rows, self.heights_m)

    def check(self) -> None:
        """Raise one `InputError` with everything that is wrong."""
        west, south, east, north = self.area
        problems = []
        if not (all(map(math.isfinite, self.area)) and west < east and south < north):
            problems.append(Problem("area", repr(list(self.area)), "[west, south, east, north] in metres"))
        for name, value in (("spacing", self.spacing_m), ("transmitter spacing", self.transmitter_spacing_m)):
            if not 1.0 <= value <= 10_000.0:
                problems.append(Problem(name, f"{value:g}", "1 to 10000 m"))
        for name, heights in (("heights", self.heights_m), ("transmitter heights", self.transmitter_heights_m)):
            rising = all(low < high for low, high in pairwise(heights))
            if not rising or not all(0.5 <= height <= 1_000.0 for height in heights):
                problems.append(Problem(name, repr(list(heights)), "ascending heights from 0.5 to 1000 m"))
        if not 1 <= len(self.heights_m) <= 20:
            problems.append(Problem("heights", f"{len(self.heights_m)} heights", "1 to 20 of them"))
        if not problems and math.prod(self.grid.shape) > MAX_RECEIVERS:
            hint = "Take a wider spacing, fewer heights or a smaller area."
            problems.append(Problem("receivers", f"{math.prod(self.grid.shape):,}", f"at most {MAX_RECEIVERS:,}", hint))
        if problems:
            raise InputError("radio map", problems)


def transmitter_places(
    layout: MapLayout, city: City, fixed: Sequence[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """(t, 3) places: the fixed radios, then a grid over the area, without those inside buildings.

    Raises `InputError` if there are none or too many of them.
    """
    west, south, east, north = layout.area
    step = layout.transmitter_spacing_m
    places = list(dict.fromkeys(fixed))
    for up in layout.transmitter_heights_m:
        for y in _centred(south, north, step):
            places += [(x, y, up) for x in _centred(west, east, step)]
    if len(places) > 50 * MAX_TRANSMITTERS:
        raise _too_many(len(places))
    free = [place for place in places if city.inside(*place) is None]
    if len(free) > MAX_TRANSMITTERS:
        raise _too_many(len(free))
    if not free:
        expected = "at least one transmitter outside buildings"
        raise InputError.one("radio map", "transmitters", "none", expected, "Add heights above the roofs.")
    return np.array(free, dtype=np.float64)


def _centred(low: float, high: float, step: float) -> list[float]:
    count = max(1, int((high - low) / step + 1e-6))
    first = 0.5 * (low + high) - 0.5 * (count - 1) * step
    return [first + k * step for k in range(count)]


def _too_many(count: int) -> InputError:
    hint = "Take a wider --transmitter-spacing, fewer --transmitter-heights or a smaller --area."
    return InputError.one("radio map", "transmitters", f"{count:,}", f"at most {MAX_TRANSMITTERS}", hint)


def is_outside(city: City, grid: LossGrid) -> NDArray[np.bool_]:
    """(heights, rows, columns): whether each point of a grid is outside buildings."""
    points = grid.points_enu_m.reshape(-1, 3).tolist()
    return np.array([city.inside(*point) is None for point in points]).reshape(grid.shape)


PARTS: Final = ".parts"
_JOB: Final = "map.json"

Place = tuple[float, float, float]
OnTransmitter = Callable[[int, int, float | None], None]
"""Told how many transmitters are finished, of how many, and the estimated seconds left; None before the first."""


class Tracer(Protocol):
    """A ray tracer with a city."""

    def trace(self, place_enu_m: NDArray[np.float64], grid: LossGrid) -> NDArray[np.float32]:
        """(heights, rows, columns) losses in dB, not-a-number where there is no path."""
        ...


@dataclass(frozen=True, slots=True)
class MapJob:
    """A map that was checked and is ready to be traced."""

    city: City
    path: Path
    places_enu_m: NDArray[np.float64]
    header: LossTableHeader

    @property
    def parts(self) -> Path:
        """The folder of what is finished."""
        return self.path.with_name(self.path.name + PARTS)

    def finished(self) -> list[int]:
        """The transmitters that an interrupted map has finished."""
        return [k for k in range(len(self.places_enu_m)) if (self.parts / _part(k)).is_file()]


def prepare_map(
    city: City, layout: MapLayout, fixed: Sequence[Place], frequency_mhz: float, tracer: Mapping[str, Any], path: Path
) -> MapJob:
    """Check everything and create the folder of parts. `fixed` are the places of radios that do not move.

    Raises `InputError` for a layout that cannot be, for an output that cannot be written, and for parts of another map.
    """
    from skyrange import __version__

    layout.check()
    places = transmitter_places(layout, city, fixed)
    header = LossTableHeader(
        skyrange=__version__,
        tracer=dict(tracer),
        buildings=city.digest(),
        frequency_mhz=frequency_mhz,
        reach_m=layout.reach_m,
        reach_up_m=layout.reach_up_m,
        grid=GridHeader(**layout.grid._asdict()),
    )
    job = MapJob(city, path, places, header)
    _claim(job)
    return job


def _claim(job: MapJob) -> None:
    description = {**job.header.model_dump(mode="json"), "places": job.places_enu_m.tolist()}
    text = json.dumps(description, indent=1, sort_keys=True).encode()
    try:
        if job.path.is_dir() or not os.access(job.path.parent, os.W_OK | os.X_OK):
            value = "a folder" if job.path.is_dir() else f"{job.path.parent} is missing or read-only"
            raise InputError.one("radio map", str(job.path), value, "a file that can be written")
        job.parts.mkdir(exist_ok=True)
        file = job.parts / _JOB
        if file.exists() and read_input(file, "radio map", max_bytes=MIB) != text:
            hint = f"Delete that folder, choose another -o, or repeat with the settings in {file.name}."
            raise InputError.one("radio map", str(job.parts), "parts of another map", "parts of this map or none", hint)
        with atomic_write(file) as out:
            out.write(text)
    except OSError as error:
        raise InputError.one(
            "radio map", str(job.path), (error.strerror or str(error)).lower(), "a file that can be written"
        ) from None


def trace_map(
    job: MapJob, tracer: Tracer, on_transmitter: OnTransmitter | None = None, clock: Callable[[], float] = monotonic
) -> LossTableFile:
    """Trace what is not finished, write the file, remove the parts, and return the content of the file.

    Raises `OSError` if a part or the file cannot be written.
    """
    grid = job.header.grid.grid
    total, done = len(job.places_enu_m), set(job.finished())
    outside = is_outside(job.city, grid)
    report = on_transmitter or _untold
    report(len(done), total, None)
    began, traced = clock(), 0
    for k in range(total):
        if k in done and _read_part(job.parts / _part(k), grid.shape) is not None:
            continue
        losses = np.where(outside, tracer.trace(job.places_enu_m[k], grid), np.nan)
        with atomic_write(job.parts / _part(k)) as out:
            np.save(out, np.round(losses, 2).astype(np.float32), allow_pickle=False)
        done.add(k)
        traced += 1
        report(len(done), total, (clock() - began) / traced * (total - len(done)))
    losses = np.stack([_part_of(job, k, grid.shape) for k in range(total)])
    content = LossTableFile(job.header, job.places_enu_m, losses)
    write_loss_table(job.path, content)
    shutil.rmtree(job.parts, ignore_errors=True)
    return content


def _untold(done: int, total: int, left_s: float | None) -> None:
    pass


def _part(number: int) -> str:
    return f"{number:04}.npy"


def _read_part(path: Path, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """The losses of a finished transmitter; None for a file that is damaged."""
    try:
        losses = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return losses if losses.shape == shape and losses.dtype == np.float32 else None


def _part_of(job: MapJob, number: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    path = job.parts / _part(number)
    losses = _read_part(path, shape)
    if losses is None:
        raise InputError.one("radio map", str(path), "changed meanwhile", "the losses that were traced")
    return losses
