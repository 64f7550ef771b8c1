"""The leak audit of data sets: it finds what tells the arm, names it, and passes a set in which nothing does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.core.errors import InputError
from skyrange.study.dataset.audit import LIMIT, Comparison, audit_comparison, require_no_leak, weighted_auc
from skyrange.study.dataset.audit_comparisons import audit_dataset
from skyrange.study.dataset.columns import VIEWS, view_schema

pytest.importorskip("sklearn")

S = 1_000_000_000
BLOCKS, WINDOWS, ONSET = 24, 16, 6


def table(view: str, rows: int, run: str, block: str, arm: str, values: dict) -> pa.Table:
    """Rows of a view: what `values` leaves out is null, false, 0 or empty."""
    columns = {}
    for one in VIEWS[view]:
        given = {"run": run, "block": block, "arm": arm, **values}.get(one.name)
        if given is None:
            blank = False if one.type == pa.bool_() else "" if one.type == pa.string() else 0
            given = [None if one.nullable else blank] * rows
        elif isinstance(given, str | bool | int):
            given = [given] * rows
        columns[one.name] = pa.array(given, one.type)
    return pa.table(columns, schema=view_schema(view))


def write_set(folder: Path, leak: str = "", kind: str = "mavlink.mode") -> Path:
    """A data set of made-up blocks with the arms nominal, attacked and sham; they are equal up to the onset, and the
    attacked arm differs from its sham after the effect only, but for the `leak`.
    """
    chance = np.random.default_rng(1)
    runs = []
    for number in range(BLOCKS):
        block = f"b{number}"
        size = chance.normal(60.0, 9.0, WINDOWS)
        shammed = size + np.where(np.arange(WINDOWS) >= ONSET, 5.0, 0.0)
        place = chance.normal(0.0, 1.0, WINDOWS)
        written: dict[str, list[pa.Table]] = {"flows": [], "aircraft": [], "episodes": []}
        for arm in ("nominal", "attacked", "sham"):
            run = f"{block}.{arm}"
            is_attacked = arm == "attacked"
            at = np.arange(WINDOWS) * S
            lengths = (size if arm == "nominal" else shammed).copy()
            if is_attacked:
                lengths[ONSET + 4 :] += 40.0  # the effect, which everybody may see
                if leak == "grid":
                    at = at + 3_000_000
                if leak == "before":
                    lengths[:ONSET] += 25.0
                if leak == "load":
                    lengths[ONSET : ONSET + 4] += 30.0
            lat = np.round(place, 3) if is_attacked and leak == "decimals" else place
            flows = {"time_ns": at, "size_mean": lengths, "frames": np.full(WINDOWS, 20), "received": True}
            written["flows"].append(table("flows", WINDOWS, run, block, arm, flows))
            aircraft = {"time_ns": (np.arange(WINDOWS) + 1) * S, "lat_deg": lat}
            written["aircraft"].append(table("aircraft", WINDOWS, run, block, arm, aircraft))
            if arm != "nominal":
                episode = {"role": "attack" if is_attacked else "sham", "kind": kind, "onset_ns": ONSET * S}
                effect = {"effect_ns": (ONSET + 4) * S} if is_attacked else {}
                written["episodes"].append(table("episodes", 1, run, block, arm, episode | effect))
            runs.append({"run": run, "block": block})
        for view, tables in written.items():
            path = folder / f"view={view}" / "split=train" / f"{block}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(pa.concat_tables(tables), path)
    pq.write_table(pa.Table.from_pylist(runs), folder / "runs.parquet")
    return folder


SHAM = "sham against attacked before the effect"


def test_a_clean_set_passes(tmp_path: Path) -> None:
    findings = audit_dataset(write_set(tmp_path))
    assert [one.name for one in findings] == ["metadata", "flows before the onset", "aircraft before the onset", SHAM]
    assert [one.name for one in findings if not one.passed] == []
    require_no_leak(findings)


@pytest.mark.parametrize(
    ("leak", "comparison", "column"),
    [
        ("grid", "metadata", "flows"),
        ("decimals", "metadata", "aircraft.lat_deg decimals"),
        ("before", "flows before the onset", "size_mean"),
        ("load", SHAM, "size_mean"),
    ],
)
def test_a_leak_is_found_and_named(tmp_path: Path, leak: str, comparison: str, column: str) -> None:
    found = {one.name: one for one in audit_dataset(write_set(tmp_path, leak))}
    assert not found[comparison].passed
    assert found[comparison].low > LIMIT
    assert found[comparison].leaks[0].startswith(column)
    assert all(name.startswith(column) for name in found[comparison].leaks)
    with pytest.raises(InputError, match=column.replace(".", r"\.")):
        require_no_leak(list(found.values()))


def test_an_attack_that_is_timing_is_exempt_by_name(tmp_path: Path) -> None:
    found = {one.name: one for one in audit_dataset(write_set(tmp_path, "load", "link.delay"))}
    assert found[SHAM].exempt == ["link.delay"]
    assert found[SHAM].rows == 0
    assert found["flows before the onset"].passed


def test_few_blocks_do_not_pass() -> None:
    few = Comparison("few", ["a"], np.zeros((8, 1)), np.array([True, False] * 4), [f"b{k // 2}" for k in range(8)])
    finding = audit_comparison(few)
    assert not finding.passed
    with pytest.raises(InputError, match="4 blocks have both arms"):
        require_no_leak([finding])


def test_noise_that_is_independent_of_the_arm_passes_and_repeats() -> None:
    chance = np.random.default_rng(3)
    blocks = [f"b{k // 2:04d}" for k in range(6000)]
    noise = Comparison("noise", ["a", "b"], chance.normal(size=(6000, 2)), np.arange(6000) % 2 == 0, blocks)
    finding = audit_comparison(noise)
    assert finding.passed
    assert finding.low < 0.5 < finding.high
    assert audit_comparison(noise) == finding


def test_auc_by_hand() -> None:
    scores, positive = np.array([0.1, 0.4, 0.4, 0.9]), np.array([False, True, False, True])
    assert weighted_auc(scores, positive, np.ones(4)) == pytest.approx((1 + 0.5 + 1 + 1) / 4)
    assert weighted_auc(scores, positive, np.array([1.0, 0.0, 1.0, 1.0])) == 1.0
    assert np.isnan(weighted_auc(scores, np.ones(4, dtype=bool), np.ones(4)))
