"""A matrix that was never flown: the shipped rows and columns, with cells of every state."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

from skyrange.study.matrix.cells import Cell, Nominal
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, read_matrix

FAULTS = ("gust", "multipath", "link-loss")
LEFT = {"stops": 0.02, "half": 0.4, "remains": 1.0, "lost": 0.3}
"""The share of the effect that a defence leaves."""


def make_matrix(path: Path, seed: int = 3, seeds: int = 14) -> MatrixResult:
    """`seed` chooses the states of the cells."""
    matrix, random = read_matrix(), Random(seed)
    matrix = matrix.model_copy(update={"seeds": seeds})
    flat: dict[str, Any] = {
        "growth_m_per_min": [None] * seeds,
        "watched_s": [60.0] * seeds,
        "nominal": [Nominal([50.0], [1000.0], [True], f"flight {k}", 100, {}) for k in range(seeds)],
        "flown_h": [0.02] * seeds,
        "false_alarms": [0] * seeds,
        "complete": [True] * seeds,
        "alarms_s": [None] * seeds,
    }
    cells: dict[tuple[str, str], Cell] = {}
    for row in matrix.rows:
        fault = row.id in FAULTS
        harm = [random.uniform(40.0, 60.0) for _ in range(seeds)]
        idle = ("firewall",) if row.id == "barometer" else ()
        known: dict[str, Any] = {"fault": fault, "fault_alarms": [0] * seeds if fault else []}
        cells[row.id, UNDEFENDED] = Cell(row.id, UNDEFENDED, effects=harm, idle=idle, **flat, **known)
        for column in matrix.columns:
            kind = random.choice(["refused", *LEFT])
            if kind == "refused" and column.id not in idle:
                cells[row.id, column.id] = Cell(row.id, column.id, fault=fault, refused="there is no such link")
                continue
            effects = [LEFT.get(kind, 1.0) * value * random.uniform(0.9, 1.1) for value in harm]
            if kind == "half":
                effects[: seeds // 2] = harm[: seeds // 2]
                effects[seeds // 2 :] = [0.0] * (seeds - seeds // 2)
            lost = {"complete": [k % 3 > 0 for k in range(seeds)]} if kind == "lost" else {}
            alarms = {"alarms_s": [3.0] * seeds} if random.random() < 0.5 and not fault else {}
            knows = Cell(row.id, column.id, effects=harm, candidate="weaker", **flat)
            cells[row.id, column.id] = Cell(
                row.id, column.id, effects=effects, adaptive=(knows,) if random.random() < 0.4 and not fault else (),
                folder=f"cells/{row.id}/{column.id}" if random.random() < 0.5 else "",
                **{**flat, **known, **lost, **alarms},
            )  # fmt: skip
    return MatrixResult(path, matrix, cells)
