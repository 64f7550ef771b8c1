"""How the fixes of GNSS receivers at rest wander: those of logs beside those of a parked simulated aircraft.

The measure is the root of the structure function: the root mean square of the distance between two fixes a time apart.
Unlike a standard deviation it does not grow with the length of the log, and unlike an autocorrelation it needs no mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.geodesy import Origin
from skyrange.flightlog.model import FlightLog, Rows
from skyrange.flightlog.reading import read_log
from skyrange.report.marked_page import MarkedPart
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly

Floats = NDArray[np.float64]
LAGS_S: Final = (1.0, 10.0, 60.0)
TABLE: Final = MarkedPart("<!-- fixes at rest: begin -->", "<!-- fixes at rest: end -->")
_SLACK: Final = 0.3
"""Fixes may be this share of a lag more or less apart: telemetry does not come at an even rate."""
_FIX_3D: Final = 3
_SETTLED_S: Final = 60.0
"""After the first fix of a log the solution converges; what is before is left out."""
_STILL_MPS: Final = 0.3
"""Speed that the estimator of a vehicle at rest stays below; who carries one walks faster."""
_PARKED: Final = """
name = "parked"
duration_s = 660
origin = {{ lat = 47.0, lon = 8.0, alt_msl_m = 400 }}
seed = {seed}
[[operators]]
id = "pilot"
streams = "operator"
  [[operators.vehicles]]
  id = "v1"
  start = [0, 0, 0]
  plan = {{ path = {{ points = [[0, 0, 5]] }}, end = "land" }}
  depart_s = 655
"""


@dataclass(frozen=True, slots=True)
class FixNoise:
    """How fixes at rest wander."""

    name: str
    rest_s: float
    apart_m: Mapping[float, tuple[float, float, int]]
    """By lag in s: root mean square along the ground and upright, in m, and the number of pairs of fixes."""
    hdop: tuple[float, float, float]
    """Percentiles 5, 50 and 95."""
    satellites: tuple[int, int]
    """Least and most."""
    steps: int
    """How often the number of satellites changes."""


def measure_fixes(name: str, log: FlightLog) -> FixNoise:
    """The noise of the fixes of a log while its vehicle is at rest."""
    spans = [rows for rows in _list_rests(log) if len(rows) > 1]
    rows = np.concatenate(spans) if spans else log.tables["gnss"][:0]
    numbers = rows["satellites"]
    shares = np.percentile(rows["hdop"], (5.0, 50.0, 95.0)) if len(rows) else np.full(3, np.nan)
    return FixNoise(
        name,
        float(sum(span["time_s"][-1] - span["time_s"][0] for span in spans)),
        {lag_s: _find_apart(spans, lag_s) for lag_s in LAGS_S},
        (float(shares[0]), float(shares[1]), float(shares[2])),
        (int(numbers.min(initial=99)), int(numbers.max(initial=0))),
        int(sum((np.diff(span["satellites"]) != 0).sum() for span in spans)),
    )


def _list_rests(log: FlightLog) -> list[Rows]:
    """The fixes of each span in which the vehicle is neither armed nor carried."""
    fixes, states, positions = (log.tables[name] for name in ("gnss", "states", "position"))
    fixes = fixes[(fixes["fix"] >= _FIX_3D) & np.isfinite(fixes["lat_deg"])]
    if not len(fixes) or not len(states) or not len(positions):
        return []
    fixes = fixes[fixes["time_s"] >= fixes["time_s"][0] + _SETTLED_S]
    speed_mps = np.hypot(positions["north_mps"], positions["east_mps"])
    moves = states["armed"][_find_before(states, fixes)] | ~(speed_mps[_find_before(positions, fixes)] < _STILL_MPS)
    ends = np.flatnonzero(np.diff(moves.astype(np.int8)) != 0) + 1
    return [fixes[part] for part in np.split(np.arange(len(fixes)), ends) if len(part) and not moves[part[0]]]


def _find_before(rows: Rows, fixes: Rows) -> NDArray[np.int64]:
    """The last row before each fix, or the first."""
    return np.maximum(np.searchsorted(rows["time_s"], fixes["time_s"], side="right") - 1, 0)


def _find_apart(spans: Sequence[Rows], lag_s: float) -> tuple[float, float, int]:
    along, upright = [], []
    for span in spans:
        origin = Origin(float(span["lat_deg"][0]), float(span["lon_deg"][0]), float(span["alt_msl_m"][0]))
        east_m, north_m = origin.to_enu(span["lat_deg"], span["lon_deg"])
        later = np.searchsorted(span["time_s"], span["time_s"] + lag_s)
        first = np.flatnonzero(later < len(span))
        second = later[first]
        near = np.abs(span["time_s"][second] - span["time_s"][first] - lag_s) <= _SLACK * lag_s
        first, second = first[near], second[near]
        along.append((east_m[second] - east_m[first]) ** 2 + (north_m[second] - north_m[first]) ** 2)
        upright.append((span["alt_msl_m"][second] - span["alt_msl_m"][first]) ** 2)
    squares, heights = np.concatenate(along or [np.zeros(0)]), np.concatenate(upright or [np.zeros(0)])
    if not len(squares):
        return np.nan, np.nan, 0
    return float(np.sqrt(squares.mean())), float(np.sqrt(heights.mean())), len(squares)


def fly_parked(seeds: int) -> list[FixNoise]:
    """The noise of simulated receivers on parked aircraft, one for each seed."""
    found = []
    for seed in range(1, seeds + 1):
        with TemporaryDirectory(prefix="skyrange-") as made:
            record = fly(load_text(_PARKED.format(seed=seed)), Path(made) / "run", report=False)
            found.append(measure_fixes(f"seed {seed}", read_log(record.path)))
    return found


def write_lines(logs: Sequence[FixNoise], parked: Sequence[FixNoise]) -> list[str]:
    """The table in Markdown."""
    heads = [f"{lag_s:g} s apart" for lag_s in LAGS_S]
    return [
        f"| fixes at rest | time | {' | '.join(heads)} | HDOP | satellites |",
        f"|{'---|' * (len(heads) + 4)}",
        *(_write_row(noise) for noise in logs),
        _write_row(_pool(parked)),
        "",
        "Root mean square along the ground, and upright in brackets; HDOP as percentiles 5, 50 and 95.",
        "",
    ]


def _pool(parked: Sequence[FixNoise]) -> FixNoise:
    """All simulated receivers as one."""
    apart = {}
    for lag_s in LAGS_S:
        values = np.array([noise.apart_m[lag_s] for noise in parked])
        along, upright = np.sqrt((values[:, :2] ** 2).mean(axis=0))
        apart[lag_s] = float(along), float(upright), int(values[:, 2].sum())
    return FixNoise(
        f"{len(parked)} simulated receivers",
        sum(noise.rest_s for noise in parked),
        apart,
        parked[0].hdop,
        (min(noise.satellites[0] for noise in parked), max(noise.satellites[1] for noise in parked)),
        sum(noise.steps for noise in parked),
    )


def _write_row(noise: FixNoise) -> str:
    if not noise.rest_s:
        return f"| {noise.name} | 0 s |{' – |' * (len(noise.apart_m) + 2)}"
    cells = [f"{along:.2f} m ({upright:.2f} m)" if pairs else "–" for along, upright, pairs in noise.apart_m.values()]
    hdop = " / ".join(f"{value:.2f}" for value in noise.hdop)
    satellites = f"{noise.satellites[0]} to {noise.satellites[1]}, {noise.steps} changes"
    return f"| {noise.name} | {noise.rest_s:.0f} s | {' | '.join(cells)} | {hdop} | {satellites} |"
