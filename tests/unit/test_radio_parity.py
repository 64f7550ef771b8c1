"""Which cells of a comparison of radio engines count, which agree, and what its tables and pages say."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from skyrange.city.downtown import downtown_grid
from skyrange.core.errors import InputError
from skyrange.study.compare.radio import page
from skyrange.study.compare.radio.agreement import BUILTIN, Comparison
from skyrange.study.compare.radio.experiments import FRAMES, contention_trials, hidden_trials, reach_trials
from skyrange.study.compare.radio.figures import draw_residuals, draw_shares
from skyrange.study.compare.radio.own_losses import PairLosses, residuals
from skyrange.study.compare.radio.places import ABOVE_ROOF_M, CLASSES, FLIGHT_M, STREET_M, draw_places
from skyrange.study.compare.radio.setups import EngineSetup
from skyrange.study.compare.radio.trials import run_trial

NS3, SWAP = EngineSetup("ns3"), EngineSetup("ns3", "a swap", {"error_model": "nist"})
CITY = downtown_grid((5, 5))


def _comparison(*rows: tuple[float, float, float]) -> Comparison:
    """Cells with the shares of the builtin, of ns-3, and of ns-3 with a swap."""
    made = Comparison([BUILTIN, NS3, SWAP], [("contention", {"nodes": k}) for k in range(len(rows))])
    for setup, shares in zip(made.setups, zip(*rows, strict=True), strict=True):
        made.shares[setup.title] = list(shares)
    made.frames = [1000] * len(rows)
    return made


def test_cells_in_which_either_hears_part_count() -> None:
    made = _comparison((0.0, 0.04, math.nan), (0.04, 0.06, math.nan), (0.96, 1.0, math.nan), (0.5, 1.0, 0.9))
    assert made.select("contention", "ns-3").tolist() == [1, 3]
    assert made.agreeing("contention", "ns-3") == (1, 2)


def test_a_gap_counts_as_explained_if_one_swap_closes_it() -> None:
    made = _comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53), (0.5, 0.7, 0.6), (0.5, 0.1, math.nan))
    assert made.agreeing("contention", "ns-3") == (1, 4)
    assert made.gaps("contention", "ns3").tolist() == [1, 2, 3]
    assert made.closed("contention", SWAP) == (1, 3)
    assert made.explained("contention", "ns3") == (2, 4)


def test_the_nearest_swap_replaces_a_gap_and_nothing_else() -> None:
    made = _comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53), (0.5, 0.6, 0.9), (0.0, 0.0, math.nan))
    assert made.nearest("ns3") == [0.52, 0.53, 0.6, 0.0]


def test_tables_name_cells_gaps_and_swaps() -> None:
    text = "\n".join(page.tables(_comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53))))
    assert "| ns-3, defaults | 1 of 2 (50%) | 1 of 2 (50%) |" in text
    assert "| ns-3, or a swap | 2 of 2 (100%) | 2 of 2 (100%) |" in text
    assert "| a swap | 1 of 1 |" in text
    assert "| contention | nodes 1 | 0.500 | 0.700 | a swap: 0.530 |" in text


def test_a_table_without_cells_that_count_says_so() -> None:
    assert "none counts" in "\n".join(page.tables(_comparison((0.0, 0.0, math.nan))))


def _pairs() -> PairLosses:
    ends = np.zeros((4, 6))
    heights = ["street-street", "street-street", "street-flight", "street-flight"]
    sight = np.array([True, True, False, False])
    mine = np.array([80.0, 90.0, 100.0, 110.0])
    return PairLosses(ends, heights, sight, mine, {"ns-3, free space": mine + np.array([1.0, 3.0, -5.0, math.nan])})


def test_residuals_are_by_heights_and_sight() -> None:
    found = residuals(_pairs(), "ns-3, free space")
    assert list(found) == [("street-street", True), ("street-flight", False)]
    assert found[("street-street", True)].median_db == pytest.approx(2.0)
    assert found[("street-flight", False)][:3] == (2, 1, pytest.approx(-5.0))


def test_figures_are_well_formed() -> None:
    made = _comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53))
    for figure in (
        draw_shares(made, BUILTIN.title, {"ns-3": made.shares["ns-3"], "swap": made.shares[SWAP.title]}),
        draw_residuals({"ns-3, free space": residuals(_pairs(), "ns-3, free space")}),
    ):
        ElementTree.fromstring(figure.svg)
    assert (
        draw_shares(made, BUILTIN.title, {"swap": made.shares[SWAP.title]}).svg.count("<circle") == 1 + 1
    )  # one cell was run; the legend


def test_a_page_is_renewed_between_its_marks(tmp_path: Path) -> None:
    made = _comparison((0.5, 0.7, 0.53))
    made.losses = _pairs()
    target = tmp_path / "explanation" / "radio-parity.md"
    target.parent.mkdir()
    (tmp_path / "images").mkdir()
    target.write_text(f"# Title\n\n{page.BEGIN}\nold\n{page.END}\n\nThe end.\n")
    page.renew_page(made, target)
    text = target.read_text()
    assert text.startswith("# Title\n")
    assert text.endswith("The end.\n")
    assert "old" not in text
    assert f"(../images/{page.SHARES_SVG})" in text
    assert (tmp_path / "images" / page.LOSSES_SVG).is_file()
    page.write_results(made, tmp_path / "out")
    assert {each.name for each in (tmp_path / "out").iterdir()} == {
        "radio.json", "radio.md", page.SHARES_SVG, page.LOSSES_SVG
    }  # fmt: skip


@pytest.mark.parametrize("text", [None, "# No marks\n"])
def test_a_page_without_marks_is_refused(tmp_path: Path, text: str | None) -> None:
    target = tmp_path / "page.md"
    if text is not None:
        target.write_text(text)
    with pytest.raises(InputError, match="--page"):
        page.check_page(target)


@pytest.mark.parametrize("kind", CLASSES)
def test_places_are_where_their_class_says(kind: str) -> None:
    places = draw_places(CITY, 30, kind, np.random.default_rng(1))
    for x, y, z in places.tolist():
        assert CITY.inside(x, y, z) is None
        below = CITY.inside(x, y, 0.1)
        if kind == "street":
            assert z == STREET_M
            assert below is None
        elif kind == "roof":
            assert below is not None
            assert z == pytest.approx(below.height_m + ABOVE_ROOF_M)
        else:
            assert FLIGHT_M[0] <= z <= FLIGHT_M[1]


def test_every_cell_has_its_frames() -> None:
    trials = [*reach_trials(CITY), *contention_trials(), *hidden_trials()]
    assert {trial.experiment for trial in trials} == {"reach", "contention", "hidden terminals"}
    for trial in trials:
        assert len(trial.at_ns) >= FRAMES
        assert (np.diff(trial.at_ns) >= 0).all()
        for cell in trial.cells:
            assert not (trial.sender == cell.receiver).any()
    assert max(cell.facts["nodes"] for trial in contention_trials() for cell in trial.cells) == 200


def test_a_single_node_is_heard_whole() -> None:
    trial = next(contention_trials())
    found = run_trial(trial, BUILTIN, None)
    assert found.decoded.tolist() == found.offered.tolist() == [FRAMES]
