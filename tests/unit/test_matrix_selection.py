"""A column of a matrix file that fits none of the chosen rows is flown as far as it can be, unless it fits no row."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.study.execution.executors import Flights, Outcome
from skyrange.study.execution.plan import PlannedBlock
from skyrange.study.matrix.flights import fly_matrix
from skyrange.study.matrix.model import Matrix, locate_scenarios, select

MATRIX = Matrix.model_validate(
    {
        "name": "chosen",
        "seeds": 1,
        "rows": [
            {"id": "command", "scenario": "mavlink.command", "measure": "departure_m"},
            {"id": "ghost", "scenario": "rid-spoofing", "measure": "departure_m"},
        ],
        "columns": [
            {"id": "signal", "defences": [{"kind": "remote_id.signal"}]},
            {"id": "firewall", "defences": [{"kind": "mavlink.firewall"}]},
        ],
    }
)


class FlightsBeginError(Exception):
    """Everything was checked."""


class NoExecutor:
    """An executor that flies nothing."""

    jobs = 1

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        raise FlightsBeginError


@pytest.mark.parametrize(("row", "fits"), [("command", {"firewall"}), ("ghost", {"signal", "firewall"})])
def test_a_column_is_refused_if_it_fits_no_row_of_the_file(row: str, fits: set[str], tmp_path: Path) -> None:
    chosen = select(MATRIX, (row,), ())
    others = [one for one in MATRIX.rows if one.id != row]
    with pytest.raises(FlightsBeginError):
        fly_matrix(chosen, tmp_path / "some", executor=NoExecutor(), other_rows=others)
    if fits < {"signal", "firewall"}:  # the chosen rows alone: it is wrong in every row
        with pytest.raises(InputError, match=r"columns\.signal, in the scenario of rows\.command") as refused:
            fly_matrix(chosen, tmp_path / "none", executor=NoExecutor())
        assert len(refused.value.problems) == 1
        with pytest.raises(InputError, match=r"columns\.signal"):
            fly_matrix(chosen, tmp_path / "none", executor=NoExecutor(), other_rows=[MATRIX.rows[0]])
        assert not (tmp_path / "none").exists()


def test_a_selection_is_stored_and_read_back_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = locate_scenarios(select(MATRIX, ("ghost",), ("firewall",))).model_copy(update={"seeds": 3})
        stored = chosen.model_dump(mode="json")
    assert Matrix.model_validate(stored) == chosen
    assert [row.id for row in chosen.rows] == ["ghost"]
