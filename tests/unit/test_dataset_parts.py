"""Parts of data sets: families of all kinds, declared columns, windows, splits and members."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pyarrow as pa
import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import hash64
from skyrange.dataset.build import BlockWriter
from skyrange.dataset.columns import VIEWS, WINDOW_KEYS, Role, check_table, observable_columns, view_schema
from skyrange.dataset.families import FAMILIES, TIMING_KINDS, family_of
from skyrange.dataset.frame_views import describe_approval
from skyrange.dataset.members import HeldOut, Member, assign_splits, check_held_out, check_splits, cluster_members
from skyrange.dataset.windows import SplitHashes, WindowHashes, by_whole_windows
from skyrange.record.schema import FORMAT
from skyrange.scenario.shipped import EXAMPLES


def test_each_shipped_attack_kind_is_in_one_family() -> None:
    counts = Counter(kind for kinds in FAMILIES.values() for kind in kinds)
    shipped = {kind for kind in kinds(ATTACKS) if " in skyrange." in AttackPlugin.find(kind).source}
    assert set(counts) == shipped == set(EXAMPLES)
    assert set(counts.values()) == {1}
    assert set(counts) >= TIMING_KINDS
    assert {family_of({"kind": kind}) for kind in ("gnss.drift", "gnss.jump", "gnss.pull_off", "gnss.meacon")} == {
        "gnss_false_position"
    }


def test_a_kind_without_a_family_is_refused() -> None:
    with pytest.raises(InputError, match=r"gnss\.drift"):
        family_of({"kind": "gnss.drif"})
    with pytest.raises(InputError, match="Declare family="):
        family_of({"kind": "other.thing"})
    assert family_of({"kind": "my.kind", "family": "identity"}) == "identity"
    assert family_of({"kind": "gnss.drift", "family": "identity"}) == "gnss_false_position"


def test_columns_have_a_role_and_each_name_once() -> None:
    for columns in VIEWS.values():
        assert {column.role for column in columns} <= set(get_args(Role))
        assert len({column.name for column in columns}) == len(columns)


def test_truth_is_in_no_observable_column() -> None:
    for view in WINDOW_KEYS:
        names = observable_columns(view)
        assert not {"run", "block", "arm", "sender", "serial", "parent", "radio", "frame", "active", "author"} & {
            *names
        }
        assert len({one.name for one in VIEWS[view]}) == len(VIEWS[view])


def test_a_table_that_differs_from_its_declaration_is_refused() -> None:
    whole = view_schema("episodes").empty_table()
    assert check_table("episodes", whole.select(whole.column_names[::-1])).column_names == whole.column_names
    with pytest.raises(ComponentError, match="more"):
        check_table("episodes", whole.append_column("more", pa.array([], pa.int8())))
    with pytest.raises(ComponentError, match="onset_ns"):
        check_table("episodes", whole.drop_columns(["onset_ns"]))
    place = whole.column_names.index("acts")
    with pytest.raises(ComponentError, match="acts is float"):
        check_table("episodes", whole.set_column(place, "acts", pa.array([], pa.float32())))
    row = dict.fromkeys(whole.column_names)
    with pytest.raises(ComponentError, match=r"null in 1 rows"):
        check_table("episodes", pa.Table.from_pylist([row], schema=pa.schema(list(whole.schema))))


def observations(values: list[float], windows: list[int]) -> pa.Table:
    """Rows of the view aircraft, with one value each."""
    count = len(values)
    columns = {one.name: pa.nulls(count, one.type) for one in VIEWS["aircraft"] if one.role == "observable"}
    columns |= {"vehicle": pa.array(["a/b"] * count), "time_ns": pa.array(windows, pa.int64())}
    return pa.table({**columns, "lat_deg": pa.array(values, pa.float64()), "window": pa.array(windows)})


def test_identical_windows_of_a_block_count_once() -> None:
    hashes = WindowHashes("train", SplitHashes())
    first = hashes.mark("aircraft", "b.nominal", observations([1.0, 2.0, 2.5, 3.0], [0, 1, 1, 2]))
    second = hashes.mark("aircraft", "b.attacked", observations([1.0, 2.0, 2.6, 3.0], [0, 1, 1, 2]))
    assert first.column("duplicate_of").to_pylist() == [None] * 4
    assert second.column("duplicate_of").to_pylist() == ["b.nominal", None, None, "b.nominal"]
    first_hash, second_hash = (table.column("content_hash").to_pylist() for table in (first, second))
    assert first_hash[1] == first_hash[2] != second_hash[1] == second_hash[2]


def test_a_table_without_rows_has_no_window() -> None:
    marked = WindowHashes("train", SplitHashes()).mark("aircraft", "b.nominal", observations([], []))
    assert marked.num_rows == 0
    assert {"content_hash", "duplicate_of"} <= set(marked.column_names)


@pytest.mark.parametrize("view", ["approval", "aircraft"])
def test_a_batch_without_rows_of_a_view_is_written_as_nothing(view: str, tmp_path: Path) -> None:
    """A long run has batches of frames without any message of flight approval."""
    member = Member(tmp_path, "b", "nominal", "train", {}, 1, "")
    none = pa.table({"raw": pa.array([], pa.binary())})
    with BlockWriter(tmp_path, "b", "train", SplitHashes()) as writer:
        assert writer.write(view, member, describe_approval(none) if view == "approval" else none) == 0
    assert not list(tmp_path.rglob("*.parquet"))


def test_a_window_that_another_split_has_is_marked() -> None:
    elsewhere = SplitHashes()
    train, test = (WindowHashes(split, elsewhere) for split in ("train", "test"))
    assert (
        train.mark("aircraft", "a.nominal", observations([1.0, 2.0], [0, 1])).column("duplicate_of").to_pylist()
        == [None] * 2
    )
    other = WindowHashes("train", elsewhere).mark("aircraft", "c.nominal", observations([1.0], [0]))
    assert other.column("duplicate_of").to_pylist() == [None], "blocks of one split may have the same window"
    later = test.mark("aircraft", "b.nominal", observations([1.0, 3.0], [0, 1]))
    assert later.column("duplicate_of").to_pylist() == ["a.nominal", None]


def test_a_missing_value_is_not_zero() -> None:
    hashes = WindowHashes("train", SplitHashes())
    zero = hashes.mark("aircraft", "b.nominal", observations([0.0], [0])).column("content_hash")[0]
    table = observations([0.0], [0])
    place = table.column_names.index("lat_deg")
    missing = table.set_column(place, "lat_deg", pa.nulls(1, pa.float64()))
    assert hashes.mark("aircraft", "b.attacked", missing).column("content_hash")[0] != zero


def test_tables_end_where_windows_end() -> None:
    times = [0, 1, 4, 10, 11, 12, 25, 29, 31]
    parts = [pa.table({"t": times[k : k + 2]}) for k in range(0, len(times), 2)]
    found = [table.column("t").to_pylist() for table in by_whole_windows(iter(parts), "t", 10, rows=3)]
    assert [at for table in found for at in table] == times
    assert len(found) > 1
    windows = [{at // 10 for at in table} for table in found]
    assert sum(map(len, windows)) == len(set.union(*windows))


def member(
    folder: Path, block: str, arm: str = "nominal", kinds: tuple[str, ...] = (), fleet: int = 1,
    seed: int | None = None, **factors: str,
) -> Member:  # fmt: skip
    """A member with a folder of which only the manifest is there; each block has a seed of its own by default."""
    seed = hash64(block) % 2**31 if seed is None else seed
    path = folder / f"{block}-{arm}"
    path.mkdir(parents=True)
    attacks = [{"id": f"a{k}", "kind": kind} for k, kind in enumerate(kinds)]
    manifest = {
        "format": FORMAT, "status": "complete", "name": "x", "seed": seed, "attacks": attacks,
        "record": {"level": "full", "features_hz": 1.0},
        "digests": {"frames": f"{seed} {arm}", "truth": "t"},
        "vehicles": [{"id": f"blue/b{k}", "operator": "blue"} for k in range(fleet)],
    }  # fmt: skip
    (path / "manifest.json").write_text(json.dumps(manifest))
    return Member(path, block, arm, "", factors, seed, f"{block} {arm}")


def test_splits_are_of_blocks_and_adding_blocks_moves_none(tmp_path: Path) -> None:
    members = [member(tmp_path, f"b{k}", arm) for k in range(200) for arm in ("nominal", "attacked")]
    splits = {one.run: one.split for one in assign_splits(members, 7)}
    assert all(splits[f"b{k}.nominal"] == splits[f"b{k}.attacked"] for k in range(200))
    counts = Counter(splits.values())
    assert 200 < counts["train"] < 280
    assert 40 < counts["validation"] < 120
    fewer = {one.run: one.split for one in assign_splits(members[100:160], 7)}
    assert fewer.items() <= splits.items()
    assert {one.run: one.split for one in assign_splits(members, 8)} != splits


def test_held_out_traits_are_in_no_other_split(tmp_path: Path) -> None:
    members = [
        member(tmp_path, "drift", kinds=("gnss.drift",)),
        member(tmp_path, "meacon", kinds=("gnss.meacon",)),
        member(tmp_path, "mode", kinds=("mavlink.mode",)),
        member(tmp_path, "manhattan", kinds=("mavlink.mode",), city="manhattan"),
        member(tmp_path, "large", kinds=("mavlink.mode",), fleet=9),
    ]
    held = HeldOut(frozenset({"gnss_false_position"}), frozenset({"manhattan"}), frozenset({9}))
    found = assign_splits(members, 1, held_out=held)
    splits = {one.block: one.split for one in found}
    assert splits.pop("mode") in ("train", "validation", "test")
    assert splits == {
        "drift": "heldout_family", "meacon": "heldout_family", "manhattan": "heldout_city", "large": "heldout_fleet"
    }  # fmt: skip
    check_held_out(found)
    moved = [replace(one, split="train") if one.block == "meacon" else one for one in found]
    with pytest.raises(InputError, match="heldout_family: gnss_false_position"):
        check_held_out(moved)


def test_nothing_crosses(tmp_path: Path) -> None:
    one = replace(member(tmp_path, "one"), split="train")
    other = replace(member(tmp_path, "other"), split="test", scenario=one.scenario, seed=one.seed)
    with pytest.raises(InputError, match="block other: one"):
        check_splits([one, other])
    with pytest.raises(InputError, match="test, train"):
        check_splits([one, replace(one, arm="attacked", split="test")])


def test_a_seed_and_a_flight_are_in_one_split(tmp_path: Path) -> None:
    members = [member(tmp_path, f"b{k}", arm, seed=k % 20) for k in range(200) for arm in ("nominal", "attacked")]
    found = assign_splits(members, 7)
    by_seed: dict[int, set[str]] = {}
    for one in found:
        by_seed.setdefault(one.seed, set()).add(one.split)
    assert {len(splits) for splits in by_seed.values()} == {1}
    assert len(set.union(*by_seed.values())) > 1
    check_splits(found)
    first = next(one for one in found if one.split == "train")
    with pytest.raises(InputError, match=f"seed {first.seed} of run .* as run .*, which has the same seed"):
        check_splits([replace(one, split="test") if one.block == first.block else one for one in found])
    alike = replace(member(tmp_path, "alike", seed=999), split="test")
    manifest = alike.record / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"999 nominal"', f'"{first.seed} nominal"'))
    with pytest.raises(InputError, match=r"flight [0-9a-f]{32} of run alike"):
        check_splits([*found, alike])
    assert cluster_members([first, alike])["alike"] == cluster_members([first, alike])[first.block]


def test_shares_sum_to_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="shares"):
        assign_splits([member(tmp_path, "b")], 1, shares={"train": 0.6, "test": 0.3})
