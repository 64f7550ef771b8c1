"""Summary of a study: means over blocks of what each arm measured at each point, with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.study.sweep.folder import StudyFolder
from skyrange.study.sweep.results import read_results
from skyrange.study.twins.confidence import Interval, interval


class Quantity(NamedTuple):
    """A measure of a run, or of the aircraft that is affected most."""

    name: str
    unit: str
    table: str
    about: str


QUANTITIES: Final = (
    Quantity("missions_complete", "", "runs", "aircraft whose mission is complete"),
    Quantity("collisions", "", "runs", "times that two aircraft collided"),
    Quantity("near_misses", "", "runs", "times that two aircraft in the air came near each other"),
    Quantity("departure_m", "m", "effects", "largest distance of any aircraft from where it is in the baseline"),
    Quantity("extra_distance_m", "m", "effects", "largest additional way of any aircraft"),
    Quantity("delay_s", "s", "effects", "largest delay of any mission that is complete in both"),
)


class Cell(NamedTuple):
    """One arm at one point."""

    arm: str
    values: dict[str, Any]
    """Values of the factors."""
    runs: int
    failed: int
    means: dict[str, Interval]
    """By quantity, over the blocks that have it; by Student's t (`twins.confidence`)."""


def summarise_study(folder: StudyFolder) -> list[Cell]:
    """The cells of a study, by point and arm, in order of the design. Its results must have been written."""
    names = [factor.name for factor in folder.study.factors]
    samples = _samples(folder.path)
    runs = read_results(folder.path, "runs").to_pylist()
    cells = []
    for point in dict.fromkeys(block.point for block in folder.blocks):
        for arm in folder.study.arms:
            own = [row for row in runs if row["point"] == point and row["arm"] == arm.id]
            if not own:
                continue
            found = {
                one.name: mean
                for one in QUANTITIES
                if (mean := interval(samples.get((point, arm.id, one.name), []))) is not None
            }
            failed = sum(row["status"] != "complete" for row in own)
            cells.append(Cell(arm.id, {name: own[0].get(name) for name in names}, len(own), failed, found))
    return cells


def _samples(folder: Path) -> dict[tuple[int, str, str], list[float]]:
    """A number for each block, by point, arm and quantity."""
    found: dict[tuple[int, str, str], list[float]] = {}
    for quantity in QUANTITIES:
        rows: Sequence[dict[str, Any]] = read_results(folder, quantity.table).to_pylist()
        largest: dict[tuple[int, str, str], float] = {}
        for row in rows:
            value = row.get(quantity.name)
            if value is None or not math.isfinite(value):
                continue
            key = row["point"], row["arm"], row["block"]
            if key not in largest or abs(value) > abs(largest[key]):
                largest[key] = float(value)
        for (point, arm, _), value in largest.items():
            found.setdefault((point, arm, quantity.name), []).append(value)
    return found
