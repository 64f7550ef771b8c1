"""Loss tables for tests, from a tracer that needs no program: free space plus a constant, or plus a shadow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.radio.propagation.loss_table import LossGrid, free_space_of
from skyrange.radio.propagation.loss_table_file import LossTableFile
from skyrange.radio_map.mapping import MapLayout, prepare_map, trace_map

TRACER = {"name": "free space", "version": "1"}


class ExcessTracer:
    """The loss of free space plus `excess_db` everywhere; `traced` are the places it was asked for."""

    def __init__(self, excess_db: float, fail_after: int = 1_000_000) -> None:
        self.excess_db = excess_db
        self.fail_after = fail_after
        self.traced: list[tuple[float, ...]] = []

    def trace(self, place_enu_m: NDArray[np.float64], grid: LossGrid) -> NDArray[np.float32]:
        if len(self.traced) == self.fail_after:
            raise KeyboardInterrupt
        self.traced.append(tuple(place_enu_m.tolist()))
        return (free_space_of(place_enu_m, grid, 2437.0) + self.excess_db).astype(np.float32)


def make_table(
    path: Path, city: City, layout: MapLayout, fixed: Sequence[tuple[float, float, float]] = (), excess_db: float = 20.0
) -> LossTableFile:
    """A table of `ExcessTracer`, written to `path`."""
    return trace_map(prepare_map(city, layout, fixed, 2437.0, TRACER, path), ExcessTracer(excess_db))
