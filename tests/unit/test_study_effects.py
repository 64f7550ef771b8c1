"""Are effects what a hand computes? Two toy records, measured against each other; intervals from a table of t."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft import departures, measure, read_ticks
from skyrange.metrics.safety import closest_approaches, min_building_distance_m
from skyrange.record import Recorder, RunRecord, load
from skyrange.statistics.means import estimate_mean, t_quantile
from skyrange.twins.effects import COLUMNS, ArmOutcomes, effect_rows, effects_table
from skyrange.twins.pair_folder import FORMAT, intervals, load_pair
from skyrange.twins.propagation import COLUMNS as PROPAGATION_COLUMNS
from skyrange.twins.propagation import effects_of, propagation_table, trace
from tests.unit.record_sample import make_frame

S = NS_PER_S
FLEET = ("a/1", "a/2")


def flown(folder: Path, paths: np.ndarray, power_w: float, notes: list[tuple[int, Note]]) -> RunRecord:
    """A record of two aircraft whose places are `paths` (t, 2, 3), a tick a second."""
    header = {"vehicles": [{"id": name, "operator": "a"} for name in FLEET], "operators": [{"id": "a"}]}
    recorder = Recorder.open(folder, header, truth_hz=1.0, sensors_hz=0.0)
    for tick, places in enumerate(paths):
        columns = {
            "east_m": places[:, 0], "north_m": places[:, 1], "up_m": places[:, 2],
            "on_ground": (places[:, 2] <= 0) * 1.0,
            "battery_v": np.full(2, 10.0), "battery_a": np.full(2, power_w / 10.0),
        }  # fmt: skip
        world: Any = SimpleNamespace(
            vehicles=list(FLEET), sources=["dynamic"] * 2, present=None, truth=lambda columns=columns: columns
        )
        recorder.on_truth(tick * S, world)
    for at, note in notes:
        recorder.on_note(at, "gcs", note)
    recorder.close()
    return load(folder)


def done(vehicle: str, at_s: int) -> tuple[int, Note]:
    return at_s * S, Note("event.outcome", vehicle, {"state": "complete", "reason": ""})


def down(vehicle: str, at_ms: int) -> tuple[int, Note]:
    return at_ms * S // 1000, Note("event.contact", vehicle, {"speed_mps": 0.5})


def two(tmp_path: Path) -> tuple[RunRecord, RunRecord]:
    """Nominal: 1 flies 40 m east at 10 m/s, 2 stands in the air 30 m north of its end. Attacked: 1 goes around."""
    stays = [[40, 30, 20]]
    nominal = [[[10 * t, 0, 20], *stays] for t in range(5)]
    attacked = [
        [[0, 0, 20], *stays],
        [[10, 0, 20], *stays],
        [[10, 30, 20], *stays],
        [[34, 30, 20], *stays],
        [[40, 0, 20], *stays],
    ]
    hit = (3 * S, Note("event.collision", "a/1", {"with": "a/2"}))
    return (
        flown(tmp_path / "attacked", np.array(attacked, float), 200.0, [down("a/1", 2730), hit, done("a/1", 4)]),
        flown(
            tmp_path / "nominal", np.array(nominal, float), 150.0, [down("a/1", 2500), done("a/1", 3), done("a/2", 3)]
        ),
    )


def test_effects_by_hand(tmp_path: Path) -> None:
    twin, arm = (ArmOutcomes.read(run, 10.0) for run in two(tmp_path))
    one, two_ = effect_rows(7, "nominal", twin, arm, threshold_m=1.0)
    assert (one["vehicle"], one["seed"], one["against"]) == ("a/1", 7, "nominal")
    assert (one["outcome_twin"], one["outcome"], one["delay_s"]) == ("complete", "complete", 0.23)
    assert (one["finished_twin_s"], one["finished_s"]) == (3.0, 4.0)  # by heartbeats
    assert (one["landed_twin_s"], one["landed_s"]) == (2.5, 2.73)
    assert one["distance_twin_m"] == pytest.approx(40.0)
    assert one["distance_m"] == pytest.approx(10 + 30 + 24 + math.hypot(6, 30))
    assert one["extra_distance_m"] == pytest.approx(24 + math.hypot(6, 30))
    assert one["extra_energy_j"] == pytest.approx(50.0 * 4)  # 50 W more over four seconds
    assert (one["min_separation_twin_m"], one["min_separation_m"]) == (30.0, 6.0)
    assert (one["near_misses_twin"], one["near_misses"], one["nearest"]) == (0, 1, "a/2")
    assert (one["collisions_twin"], one["collisions"]) == (0, 1)
    assert one["departure_m"] == pytest.approx(math.hypot(10, 30))  # (10, 30) against (20, 0)
    assert one["departed_s"] == 2.0
    assert (two_["delay_s"], two_["departed_s"], two_["departure_m"], two_["near_misses"]) == (None, None, 0.0, 1)
    assert two_["outcome"] == "unfinished"
    table = effects_table([one, two_])
    assert table.column_names == [column.name for column in COLUMNS]
    assert table.schema.field("delay_s").metadata[b"unit"] == b"s"


def test_a_run_against_itself_has_no_effect(tmp_path: Path) -> None:
    measured = ArmOutcomes.read(two(tmp_path)[0], 10.0)
    for row in effect_rows(1, "nominal", measured, measured, 1.0):
        assert (row["extra_distance_m"], row["extra_energy_j"], row["departure_m"]) == (0.0, 0.0, 0.0)
        assert row["departed_s"] is None


def test_departure_needs_more_than_the_threshold(tmp_path: Path) -> None:
    attacked, nominal = (read_ticks(run) for run in two(tmp_path))
    away_m, first_ns = departures(attacked, nominal, math.hypot(10, 30))
    assert first_ns.tolist() == [-1, -1]
    assert away_m.tolist() == pytest.approx([math.hypot(10, 30), 0.0])
    assert departures(attacked, nominal, 31.6)[1].tolist() == [2 * S, -1]


def test_near_misses_are_counted_by_approach_and_only_in_the_air() -> None:
    away_m = [20, 9, 8, 12, 9, 9, 30]
    enu_m = np.zeros((7, 2, 3))
    enu_m[:, 1, 0] = away_m
    aloft = np.ones((7, 2), dtype=bool)
    found = closest_approaches(enu_m, aloft, 10.0)
    assert (found.near_misses.tolist(), found.least_m.tolist(), found.tick.tolist()) == ([2, 2], [8.0, 8.0], [2, 2])
    aloft[1:3, 1] = False
    assert closest_approaches(enu_m, aloft, 10.0).near_misses.tolist() == [1, 1]
    aloft[:, 1] = False
    alone = closest_approaches(enu_m, aloft, 10.0)
    assert alone.nearest.tolist() == [-1, -1]
    assert np.isinf(alone.least_m).all()


def test_distance_to_walls_beside_and_above() -> None:
    city = [{"height_m": 20.0, "rings": [[[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]]}]
    enu_m = np.array([[[-3.0, 5, 10], [5, 5, 24], [14, 5, 23], [100, 5, 5]]])
    aloft = np.ones((1, 4), dtype=bool)
    assert min_building_distance_m(enu_m, aloft, city)[:3].tolist() == [3.0, 4.0, 5.0]
    assert np.isinf(min_building_distance_m(enu_m, aloft, city)[3])
    assert np.isinf(min_building_distance_m(enu_m, ~aloft, city)).all()
    assert np.isinf(min_building_distance_m(enu_m, aloft, [])).all()


@pytest.mark.parametrize(
    ("freedom", "t"),
    [(1, 12.7062), (2, 4.3027), (3, 3.1824), (4, 2.7764), (9, 2.2622), (10, 2.2281), (30, 2.0423), (120, 1.9799)],
)  # fmt: skip
def test_quantiles_of_t_are_those_of_the_tables(freedom: int, t: float) -> None:
    # Abramowitz & Stegun, table 26.10 (and any book's), rounded to four decimals
    assert t_quantile(0.975, freedom) == pytest.approx(t, abs=5e-5)


def test_intervals_by_hand() -> None:
    found = estimate_mean([1.0, 2.0, 3.0, 4.0])
    assert found is not None
    half = 3.18245 * math.sqrt(5 / 3) / 2  # t with 3 degrees, s = sqrt(5/3), n = 4
    assert (found.n, found.mean) == (4, 2.5)
    assert found.low == pytest.approx(2.5 - half, abs=1e-4)
    assert found.high == pytest.approx(2.5 + half, abs=1e-4)
    assert found.excludes_zero
    assert not estimate_mean([-1.0, 2.0]).excludes_zero  # type: ignore[union-attr]
    assert estimate_mean([]) is None
    assert estimate_mean([5.0]) == (1, 5.0, None, None, "one sample")


def test_effects_over_seeds_are_paired_differences() -> None:
    base = {"against": "sham", "vehicle": "a/1", "min_wall_m": None, "min_wall_twin_m": 3.0, "extra_energy_j": None}
    rows = [
        base | {"seed": k, "delay_s": delay, "extra_distance_m": 2.0 * k, "departure_m": 1.0, "near_misses": 2 + k,
                "near_misses_twin": 2, "collisions": 0, "collisions_twin": 0, "min_separation_m": 5.0 - k,
                "min_separation_twin_m": 9.0}
        for k, delay in enumerate([1.0, None, 5.0])
    ]  # fmt: skip
    found = intervals([*rows, rows[0] | {"against": "nominal", "delay_s": 99.0}], "sham")["a/1"]
    assert (found["delay_s"].n, found["delay_s"].mean) == (2, 3.0)  # the seed that did not arrive has no delay
    assert found["near_misses"].mean == 1.0
    assert found["min_separation_m"].mean == -5.0
    assert found["collisions"] == (3, 0.0, None, None, "all agree")
    assert "min_wall_m" not in found
    assert "extra_energy_j" not in found


def test_causes_are_traced_through_parents_causes_and_decisions(tmp_path: Path) -> None:
    header = {"vehicles": [{"id": name, "operator": "a"} for name in FLEET]}
    recorder = Recorder.open(tmp_path / "run", header, truth_hz=0.0, sensors_hz=0.0)
    bad = FrameId("gcs:a/1", "fwd", "x@gcs:a/1.companion", 0)
    swapped = FrameId("gcs:a/2", "fwd", "y@gcs:a/2.gcs", 0)
    order = FrameId("log:a/1", "fwd", "a/1.companion", 3)
    reply = FrameId("gcs:a/1", "rev", "a/1.companion", 9)
    late = FrameId("gcs:a/1", "rev", "a/1.companion", 10)
    innocent = FrameId("log:a/1", "fwd", "a/1.companion", 2)
    recorder.on_label(Label(2 * S, "x", "x@gcs:a/1.companion", "inject", bad))
    recorder.on_label(Label(4 * S, "x", "x@gcs:a/1.companion", "drop", late))
    recorder.on_label(Label(S, "sham", "sham@log:a/1.companion", "inject", innocent, benign=True))  # not hostile
    original = FrameId("gcs:a/2", "fwd", "a.gcs", 4)
    recorder.on_label(Label(3 * S, "y", "y@gcs:a/2.gcs", "replace", original, swapped))
    for frame, at, parent, causes in (
        (innocent, 1, None, ()),
        (bad, 2, None, ()),
        (order, 2.1, bad, ()),
        (reply, 2.2, None, (innocent, order)),
        (swapped, 3, original, ()),
        (FrameId("gcs:a/1", "rev", "a/1.companion", 8), 0.5, bad, ()),  # before the onset: nothing can lead back yet
    ):
        recorder.on_frame(make_frame(*frame, round(at * S), b"x", parent=parent, causes=causes))
    recorder.on_note(round(2.3 * S), "gcs.a", Note("decision.hold", "a/1", {"why": "odd"}, (reply,)))
    recorder.on_note(round(2.4 * S), "gcs.a", Note("decision.hold", "a/1", {}, (innocent,)))
    recorder.on_note(round(2.5 * S), "eng", Note("event.mode", "a/1.autopilot", {"mode": "RTL"}, (bad,)))
    recorder.close()
    rows = trace(load(tmp_path / "run"), 5)
    said = [(row["phase"], row["attack"], row["kind"], row["vehicle"], row["depth"], row["origin"]) for row in rows]
    assert said == [
        ("onset", "x", "inject", "a/1", None, None),
        ("propagation", "x", "frame", "a/1", 1, str(bad)),
        ("propagation", "x", "frame", "a/1", 2, str(order)),
        ("propagation", "x", "decision.hold", "a/1", 3, str(reply)),
        ("propagation", "x", "event.mode", "a/1", 1, str(bad)),
        ("onset", "y", "replace", "a/2", None, None),
        ("act", "x", "drop", "a/1", None, None),
    ]
    assert [row["data"] for row in rows if row["kind"] == "decision.hold"] == ['{"why": "odd"}']
    attributed = [
        {"seed": 5, "vehicle": vehicle, "outcome": outcome, "attack": attack, "relation": relation, "departed_s": at_s,
         "difference": 9.0}
        for vehicle, outcome, attack, relation, at_s in (
            ("a/1", "departure", "x", "joint", 3.5),
            ("a/1", "departure", "y", "joint", 3.5),
            ("a/1", "energy", "y", "both", None),
            ("a/2", "departure", "x", "none", 3.6),
            ("a/2", "departure", "y", "none", 3.6),
        )
    ]  # fmt: skip
    found = effects_of(rows, [*attributed, attributed[0] | {"seed": 6}], 5)
    assert [(row["attack"], row["vehicle"], row["at_ns"], row["path"], row["origin"]) for row in found] == [
        ("x", "a/1", 3_500_000_000, True, str(bad)),
        ("y", "a/1", 3_500_000_000, False, None),  # nothing on record leads from there to it
        (None, "a/2", 3_600_000_000, False, None),  # an effect without an author
    ]
    assert effects_of(rows[::-1], attributed, 5) == found
    assert propagation_table([*rows, *found]).num_rows == 10


def test_the_folder_of_a_pair_is_read_as_it_was_written(tmp_path: Path) -> None:
    row = dict.fromkeys(column.name for column in PROPAGATION_COLUMNS) | {
        "seed": 4, "phase": "onset", "at_ns": S, "attack": "x", "kind": "send", "source": "x.radio"
    }  # fmt: skip
    manifest = {"name": "x", "arms": ["nominal", "attacked"], "active": {}, "attacks": {}, "faults": [], "seeds": [4]}
    limits = {"baseline": None, "near_m": 5.0, "threshold_m": 1.0}
    (tmp_path / "pair.json").write_text(json.dumps({"format": FORMAT, **manifest, **limits}))
    pq.write_table(propagation_table([row]), tmp_path / "propagation.parquet")
    assert load_pair(tmp_path).propagation.to_pylist() == [row]


@pytest.mark.parametrize(
    ("manifest", "found"),
    [
        ({"format": "skyrange.pair/3"}, "'skyrange.pair/3'"),
        ({"format": "skyrange.run/1"}, "'skyrange.run/1'"),
        ({}, "None"),
    ],
)
def test_the_folder_of_a_pair_of_another_format_is_not_read(manifest: object, found: str, tmp_path: Path) -> None:
    (tmp_path / "pair.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError) as caught:
        load_pair(tmp_path)
    (problem,) = caught.value.problems
    assert (problem.where, problem.value, problem.expected) == ("pair.json: format", found, repr(FORMAT))
    assert ("fly the pair again" in str(problem)) == ("pair/" in found)


def test_a_world_without_batteries_can_be_measured(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", {"vehicles": [{"id": "a/1", "operator": "a"}]}, truth_hz=1.0)
    for tick in range(3):
        columns = {"east_m": np.array([tick * 2.0]), "north_m": np.zeros(1), "up_m": np.ones(1)}
        world: Any = SimpleNamespace(
            vehicles=["a/1"], sources=["dynamic"], present=None, truth=lambda columns=columns: columns
        )
        recorder._state.sensors_due = 10**18
        recorder.on_truth(tick * S, world)
    recorder.close()
    run = load(tmp_path / "run")
    (found,) = measure(run, read_ticks(run))
    assert (found.distance_m, found.energy_j, found.min_separation_m) == (4.0, None, None)
