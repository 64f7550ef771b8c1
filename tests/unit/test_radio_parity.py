"""Which cells of a comparison of radio engines count, which agree, and what its tables and pages say."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from skyrange.city.downtown import downtown_grid
from skyrange.core.errors import InputError
from tools.agreement.radio import agreement, page
from tools.agreement.radio.agreement import Comparison
from tools.agreement.radio.experiments import (
    ABOVE_ROOF_M,
    CLASSES,
    FLIGHT_M,
    FRAMES,
    STREET_M,
    Shares,
    Trial,
    contention_trials,
    draw_places,
    hidden_trials,
    reach_trials,
    run_trial,
)
from tools.agreement.radio.own_losses import PairLosses, residuals
from tools.agreement.radio.page import draw_residuals, draw_shares
from tools.agreement.radio.setups import BUILTIN, LOCK_DBM, SWAPS, EngineSetup, Swap

NS3 = EngineSetup("ns3")
SWAP = Swap(("error model",), EngineSetup("ns3", "a swap", {"error_model": "nist"}))
CITY = downtown_grid((5, 5))


def _comparison(*rows: tuple[float, float, float]) -> Comparison:
    """Cells with the shares of the builtin, of ns-3, and of ns-3 with a swap."""
    made = Comparison(["ns3"], {"ns3": [SWAP]}, [("contention", {"nodes": k}) for k in range(len(rows))])
    for setup, shares in zip((BUILTIN, NS3, SWAP.setup), zip(*rows, strict=True), strict=True):
        made.shares[setup.title] = list(shares)
    made.frames = [1000] * len(rows)
    return made


NO_EIFS = Swap(("EIFS",), NS3, EngineSetup("builtin", "without EIFS", {"eifs": False}))
BOTH = Swap(("error model", "EIFS"), SWAP.setup, NO_EIFS.builtin)


def _two_sided(*rows: tuple[float, float, float, float]) -> Comparison:
    """The same, and the builtin with a swap."""
    made = _comparison(*(row[:3] for row in rows))
    made.swaps = {"ns3": [SWAP, NO_EIFS, BOTH]}
    made.shares[NO_EIFS.builtin.title] = [row[3] for row in rows]
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


def test_a_swap_of_the_builtin_is_compared_with_the_engine() -> None:
    made = _two_sided((0.5, 0.3, 0.6, 0.31), (0.5, 0.3, 0.2, 0.21), (0.5, 0.3, 0.52, 0.4), (0.5, 0.9, 0.8, 0.1))
    assert made.closed("contention", SWAP) == (1, 4)
    assert made.closed("contention", NO_EIFS) == (1, 4)
    assert made.closed("contention", BOTH) == (1, 4)
    assert made.explained("contention", "ns3", 1) == (2, 4)
    assert made.explained("contention", "ns3") == (3, 4)


def test_the_best_swap_closes_the_gap_with_the_fewest_models() -> None:
    made = _two_sided((0.5, 0.3, 0.54, 0.54), (0.5, 0.3, 0.2, 0.21), (0.5, 0.9, 0.8, 0.1))
    assert [made.best(row, "ns3") for row in range(3)] == [SWAP, BOTH, SWAP]
    assert _comparison((0.5, 0.52, math.nan)).best(0, "ns3") is None


def test_the_best_swap_replaces_a_gap_and_nothing_else() -> None:
    made = _two_sided((0.5, 0.52, math.nan, math.nan), (0.5, 0.7, 0.53, 0.5), (0.5, 0.3, 0.9, 0.29))
    assert made.pairs("ns3", swapped=False) == [(0.5, 0.52), (0.5, 0.7), (0.5, 0.3)]
    assert made.pairs("ns3", swapped=True) == [(0.5, 0.52), (0.5, 0.53), (0.29, 0.3)]


def test_a_swap_runs_where_the_defaults_disagree_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[tuple[str, int]] = []
    trials = list(contention_trials())[:3]

    def run(trial: Trial, setup: EngineSetup, city: object) -> Shares:
        place = next(k for k, one in enumerate(trials) if one is trial)
        ran.append((setup.title, place))
        return Shares(np.array([100 if setup == NS3 and place == 1 else 500]), np.array([1000]))

    monkeypatch.setattr(agreement, "run_trial", run)
    for name in ("reach_trials", "hidden_trials"):
        monkeypatch.setattr(agreement, name, lambda *_: iter(()))
    monkeypatch.setattr(agreement, "contention_trials", lambda: iter(trials))
    monkeypatch.setattr(agreement, "SWAPS", {"ns3": [SWAP, NO_EIFS, BOTH]})
    monkeypatch.setattr(agreement, "MODELS", ())
    made = agreement.compare(CITY, ["ns3"], pairs=1)
    assert ran[:6] == [(title, place) for title in ("builtin", "ns-3") for place in range(3)]
    assert ran[6:] == [("ns-3, a swap", 1), ("builtin, without EIFS", 1)]
    assert made.explained("contention", "ns3", 1) == (3, 3)


def test_swaps_name_the_models_that_their_setups_change() -> None:
    for engine, swaps in SWAPS.items():
        assert [len(swap.models) for swap in swaps] == sorted(len(swap.models) for swap in swaps)
        for swap in swaps:
            assert swap.setup.engine == engine
            assert swap.builtin.engine == "builtin"
            for setup in (swap.setup, swap.builtin):
                assert bool(setup.changes) == bool(setup.params)
            assert swap.setup.changes or swap.builtin.changes
        by_title = {setup.title: setup for swap in swaps for setup in (swap.setup, swap.builtin)}
        assert all(by_title[one.title] == one for swap in swaps for one in (swap.setup, swap.builtin))
    assert pytest.approx(-91.7, abs=0.05) == LOCK_DBM


def test_tables_name_cells_gaps_and_swaps() -> None:
    text = "\n".join(page.tables(_comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53))))
    assert "| ns-3, defaults | 1 of 2 (50%) | 1 of 2 (50%) |" in text
    assert "| ns-3, or one model swapped | 2 of 2 (100%) | 2 of 2 (100%) |" in text
    assert "several" not in text
    assert "| error model | a swap | 1 of 1 |" in text
    assert "| contention | nodes 1 | 0.500 | 0.700 | a swap: 0.530 |" in text


def test_tables_name_the_models_of_swaps_of_several() -> None:
    text = "\n".join(page.tables(_two_sided((0.5, 0.3, 0.6, 0.31), (0.5, 0.3, 0.2, 0.21))))
    assert "| ns-3, or one model swapped | 1 of 2 (50%) | 1 of 2 (50%) |" in text
    assert "| ns-3, or several models swapped (error model and EIFS) | 2 of 2 (100%) | 2 of 2 (100%) |" in text
    assert "| EIFS | builtin, without EIFS | 1 of 2 |" in text
    assert "| error model, EIFS | a swap; builtin, without EIFS | 1 of 2 |" in text
    assert "| 0.500 | 0.300 | builtin, without EIFS: 0.300, builtin 0.310 |" in text


def test_results_as_data_count_swaps_by_models() -> None:
    found = page.results(_two_sided((0.5, 0.3, 0.6, 0.31), (0.5, 0.3, 0.2, 0.21)))
    counts = {"agree": 0, "count": 2, "or_one_model_swapped": 1, "or_several_models_swapped": 2}
    assert found["agreement"]["ns-3"]["contention"] == counts
    assert found["swaps"]["ns-3"][2] == {
        "models": ["error model", "EIFS"], "how": "a swap; builtin, without EIFS", "closed": {"contention": 1}
    }  # fmt: skip


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
    assert found[("street-flight", False)][:2] == (2, 1)
    assert found[("street-flight", False)][2] == pytest.approx(-5.0)


def test_figures_are_well_formed() -> None:
    made = _comparison((0.5, 0.52, math.nan), (0.5, 0.7, 0.53))
    for figure in (
        draw_shares(
            made, BUILTIN.title, {"ns-3": made.pairs("ns3", swapped=False), "swap": made.pairs("ns3", swapped=True)}
        ),
        draw_residuals({"ns-3, free space": residuals(_pairs(), "ns-3, free space")}),
    ):
        ElementTree.fromstring(figure.svg)
    one = draw_shares(made, BUILTIN.title, {"swap": [(0.5, math.nan), (0.5, 0.53)]})
    assert one.svg.count("<circle") == 1 + 1  # one cell was run; the legend


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
