"""Does the summary of a matrix tell what a defence does with benign faults?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from skyrange.study.matrix.cells import Cell, Nominal
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import Matrix
from skyrange.study.matrix.sections import make_sections
from skyrange.study.matrix.summary import cost_of
from skyrange.study.matrix.verdicts import judge_cells

MATRIX = Matrix.model_validate(
    {
        "name": "m",
        "seeds": 2,
        "rows": [
            {"id": name, "scenario": "gnss.multipath", "measure": "departure_m"}
            for name in ("multipath", "gust", "loss")
        ],
        "columns": [{"id": name, "defences": [{"kind": "gnss.innovation"}]} for name in ("harmful", "mild", "absent")],
    }
)


def _cell(row: str, column: str, effects: Sequence[float], alarms: Sequence[int] = (0, 0), **more: Any) -> Cell:
    hours, nominal = [0.02, 0.02], [Nominal([60.0], [100.0], [True], f"{row} {seed}", 10) for seed in (1, 2)]
    return Cell(
        row, column, fault=True, effects=effects, complete=[True] * len(effects), fault_alarms=alarms, flown_h=hours,
        nominal=nominal, false_alarms=[0, 0], alarms_s=[None, None], watched_s=[1.0, 1.0], **more,
    )  # fmt: skip


def _result() -> MatrixResult:
    cells = [
        _cell("multipath", "none", [10.0, 14.0]),
        _cell("multipath", "harmful", [140.0, 160.0], [5, 4]),
        _cell("multipath", "mild", [10.5, 14.2]),
        _cell("gust", "none", [3.0, 3.0]),
        _cell("gust", "harmful", [3.0, 3.0]),
        _cell("gust", "mild", [3.0, 3.0], [1, 0]),
        _cell("loss", "none", [17.0, 18.0]),
        _cell("loss", "harmful", [10.0, 31.0]),
        _cell("loss", "mild", [17.0, 18.0]),
        *(Cell(row, "absent", fault=True, refused="no radio") for row in ("multipath", "gust", "loss")),
    ]
    return MatrixResult(Path("m"), MATRIX, {(cell.row, cell.column): cell for cell in cells})


def test_harm_with_faults_is_an_effect_that_grows_or_an_alarm() -> None:
    """A mean that is larger in two flights that differ much shows nothing: `loss` with the first defence."""
    result = _result()
    harmful, mild, absent = (cost_of(result, column).faults for column in MATRIX.columns)
    assert [(one.row, one.without, one.defended, one.alarms_per_h) for one in harmful if one.is_harm] == [
        ("multipath", 12.0, 150.0, 225.0)
    ]
    assert [(one.row, one.alarms_per_h) for one in mild if one.is_harm] == [("gust", 25.0)]
    assert absent == ()


def test_the_summary_of_a_page_has_it() -> None:
    section = next(one for one in make_sections(_result()) if one.title == "Cost and worth of each defence")
    place = list(section.head).index("with benign faults")
    assert [row[place].text for row in section.rows] == [
        "multipath: 12.0 → 150.0 m, 225 alarms/h",
        "gust: 3.0 → 3.0 m, 25 alarms/h",
        "–",
    ]
    frames = list(section.head).index("frames an aircraft-hour")
    assert [row[frames].text for row in section.rows] == ["+0", "+0", "–"], "nothing is said of what was not flown"


def test_a_defence_that_breaks_the_mission_while_nobody_attacks_stops_nothing() -> None:
    """Its baseline lies on the ground, so the attack has no effect and no mission is lost to it."""
    flies, lies = (Nominal([60.0], [100.0], [complete], "f", 10) for complete in (True, False))
    without = Cell("drift", "none", effects=[30.0] * 12, complete=[True] * 12, nominal=[flies] * 12)
    for nominal, stops in ((flies, True), (lies, False)):
        cell = Cell("drift", "d", effects=[0.0] * 12, complete=[True] * 12, nominal=[nominal] * 12)
        candidate = replace(cell, candidate="c", nominal=[])
        verdicts = judge_cells({("drift", "none"): without, ("drift", "d"): cell})
        assert verdicts.stops("drift", "d") is stops
        assert verdicts.in_every_flight("drift", "d") is stops
        assert verdicts.of["drift", "d", False].kept == (12 if stops else 0)
        known = judge_cells({("drift", "none"): without, ("drift", "d"): replace(cell, adaptive=(candidate,))})
        assert known.of["drift", "d", True].kept == (6 if stops else 0), "of the half that the adversary is told of"
