"""Members of a data set that is built from the runs of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_TEXT_BYTES, read_input
from skyrange.dataset.members import SCENARIO, Member, Scalar
from skyrange.study.design.blocks import city_of
from skyrange.study.design.factors import CITY
from skyrange.study.design.model import EVERYTHING
from skyrange.study.folder import RUNS, open_folder
from skyrange.study.results import read_results, write_results


def list_dataset_members(folder: Path | str) -> list[Member]:
    """The complete runs of the study in a folder, without splits, in order of the design.

    Raises `InputError` for a study that does not keep its runs whole, or of which nothing is finished.
    """
    opened = open_folder(Path(folder))
    study = opened.study
    if study.keep != EVERYTHING:
        expected = f'"{EVERYTHING}"'
        raise InputError.one(str(opened.path), "keep", repr(study.keep), expected, "Fly the study again with it.")
    write_results(opened)
    departed: dict[tuple[str, str], dict[str, float | None]] = {}
    effects: list[dict[str, Any]] = read_results(opened.path, "effects").to_pylist()
    for row in effects:
        departed.setdefault((row["block"], row["arm"]), {})[row["vehicle"]] = row.get("departed_s")
    runs: list[dict[str, Any]] = read_results(opened.path, "runs").to_pylist()
    complete = {(row["block"], row["arm"]) for row in runs if row["status"] == "complete"}
    members = []
    for block in opened.blocks:
        for arm in study.arms:
            if (block.name, arm.id) not in complete:
                continue
            record = opened.path / RUNS / block.name / arm.id
            city = city_of(study, block)
            factors = {name: _scalar(value) for name, value in block.values.items()}
            if city is not None:
                factors[CITY] = city
            scenario = read_input(record / SCENARIO, str(record), max_bytes=MAX_TEXT_BYTES).decode()
            effects_s = departed.get((block.name, arm.id))
            members.append(Member(record, block.name, arm.id, "", factors, block.seed, scenario, effects_s))
    if not members:
        raise InputError.one(str(opened.path), "blocks", "none finished", "a study with finished runs")
    return members


def _scalar(value: Any) -> Scalar:
    return value if isinstance(value, (str, int, float, bool)) else str(value)
