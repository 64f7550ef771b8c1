"""Making of a radio map: one transmitter after the other, with what is finished kept on disk.

Beside the file FILE the folder FILE.parts holds the map's header and one file of losses for each finished transmitter.
A map that was interrupted continues there, if its header is the same. The folder is removed when the file is written.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, read_input
from skyrange.radio.propagation.loss_table import LossGrid
from skyrange.radio.propagation.loss_table_file import GridHeader, LossTableFile, LossTableHeader, write_loss_table
from skyrange.radio_map.places import MapLayout, is_outside, transmitter_places

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
    told = {**job.header.model_dump(mode="json"), "places": job.places_enu_m.tolist()}
    text = json.dumps(told, indent=1, sort_keys=True).encode()
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
    told = on_transmitter or _untold
    told(len(done), total, None)
    began, traced = clock(), 0
    for k in range(total):
        if k in done and _read_part(job.parts / _part(k), grid.shape) is not None:
            continue
        losses = np.where(outside, tracer.trace(job.places_enu_m[k], grid), np.nan)
        with atomic_write(job.parts / _part(k)) as out:
            np.save(out, np.round(losses, 2).astype(np.float32), allow_pickle=False)
        done.add(k)
        traced += 1
        told(len(done), total, (clock() - began) / traced * (total - len(done)))
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
