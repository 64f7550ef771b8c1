"""Results of the shipped studies that have a page: their data in `docs/data/NAME.json`, and the tables of the page.

`python -m tools.docs.measure_studies NAME FOLDER` reads the folder in which `skyrange study run NAME` has flown, and
writes both. `python -m tools.docs.measure_studies NAME` writes the tables again from the data. NAME-ardupilot is the
part of a study that an ArduPilot flies; the page has its command.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import pyarrow as pa

from skyrange.core.parquet_files import read_table
from skyrange.report.marked_page import MarkedPart
from skyrange.study.results import read_results
from tools.docs import accelerometer_failsafe, signing_time
from tools.docs.study_rows import Row

DOCS: Final = Path(__file__).parents[2] / "docs"


class MeasuredStudy(NamedTuple):
    """A shipped study with a page, or a part of it that was flown with another autopilot."""

    page: str
    """Name of the page in `docs/explanation`."""

    tables: tuple[str, ...]
    """Tables that it keeps of each run."""
    measure: Callable[[Row, Mapping[str, pa.Table], Mapping[str, pa.Table]], Row]
    """Measures a run, by its row in the results, its kept tables, and those of the run of the same seed and arm at the
    first point.
    """
    describe: Callable[[Sequence[Row]], list[str]]
    """The lines of the page."""


STUDIES: Final = {
    "accelerometer-failsafe": MeasuredStudy(
        "accelerometer-failsafe", ("events", "truth"), accelerometer_failsafe.measure, accelerometer_failsafe.describe
    ),
    "accelerometer-failsafe-ardupilot": MeasuredStudy(
        "accelerometer-failsafe",
        ("events", "truth"),
        accelerometer_failsafe.measure,
        lambda rows: accelerometer_failsafe.describe_ardupilot(rows, read_data("accelerometer-failsafe")),
    ),
    "accelerometer-failsafe-ardupilot-2": MeasuredStudy(
        "accelerometer-failsafe",
        ("events", "truth"),
        accelerometer_failsafe.measure,
        lambda rows: accelerometer_failsafe.describe_second_ardupilot(rows, read_data("accelerometer-failsafe")),
    ),
    "accelerometer-failsafe-lanes": MeasuredStudy(
        "accelerometer-failsafe",
        ("events", "truth"),
        accelerometer_failsafe.measure,
        lambda rows: accelerometer_failsafe.describe_lanes(
            rows,
            [
                row
                for name in ("accelerometer-failsafe-ardupilot", "accelerometer-failsafe-ardupilot-2")
                for row in read_data(name)
            ],
        ),
    ),
    "signing-time": MeasuredStudy("signing-time", ("events",), signing_time.measure, signing_time.describe),
    "signing-time-ardupilot": MeasuredStudy(
        "signing-time", ("events",), signing_time.measure, signing_time.describe_ardupilot
    ),
}
"""By name, which is that of the file of data as well."""


def measure(name: str, folder: Path) -> list[Row]:
    """The measures of all runs of a study. Raises `ValueError` if a run failed or is missing."""
    study = STUDIES[name]
    runs: list[Row] = read_results(folder, "runs").to_pylist()
    blocks = json.loads((folder / "plan.json").read_text())["blocks"]
    arms = len({run["arm"] for run in runs})
    failed = [f"{run['block']}/{run['arm']}: {run['error']}" for run in runs if run["error"]]
    if failed or len(runs) != blocks * arms:
        raise ValueError(f"{len(runs)} of {blocks * arms} runs, failed: {', '.join(failed) or 'none'}")
    first = {(run["seed"], run["arm"]): run["block"] for run in runs if run["point"] == 0}
    rows = []
    for run in sorted(runs, key=lambda run: (run["point"], run["arm"], run["seed"])):
        kept, reference = (
            {table: _read(folder, table, block, run["arm"]) for table in study.tables}
            for block in (run["block"], first[run["seed"], run["arm"]])
        )
        rows.append({name: run[name] for name in ("point", "arm", "seed")} | study.measure(run, kept, reference))
    return rows


def _read(folder: Path, table: str, block: str, arm: str) -> pa.Table:
    parts = sorted((folder / "kept" / table / block / arm).glob("*.parquet"))
    return pa.concat_tables([read_table(part, str(folder), part.name) for part in parts])


def write_page(name: str, rows: Sequence[Row], page: Path | None = None) -> None:
    """Write the tables of a study into its page."""
    mark = MarkedPart(f"<!-- measured: {name} -->", f"<!-- end: {name} -->")
    mark.write(page or DOCS / "explanation" / f"{STUDIES[name].page}.md", STUDIES[name].describe(rows))


def read_data(name: str) -> list[Row]:
    """The measures of all runs, from `docs/data`."""
    data: dict[str, Any] = json.loads((DOCS / "data" / f"{name}.json").read_text())
    return [dict(zip(data["columns"], values, strict=True)) for values in data["rows"]]


def write_data(name: str, rows: Sequence[Row]) -> None:
    """Write these measures, a run on a line."""
    columns = list(rows[0])
    lines = ",\n".join(json.dumps([row[column] for column in columns], ensure_ascii=False) for row in rows)
    text = f'{{"columns": {json.dumps(columns)}, "rows": [\n{lines}\n]}}\n'
    (DOCS / "data" / f"{name}.json").write_text(text)


if __name__ == "__main__":
    match sys.argv[1:]:
        case [name, folder] if name in STUDIES:
            write_data(name, measure(name, Path(folder)))
            write_page(name, read_data(name))
        case [name] if name in STUDIES:
            write_page(name, read_data(name))
        case _:
            sys.exit(__doc__)
