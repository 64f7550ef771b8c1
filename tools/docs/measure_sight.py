"""Measured flights with `fusion = "confirm"`: the table of `docs/explanation/sight.md`.

`python -m tools.docs.measure_sight` flies the scenario `remote_id.spoof` with a LiDAR and `SEEDS`, with the ghost and
with a real aircraft in its place, in the weather of `WEATHER`, with the air before the sensor taken to be clear and
with it estimated, and rewrites the table.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.statistics.exact_intervals import proportion_interval
from skyrange.study.runs import fly

PAGE: Final = Path(__file__).parents[2] / "docs" / "explanation" / "sight.md"
SECTION: Final = re.compile(r"<!-- measured: confirm -->\n(.*?)<!-- end: confirm -->\n", re.DOTALL)
SEEDS: Final = 20
SENSOR: Final = (
    'operators.0.vehicles.0.sensors=[{model="hap",stabilised=true,azimuth_deg=[-16,16],pulses=12053,rate_hz=5}]'
)
SCENARIO: Final = (SENSOR, "duration_s=52", 'record.level="study"')
REAL: Final = "a real aircraft"
WEATHER: Final[dict[str, tuple[str, ...]]] = {
    "clear": (),
    "rain, 10 mm/h, law of Goodin et al.": ('optics={rain_mmph=10,rain_law="goodin"}',),
    "fog, visibility 500 m": ("optics={visibility_m=500}",),
    "fog, visibility 200 m": ("optics={visibility_m=200}",),
}
"""Changes of the scenario."""


class Arm(NamedTuple):
    """A way to fly."""

    air: str
    weather: str
    there: str


ARMS: Final = [
    *(Arm(air, "clear", "a ghost") for air in ("clear", "estimated")),
    *(Arm(air, weather, REAL) for air in ("clear", "estimated") for weather in WEATHER),
]


class Flight(NamedTuple):
    """What a flight came to."""

    first: str
    """The first verdict; empty for none, which is *could not look* to the end."""
    away_m: float
    """From the claimed position at the first verdict."""
    resumed_s: float | None
    """When the mission went on, if it did."""
    nearest_m: float | None
    """Least distance of the real aircraft."""


def main() -> None:
    """Fly, judge and rewrite the table."""
    lines = [
        "| the air is taken to be | the air is | there is | called *not seen* | *seen* first | first verdict at |"
        " mission resumed at | least distance |",
        "|---|---|---|---|---|---|---|---|",
    ]
    with ProcessPoolExecutor(2) as pool:
        for arm in ARMS:
            lines.append(describe(arm, list(pool.map(partial(observe, arm), range(1, SEEDS + 1)))))
            print(lines[-1], flush=True)
    table = "\n".join(lines)
    block = f"<!-- measured: confirm -->\n{table}\n<!-- end: confirm -->\n"
    PAGE.write_text(SECTION.sub(lambda _: block, PAGE.read_text(encoding="utf-8")), encoding="utf-8")


def describe(arm: Arm, flights: Sequence[Flight]) -> str:
    """The row of a way to fly."""
    count = len(flights)
    missed = sum(one.first == "not-seen" for one in flights)
    low, high = proportion_interval(missed, count, 0.95)
    distances = [one.away_m for one in flights if one.first]
    resumed = [one.resumed_s for one in flights if one.resumed_s is not None]
    nearest = [one.nearest_m for one in flights if one.nearest_m is not None]
    cells = [
        arm.air,
        arm.weather,
        arm.there,
        f"{missed} of {count} ({100 * low:.0f} to {100 * high:.0f} %)",
        f"{sum(one.first == 'seen' for one in flights)} of {count}",
        f"{min(distances):.0f} to {max(distances):.0f} m" if distances else "–",
        f"{median(resumed):.1f} s ({len(resumed)} of {count})" if resumed else "–",
        f"{min(nearest):.1f} m" if nearest else "–",
    ]
    return f"| {' | '.join(cells)} |"


def observe(arm: Arm, seed: int) -> Flight:
    """Fly once."""
    avoidance = f'operators.0.avoidance={{kind="geometric",fusion="confirm",sight={{air="{arm.air}"}}}}'
    honest = "true" if arm.there == REAL else "false"
    changes = [*SCENARIO, avoidance, f"attacks.ghost.honest={honest}", *WEATHER[arm.weather]]
    with tempfile.TemporaryDirectory() as folder:
        return judge(fly(load("remote_id.spoof", changes, seed=seed), Path(folder) / "run"))


def judge(record: RunRecord) -> Flight:
    """What a flight came to, by its notes and its truth."""
    verdicts = [note for note in read_notes(record, "events") if note.kind == "event.sight"]
    resumed = [note.time_ns / 1e9 for note in read_notes(record, "decisions") if note.kind == "decision.resume"]
    first = verdicts[0].data if verdicts else {}
    places: dict[int, dict[str, tuple[float, float, float]]] = {}
    for row in record.table("truth").to_pylist():
        place = (row["east_m"], row["north_m"], row["up_m"])
        places.setdefault(row["time_ns"], {})[row["vehicle"]] = place
    apart = [math.dist(*flown.values()) for flown in places.values() if len(flown) == 2]
    return Flight(
        str(first.get("verdict", "")),
        float(first.get("away_m", 0.0)),
        resumed[0] if resumed else None,
        min(apart) if apart else None,
    )


if __name__ == "__main__":
    main()
