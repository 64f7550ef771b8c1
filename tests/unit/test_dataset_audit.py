"""The leak audit of data sets: it finds what tells the arm, names it, and passes a set in which nothing does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.core.errors import InputError
from skyrange.dataset.audit.classifier import (
    CHANCE,
    Comparison,
    audit_comparison,
    find_shifted_columns,
    require_no_leak,
    weighted_auc,
)
from skyrange.dataset.audit.comparisons import audit_dataset
from skyrange.dataset.build import identify_setting
from skyrange.dataset.columns import VIEWS, view_schema

pytestmark = pytest.mark.rotating

pytest.importorskip("sklearn")

S = 1_000_000_000
BLOCKS, WINDOWS, ONSET, EFFECT, FRAMES = 24, 16, 6, 10, 20


def table(view: str, rows: int, run: str, block: str, arm: str, values: dict[str, Any]) -> pa.Table:
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


def write_set(
    folder: Path,
    planted: str = "",
    kind: str = "mavlink.mode",
    leaky: int = BLOCKS,
    repeats: bool = False,
    blocks: int = BLOCKS,
) -> Path:
    """A data set of made-up blocks with the arms nominal, attacked and sham; they are equal up to the onset, and the
    attacked arm differs from its sham after the effect only, but for the leak that is `planted` in the first `leaky`
    blocks. `repeats` is what it says of its runs.
    """
    chance = np.random.default_rng(1)
    runs = []
    for number in range(blocks):
        block, leak = f"b{number}", planted if number < leaky else ""
        size = chance.normal(60.0, 9.0, WINDOWS)
        lengths = chance.integers(20, 100, (WINDOWS, FRAMES))
        late = np.sort(chance.integers(0, S, (WINDOWS, FRAMES)), axis=1)
        place = chance.normal(0.0, 1.0, WINDOWS)
        written: dict[str, list[pa.Table]] = {"flows": [], "aircraft": [], "mavlink": [], "episodes": []}
        for arm in ("nominal", "attacked", "sham"):
            run = f"{block}.{arm}"
            is_attacked = arm == "attacked"
            seconds = np.arange(WINDOWS)
            shape = {"mean": size.copy(), "lengths": lengths.copy(), "at": seconds[:, None] * S + late}
            if arm == "nominal" and leak in ("fault", "setting"):
                shape["mean"][2:] = shape["mean"][2:] + 7.0  # from its fault on, or because it is another scenario
                shape["lengths"][2:] += 3
            if arm != "nominal":
                shape["lengths"][ONSET:] += 5
            if is_attacked:
                shape["lengths"][EFFECT:] += 40  # the effect, which everybody may see
                plant(leak, shape)
            at = seconds * S + (3_000_000 if is_attacked and leak == "grid" else 0)
            flows = {"time_ns": at, "size_mean": shape["mean"], "frames": np.full(WINDOWS, FRAMES), "received": True}
            count = WINDOWS - (is_attacked and leak == "rows")
            written["flows"].append(table("flows", WINDOWS, run, block, arm, flows).slice(0, count))
            lat = place
            if is_attacked and leak == "decimals":
                lat = np.round(place, 3)
            if is_attacked and leak == "single precision":
                lat = place.astype(np.float32).astype(np.float64)
            departed = seconds >= EFFECT if is_attacked else seconds < 0
            aircraft = {"vehicle": "blue/b1", "time_ns": (seconds + 1) * S, "lat_deg": lat, "effect": departed}
            written["aircraft"].append(table("aircraft", WINDOWS, run, block, arm, aircraft))
            source = f"10.0.{number}.7:14550"
            if leak == "port" and is_attacked:
                source = f"10.0.{number}.7:14551"
            if leak == "id" and is_attacked:
                source = "10.0.0.9:14550"
            frames = {
                "time_ns": shape["at"].ravel(), "size": shape["lengths"].ravel(), "src": source, "received": True,
                "raw": [bytes(8)] * (WINDOWS * FRAMES), "sequence": np.arange(WINDOWS * FRAMES) % 256, "valid": True,
                "system": np.ones(WINDOWS * FRAMES), "component": np.ones(WINDOWS * FRAMES),
            }  # fmt: skip
            written["mavlink"].append(table("mavlink", WINDOWS * FRAMES, run, block, arm, frames))
            if arm != "nominal":
                episode = {"vehicle": "blue/b1", "role": "attack" if is_attacked else "sham", "kind": kind}
                effect = {"effect_ns": EFFECT * S} if is_attacked and leak != "without effect" else {}
                times = {"onset_ns": ONSET * S, **effect}
                written["episodes"].append(table("episodes", 1, run, block, arm, episode | times))
            if leak == "fault" and arm == "nominal":
                failed = {"vehicle": "blue/b1", "role": "fault", "kind": "gust", "onset_ns": 2 * S}
                written["episodes"].append(table("episodes", 1, run, block, arm, failed))
            setting = "other" if leak == "setting" and arm == "nominal" else "same"
            row = {"run": run, "block": block, "repeats": repeats, "seed": number, "split": "train"}
            runs.append(row | {"setting": setting})
        for view, tables in written.items():
            path = folder / f"view={view}" / "split=train" / f"{block}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(pa.concat_tables(tables), path)
    pq.write_table(pa.Table.from_pylist(runs), folder / "runs.parquet")
    return folder


def plant(leak: str, shape: dict[str, np.ndarray]) -> None:
    """Make the frames and windows of the attacked arm differ from those of its sham."""
    if leak == "before":
        shape["mean"][:ONSET] += 25.0
    if leak == "load":
        shape["lengths"][ONSET:EFFECT] += 60
    if leak == "microseconds":
        shape["at"] -= shape["at"] % 1_000
    if leak == "later":
        shape["at"][ONSET:EFFECT] = np.sort(shape["at"][ONSET:EFFECT] // 2_000_000 * 2_000_000, axis=1)


SHAM = "sham against attacked before the effect"


def test_a_clean_set_passes(tmp_path: Path) -> None:
    findings = audit_dataset(write_set(tmp_path))
    names = ["metadata", "flows before the onset", "aircraft before the onset", SHAM, "shared by splits"]
    assert [one.name for one in findings] == names
    assert [one.name for one in findings if not one.passed] == []
    require_no_leak(findings)


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("leak", "comparison", "column"),
    [
        ("grid", "metadata", "flows"),
        ("microseconds", "metadata", "mavlink.time_ns on 1 us"),
        ("decimals", "metadata", "aircraft.lat_deg"),
        ("single precision", "metadata", "aircraft.lat_deg single precision"),
        ("id", "metadata", "mavlink.src"),
        ("port", "metadata", "mavlink.src"),
        ("before", "flows before the onset", "size_mean"),
        ("load", SHAM, ("size_", "bytes")),
        ("later", SHAM, "iat_ms_"),
    ],
)
def test_a_leak_is_found_and_named(tmp_path: Path, leak: str, comparison: str, column: str | tuple[str, ...]) -> None:
    found = {one.name: one for one in audit_dataset(write_set(tmp_path, leak))}
    assert not found[comparison].passed
    low = found[comparison].low
    assert low is not None
    assert low > CHANCE
    assert found[comparison].leaks[0].startswith(column)
    with pytest.raises(InputError, match=f"leaks: AUC .* by {re.escape(found[comparison].leaks[0])}"):
        require_no_leak(list(found.values()))


@pytest.mark.parametrize(
    ("leak", "comparison", "column"),
    [
        ("grid", "metadata", "flows"),
        ("microseconds", "metadata", "mavlink.time_ns on 1 us"),
        ("decimals", "aircraft before the onset", "lat_deg"),
        ("single precision", "aircraft before the onset", "lat_deg"),
        ("id", "metadata", "mavlink.src"),
        ("port", "metadata", "mavlink.src"),
        ("before", "flows before the onset", "size_mean"),
        ("load", SHAM, ("size_", "bytes")),
        ("later", SHAM, "iat_ms_"),
        ("rows", "metadata", "flows rows"),
    ],
)
@pytest.mark.parametrize(
    ("leaky", "blocks"), [(1, 6), *(pytest.param(one, BLOCKS, marks=pytest.mark.slow) for one in (1, 5, BLOCKS))]
)
def test_of_runs_that_repeat_a_leak_in_one_block_is_found_and_named(
    tmp_path: Path, leak: str, comparison: str, column: str | tuple[str, ...], leaky: int, blocks: int
) -> None:
    """Every planted leak is found, however few blocks have it: a classifier needs most of them."""
    folder = write_set(tmp_path, leak, leaky=leaky, repeats=True, blocks=blocks)
    found = {one.name: one for one in audit_dataset(folder)}
    one = found[comparison]
    assert one.status == "leaks"
    assert one.differing is not None
    assert max(one.differing.values()) == leaky
    assert any(name.startswith(column) for name in one.leaks)
    with pytest.raises(InputError, match=f"arms differ by .* in {leaky} of {blocks} blocks"):
        require_no_leak(list(found.values()))


def test_of_runs_that_repeat_a_clean_set_passes_with_any_number_of_blocks(tmp_path: Path) -> None:
    findings = audit_dataset(write_set(tmp_path, repeats=True, blocks=3))
    assert {one.status for one in findings} == {"passed"}
    assert {one.auc for one in findings} == {None}, "nothing has to be learned of arms that are equal"


@pytest.mark.parametrize("why", ["fault", "setting"])
def test_arms_that_differ_by_a_fault_or_a_setting_of_their_own_do_not_leak(tmp_path: Path, why: str) -> None:
    """A nominal arm with a fault of its own is compared up to the fault; one of another scenario is not compared."""
    found = audit_dataset(write_set(tmp_path, why, repeats=True, blocks=5))
    assert {one.status for one in found} == {"passed"}
    told = ["5 runs of other settings"] if why == "setting" else []
    assert [list(one.exempt) for one in found] == [told] * 4 + [[]]


def test_the_setting_of_a_run_is_its_scenario_without_who_acts() -> None:
    text = 'name = "x"\n[[attacks]]\nid = "a"\nkind = "gnss.jump"\nmuted = {0}\n'
    muted, active = (identify_setting(text.format(state)) for state in ("true", "false"))
    assert muted == active
    assert identify_setting(text.format("true") + '[[defences]]\nid = "d"\nkind = "gnss.innovation"\n') != muted


def test_what_splits_share_is_found(tmp_path: Path) -> None:
    folder = write_set(tmp_path, repeats=True)
    rows = pq.read_table(folder / "runs.parquet").to_pylist()
    for number, row in enumerate(rows):
        row |= {"split": "test" if number >= 60 else "train", "flight": f"{row['run']}"}
    for row in rows[60:63]:
        row |= {"seed": 3, "flight": "b3.nominal"}
    pq.write_table(pa.Table.from_pylist(rows), folder / "runs.parquet")
    target = folder / "view=flows" / "split=test"
    target.mkdir()
    path = folder / "view=flows" / "split=train" / "b20.parquet"
    for name, source in (("train", "b0"), ("test", "b20")):
        file = folder / "view=flows" / "split=train" / f"{source}.parquet"
        given = pq.read_table(file)
        hashes = pa.array([f"{'same' if k < 4 else name} {k}" for k in range(given.num_rows)])
        given = given.set_column(given.schema.get_field_index("content_hash"), "content_hash", hashes)
        pq.write_table(given, file if name == "train" else target / "b20.parquet")
    path.unlink()
    shared = next(one for one in audit_dataset(folder) if one.name == "shared by splits")
    assert shared.status == "leaks"
    assert shared.leaks[:2] == ("seed of test in train: 1 (25 %)", "flight of test in train: 1 (10 %)")
    assert shared.leaks[2].startswith("flows windows of test in train: 4 (")
    with pytest.raises(InputError, match="seed of test in train"):
        require_no_leak([shared])


def test_an_attack_that_is_timing_is_exempt_by_name(tmp_path: Path) -> None:
    found = {one.name: one for one in audit_dataset(write_set(tmp_path, "load", "link.delay"))}
    assert found[SHAM].exempt == ["link.delay"]
    assert found[SHAM].rows == 0
    assert found["flows before the onset"].passed


def test_few_blocks_do_not_pass() -> None:
    finding = audit_comparison(noise(4))
    assert (finding.status, finding.auc, finding.blocks) == ("too few blocks", None, 4)
    assert 350 < (finding.blocks_needed or 0) < 450, "with ten it would be told again that there are too few"
    with pytest.raises(InputError, match="too few blocks: 4 with both arms"):
        require_no_leak([finding])


def noise(blocks: int, shift: float = 0.0) -> Comparison:
    """Two rows for each block, with a column that tells the arm by `shift`."""
    is_attacked = np.arange(2 * blocks) % 2 == 0
    values = np.random.default_rng(3).normal(size=(2 * blocks, 2)) + np.outer(is_attacked, [shift, 0.0])
    return Comparison("noise", ["a", "b"], values, is_attacked, [f"b{k // 2:04d}" for k in range(2 * blocks)])


def test_blocks_that_are_too_few_are_told_apart_from_a_leak() -> None:
    finding = audit_comparison(noise(20))
    assert finding.status == "too few blocks"
    assert finding.low is not None
    assert finding.low < 0.5
    assert finding.leaks == ()
    assert finding.blocks_needed is not None
    assert finding.blocks_needed > 100
    with pytest.raises(InputError, match=rf"20 with both arms, AUC .* about {finding.blocks_needed} blocks"):
        require_no_leak([finding])
    told = audit_comparison(noise(20, shift=4.0))
    assert (told.status, told.leaks, told.blocks_needed) == ("leaks", ("a",), None)


@pytest.mark.parametrize("replicates", [2, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("share", [0.2, 0.3])
def test_a_column_that_tells_the_arm_in_some_of_ten_blocks_does_not_pass(share: float, replicates: int) -> None:
    """Ten blocks of runs that vary cannot tell such a leak from chance: the finding says so, and how many it takes."""
    chance = np.random.default_rng(6)
    for _ in range(replicates):
        values = chance.normal(size=(20, 3))
        telling = np.repeat(chance.random(10) < share, 2)
        values[:, 0] = np.where(telling & (np.arange(20) % 2 == 0), 9.0, 0.0)
        finding = audit_comparison(
            Comparison("some", ["a", "b", "c"], values, np.arange(20) % 2 == 0, [f"b{k // 2}" for k in range(20)])
        )
        assert not finding.passed
        assert finding.status == "leaks" or (finding.blocks_needed or 0) > 10


@pytest.mark.parametrize("replicates", [3, pytest.param(200, marks=pytest.mark.slow)])
def test_a_small_shift_in_every_block_is_found_by_its_sign(replicates: int) -> None:
    """The attacked arm is its twin and a little more, among blocks that differ by much: no classifier sees that."""
    chance = np.random.default_rng(7)
    found = 0
    for _ in range(replicates):
        of_block = np.repeat(chance.normal(0.0, 1000.0, 12), 2)
        hostile = np.arange(24) % 2 == 0
        values = np.column_stack([of_block + hostile + chance.normal(0.0, 0.1, 24), chance.normal(size=24)])
        finding = audit_comparison(
            Comparison("shift", ["a", "b"], values, hostile, [f"b{k // 2:02d}" for k in range(24)])
        )
        found += finding.status == "leaks" and "a" in finding.leaks
    assert found == replicates


@pytest.mark.slow
def test_columns_that_tell_nothing_are_called_leaks_at_most_as_often_as_stated() -> None:
    chance = np.random.default_rng(8)
    false = 0
    for _ in range(400):
        values, hostile = chance.normal(size=(40, 20)), np.arange(40) % 2 == 0
        false += bool(
            find_shifted_columns([f"c{k}" for k in range(20)], values, hostile, [f"{k // 2}" for k in range(40)])
        )
    assert false / 400 <= 0.05 + 3.3 * (0.0475 / 400) ** 0.5


def test_the_number_of_arms_of_a_block_is_no_leak() -> None:
    attacked, blocks, values = [], [], []
    for number in range(60):
        is_large = number % 2
        attacked += [True, *[False] * (1 + 3 * is_large)]
        blocks += [f"b{number}"] * (2 + 3 * is_large)
        values += [[float(is_large)]] * (2 + 3 * is_large)
    finding = audit_comparison(Comparison("arms", ["size"], np.array(values), np.array(attacked), blocks))
    assert (finding.status, finding.auc) == ("passed", None)


@pytest.mark.slow
def test_about_as_many_blocks_as_are_said_to_be_needed_decide() -> None:
    needed = audit_comparison(noise(20)).blocks_needed
    assert needed is not None
    assert audit_comparison(noise(4 * needed)).passed


@pytest.mark.slow
def test_noise_that_is_independent_of_the_arm_passes_and_repeats() -> None:
    finding = audit_comparison(noise(3000))
    assert finding.passed
    assert finding.low is not None
    assert finding.high is not None
    assert finding.low < 0.5 < finding.high
    assert audit_comparison(noise(3000)) == finding


def test_auc_by_hand() -> None:
    scores, positive = np.array([0.1, 0.4, 0.4, 0.9]), np.array([False, True, False, True])
    assert weighted_auc(scores, positive, np.ones(4)) == pytest.approx((1 + 0.5 + 1 + 1) / 4)
    assert weighted_auc(scores, positive, np.array([1.0, 0.0, 1.0, 1.0])) == 1.0
    assert np.isnan(weighted_auc(scores, np.ones(4, dtype=bool), np.ones(4)))
