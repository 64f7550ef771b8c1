"""Do attacks and faults of light do to scans what they say, where and when they say it, and nothing else?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import skyrange
from skyrange.assembly.build import build
from skyrange.codec.range_scans import DEPTH, LIDAR, RangeScan, unpack_scan
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.kernel import Kernel
from skyrange.optics.mounted_sensors import list_pulses
from skyrange.record import RunRecord, load
from skyrange.runtime.cores.division import Division
from skyrange.runtime.cores.run import run_on_cores
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_example
from skyrange.study.execution.flight import fly_runs
from skyrange.study.execution.plan import PlannedRun

PARKED: Final = """
name = "parked"
seed = 5
duration_s = 3
origin = [40.76, -73.98]
[city]
grid = { blocks = [4, 3], height_m = [30, 31], street_m = 40, block_m = 90 }
[[operators]]
id = "blue"
[[operators.vehicles]]
id = "b1"
start = [0, 0, 90]
plan = { path = { points = [[0, 0], [0, 20]], alt_m = 15 } }
sensors = [
    { id = "ring", model = "vlp-16", azimuths = 360, noise_m = 0 },
    { id = "eye", model = "d435", pixels = [64, 48], rate_hz = 5, yaw_deg = -90 },
]
"""
"""An aircraft that stands in a street, 40 m wide, along north; its nose is to the east, and its camera looks north."""
PLACE: Final = np.zeros(3)
LASER: Final = (0.0, 60.0, 1.0)
STEP_M: Final = 0.002


class Scans(NamedTuple):
    """Scans of one kind of sensor in a run, by number."""

    scans: list[RangeScan]
    direction: NDArray[np.float64]
    """(n, 3) of the pulses in local axes: east, north, up; the aircraft does not move."""
    origin: NDArray[np.float64]

    def distances(self, number: int) -> NDArray[np.float64]:
        return np.asarray(self.scans[number].steps * self.scans[number].resolution_m, dtype=np.float64)

    def cone(self, place: Sequence[float], width_deg: float) -> NDArray[np.bool_]:
        """The pulses within a cone around the direction to a place."""
        way = np.array(place) - self.origin
        cosine = self.direction @ way / np.linalg.norm(way)
        return np.asarray(cosine >= np.cos(np.radians(width_deg / 2)))


def fly(folder: Path, *tables: str, changes: Sequence[str] = ()) -> RunRecord:
    return skyrange.run(Scenario.from_toml(PARKED + "\n".join(tables), changes), folder)


def act(kind: str, params: str, more: str = "", sort: str = "attacks") -> str:
    return f"""
[[{sort}]]
id = "liar"
kind = "{kind}"
start_s = 1
stop_s = 2
{more}
params = {{ {params} }}
"""


def at(place: Sequence[float]) -> str:
    return f'vehicles = ["blue/b1"], at = {list(place)}'


def read(run: RunRecord, kind: int = LIDAR) -> Scans:
    payloads = {row["payload_id"]: row["payload"] for row in run.table("payloads").to_pylist()}
    rows = [row for row in run.table("frames").to_pylist() if row["link"] == "scan:blue/b1"]
    scans = [scan for row in rows if (scan := unpack_scan(payloads[row["payload_id"]])).kind == kind]
    vehicle = Scenario.from_toml(PARKED).operators[0].vehicles[0]
    sensor = next(one for one in vehicle.sensors if one.id == ("ring" if kind == LIDAR else "eye"))
    forward, left, up = list_pulses(sensor.make().pattern, 0).direction.T
    local = np.column_stack([forward, left, up] if kind == LIDAR else [-left, forward, up])
    (mounted,) = (one for one in build(Scenario.from_toml(PARKED)).scanner.sensors if one.id == sensor.id)  # type: ignore[union-attr]
    return Scans(scans, local, PLACE + np.array([0.0, 0.0, mounted.place_m[2]]))


def labels_of(run: RunRecord) -> list[dict[str, Any]]:
    return list(run.table("labels").to_pylist())


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(tmp_path_factory.mktemp("nominal") / "run")


@pytest.fixture(scope="module")
def true(nominal: RunRecord) -> Scans:
    return read(nominal)


def differing(true: Scans, lied: Scans) -> list[int]:
    """Numbers of the scans that are not the same."""
    pairs = zip(true.scans, lied.scans, strict=True)
    return [one.scan for one, other in pairs if one.steps.tobytes() != other.steps.tobytes()]


OBJECT: Final = "object_m = [1.0, 12.0, 0.0], radius_m = 0.5, height_m = 3.0"


def test_spoofed_points_stand_where_the_object_is_said_to_be(true: Scans, tmp_path: Path) -> None:
    run = fly(tmp_path / "run", act("lidar.relay", f"{at(LASER)}, {OBJECT}, reach_deg = 30, timing_ns = 0.5"))
    lied = read(run)
    assert differing(true, lied) == list(range(10, 20)), "while it acts, and at no other time"
    for number in range(10, 20):
        changed = true.scans[number].steps != lied.scans[number].steps
        assert 10 <= changed.sum() <= 200
        assert not (changed & ~lied.cone(LASER, 30.0)).any()
        points = lied.origin + lied.distances(number)[changed, None] * lied.direction[changed]
        from_axis = np.hypot(points[:, 0] - 1.0, points[:, 1] - 12.0)
        assert (from_axis < 0.5 + 4 * 0.075 + STEP_M).all(), "4 sigma of 0.5 ns"
        assert ((points[:, 2] > -0.2) & (points[:, 2] < 3.2)).all()
    said = labels_of(run)
    assert [row["at_ns"] for row in said] == [number * 100 * NS_PER_MS for number in range(10, 20)]
    assert {(row["action"], row["frame"].split("|")[0]) for row in said} == {("scan", "lidar:blue/b1")}


def test_no_more_points_than_the_attacker_has(true: Scans, tmp_path: Path) -> None:
    lied = read(fly(tmp_path / "run", act("lidar.relay", f"{at(LASER)}, {OBJECT}, reach_deg = 30, points = 7")))
    changed = [int((true.scans[k].steps != lied.scans[k].steps).sum()) for k in range(10, 20)]
    assert max(changed) == 7


def test_a_relay_that_answers_pulses_places_points_behind_itself_alone(true: Scans, tmp_path: Path) -> None:
    wall = "object_m = [0.0, 75.0, 0.0], radius_m = 10.0, height_m = 20.0, delay_ns = 20"
    near = wall.replace("75.0", "40.0")
    for number, (what, some) in enumerate(((wall, True), (near, False))):
        lied = read(fly(tmp_path / str(number), act("lidar.relay", f"{at(LASER)}, {what}, seen_deg = 4")))
        changed = [true.scans[k].steps != lied.scans[k].steps for k in range(10, 20)]
        assert any(mask.any() for mask in changed) == some
        for k, mask in zip(range(10, 20), changed, strict=True):
            assert (lied.distances(k)[mask] > 60.0 + 2.0).all()
            assert not (mask & ~lied.cone(LASER, 4.0)).any()


@pytest.mark.parametrize(("generation", "spread"), [("first", (0.0, 1.0)), ("randomised", (8.0, 60.0))])
def test_random_times_scatter_predicted_points(
    generation: str, spread: tuple[float, float], true: Scans, tmp_path: Path
) -> None:
    more = f'{OBJECT}, reach_deg = 30, generation = "{generation}"'
    lied = read(fly(tmp_path / "run", act("lidar.relay", f"{at(LASER)}, {more}")))
    found = np.concatenate([
        lied.distances(k)[(true.scans[k].steps != lied.scans[k].steps) & (lied.scans[k].steps > 0)]
        for k in range(10, 20)
    ])  # fmt: skip
    assert spread[0] <= found.std() <= spread[1]


def test_a_fingerprint_refuses_most_pulses(true: Scans, tmp_path: Path) -> None:
    changed = []
    for number, accepted in enumerate((1.0, 0.1)):
        more = f'{OBJECT}, reach_deg = 30, generation = "fingerprint", accepted = {accepted}'
        lied = read(fly(tmp_path / str(number), act("lidar.relay", f"{at(LASER)}, {more}")))
        changed.append(sum(int((true.scans[k].steps != lied.scans[k].steps).sum()) for k in range(10, 20)))
    assert 0 < changed[1] < 0.3 * changed[0]


def test_removed_points_are_gone_in_the_reach_and_nowhere_else(true: Scans, tmp_path: Path) -> None:
    lied = read(fly(tmp_path / "run", act("lidar.remove", f"{at(LASER)}, share = 1, timing_ns = 0")))
    cone = lied.cone(LASER, 45.0)
    for k in range(10, 20):
        assert true.scans[k].steps[cone].any()
        assert int((lied.scans[k].steps[cone] > 0).sum()) <= 3, "but for false alarms"
        assert lied.scans[k].steps[~cone].tobytes() == true.scans[k].steps[~cone].tobytes()


def test_pulses_at_a_high_rate_hide_what_is_there_from_a_randomised_lidar(true: Scans, tmp_path: Path) -> None:
    kept = {}
    for method in ("near", "high_frequency"):
        more = f'method = "{method}", generation = "randomised", rate_mhz = 5, share = 1'
        lied = read(fly(tmp_path / method, act("lidar.remove", f"{at(LASER)}, {more}")))
        cone = lied.cone(LASER, 45.0)
        same = [
            (np.abs(true.distances(k) - lied.distances(k)) < 0.5)[cone & (true.scans[k].steps > 0)]
            for k in range(10, 20)
        ]
        kept[method] = float(np.concatenate(same).mean())
    assert kept["high_frequency"] < 0.1
    assert kept["near"] > 0.3, "half of the mistimed pulses come too early to hide anything"


def test_blinding_leaves_nothing_in_the_reach_and_all_else(true: Scans, tmp_path: Path) -> None:
    lied = read(fly(tmp_path / "run", act("lidar.blind", f"{at(LASER)}, reach_deg = 24")))
    cone = lied.cone(LASER, 24.0)
    for k in range(10, 20):
        assert true.scans[k].steps[cone].any()
        assert int((lied.scans[k].steps[cone] > 0).sum()) <= 3
        assert lied.scans[k].steps[~cone].tobytes() == true.scans[k].steps[~cone].tobytes()


def test_projected_depth_is_a_patch_at_its_depth(nominal: RunRecord, tmp_path: Path) -> None:
    place = [0.0, 7.0, 0.5]
    lied = read(fly(tmp_path / "run", act("depth.project", f"{at(place)}, depth_m = 1.5, aim_mrad = 0")), DEPTH)
    true = read(nominal, DEPTH)
    assert differing(true, lied) == list(range(5, 10))
    cone = lied.cone(place, 10.0)
    assert cone.sum() > 20
    for k in range(5, 10):
        assert (np.abs(lied.distances(k)[cone] - 1.5) < 5 * 0.086).all(), "5 sigma of the camera's noise"
        assert lied.scans[k].steps[~cone].tobytes() == true.scans[k].steps[~cone].tobytes()


@pytest.mark.parametrize(
    "why", ["hidden", "far", "outside"], ids=["behind a building", "beyond its range", "outside of the field"]
)
def test_what_the_light_does_not_reach_it_does_not_alter(why: str, nominal: RunRecord, tmp_path: Path) -> None:
    places = {"hidden": (65.0, 25.0, 1.0), "far": (0.0, 99.0, 1.0), "outside": (0.0, 3.0, 20.0)}
    limits = {"hidden": "range_m = 500", "far": "range_m = 90", "outside": "range_m = 500"}
    run = fly(tmp_path / "run", act("lidar.blind", f"{at(places[why])}, reach_deg = 40, {limits[why]}"))
    assert labels_of(run) == []
    assert run.manifest["digests"]["frames"] == nominal.manifest["digests"]["frames"]


def test_hits_fall_with_the_error_of_the_aim(tmp_path: Path) -> None:
    """At 60 m the spot has a radius of 0.155 m, and its centre misses by a Rayleigh distribution."""
    share = {}
    for aim_mrad in (0.0, 2.0, 20.0):
        changes = ["duration_s=12", "attacks.liar.stop_s=11"]
        table = act("lidar.blind", f"{at(LASER)}, aim_mrad = {aim_mrad}, lag_s = 0")
        share[aim_mrad] = len(labels_of(fly(tmp_path / str(aim_mrad), table, changes=changes))) / 100.0
    assert share[0.0] == 1.0
    assert share[2.0] == pytest.approx(1.0 - np.exp(-0.5 * (0.155 / 0.12) ** 2), abs=0.17)
    assert share[20.0] < 0.1


def test_a_sham_lights_without_effect_and_a_muted_one_leaves_no_trace(nominal: RunRecord, tmp_path: Path) -> None:
    params = f"{at(LASER)}, {OBJECT}, reach_deg = 30"
    lied = fly(tmp_path / "lied", act("lidar.relay", params))
    sham = fly(tmp_path / "sham", act("lidar.relay", params, "sham = true"))
    muted = fly(tmp_path / "muted", act("lidar.relay", params, "muted = true"))
    assert [(row["at_ns"], row["frame"]) for row in labels_of(sham)] == [
        (row["at_ns"], row["frame"]) for row in labels_of(lied)
    ]
    assert {row["benign"] for row in labels_of(sham)} == {True}
    assert labels_of(muted) == []
    for one in (sham, muted):
        assert one.manifest["digests"]["frames"] == nominal.manifest["digests"]["frames"]
    assert lied.manifest["digests"]["frames"] != nominal.manifest["digests"]["frames"]


def test_dirt_stays_in_its_place_and_is_as_much_as_said(true: Scans, tmp_path: Path) -> None:
    dirt = act("lens.dirt", 'vehicles = ["blue/b1"], sensor = "ring", blocked = 0.4, spot_deg = 3', sort="faults")
    lied = read(fly(tmp_path / "run", dirt))
    gone = [(true.scans[k].steps > 0) & (lied.scans[k].steps == 0) for k in range(10, 20)]
    shown = [(true.scans[k].steps > 0) & (lied.scans[k].steps > 0) for k in range(10, 20)]
    share = sum(int(mask.sum()) for mask in gone) / sum(int((true.scans[k].steps > 0).sum()) for k in range(10, 20))
    assert share == pytest.approx(0.4, abs=0.08)
    wandering = np.logical_or.reduce(gone) & np.logical_or.reduce(shown)
    assert wandering.sum() < 0.01 * true.scans[10].steps.size, "only where noise decides"


@pytest.mark.parametrize("kind", ["weather.rain", "weather.fog"])
def test_weather_comes_and_goes(kind: str, true: Scans, tmp_path: Path) -> None:
    params = {"weather.rain": 'rain_mmph = 60, rain_law = "goodin"', "weather.fog": "visibility_m = 25"}[kind]
    lied = read(fly(tmp_path / "run", act(kind, f"{params}, ramp_s = 0.4", sort="faults")))
    share = [(lied.scans[k].steps > 0).sum() / (true.scans[k].steps > 0).sum() for k in range(30)]
    assert set(share[:10]) == set(share[20:]) == {1.0}
    assert share[10] > share[12] > share[15]
    assert share[15] < 0.75
    assert share[15] < share[19]


def test_the_truth_of_a_scan_tells_its_forged_returns(true: Scans) -> None:
    built = build(Scenario.from_toml(PARKED + act("lidar.relay", f"{at(LASER)}, {OBJECT}, reach_deg = 30")))
    assert built.scanner is not None
    built.scanner.start_recording()
    kernel = Kernel(built.wiring)
    kernel.advance(3 * NS_PER_S)
    truths = [one for one in built.scanner.drain_truths() if one.sensor == "ring"]
    forged = [int(one.is_forged.sum()) for one in truths]
    assert not any(forged[:10] + forged[20:])
    assert min(forged[10:20]) >= 10
    assert not any((one.kind[one.is_forged] != 0).any() or (one.row[one.is_forged] != -1).any() for one in truths)


def test_runs_of_a_batch_are_lied_to_as_runs_alone(tmp_path: Path) -> None:
    table = act("lidar.remove", f"{at(LASER)}, method = 'high_frequency'")
    alone = fly(tmp_path / "alone", table)
    company = [("seed=9",), (), ("attacks.liar.params.reach_deg=10",)]
    plan = [PlannedRun(str(n), Scenario.from_toml(PARKED + table, changes)) for n, changes in enumerate(company)]
    assert not fly_runs(plan, tmp_path).errors
    assert load(tmp_path / "1").manifest["digests"] == alone.manifest["digests"]
    assert len({load(tmp_path / str(n)).manifest["digests"]["frames"] for n in range(3)}) == 3


def test_a_lie_has_the_same_labels_on_several_cores(tmp_path: Path) -> None:
    """There the scans are made later in their instant: the labels have the time of the scan all the same."""
    plan = "plan = { square = { side_m = 9, alt_m = 9 } }"
    red = f'[[operators]]\nid = "red"\n[[operators.vehicles]]\nstart = [0, 30]\n{plan}\n'
    attack = act("lidar.blind", at(LASER))
    scenario = Scenario.from_toml(PARKED + red + attack)
    alone = skyrange.run(scenario, tmp_path / "alone")
    shared = load(run_on_cores(scenario, Division((("blue",), ("red",))), 2, tmp_path / "shared"))
    assert len(labels_of(alone)) == 10
    assert labels_of(shared) == labels_of(alone)
    assert shared.manifest["digests"] == alone.manifest["digests"]
    assert shared.table("scans").equals(alone.table("scans"))


def test_a_lie_starts_by_its_condition_and_as_a_stage_of_a_campaign(true: Scans, tmp_path: Path) -> None:
    when = act("lidar.blind", at(LASER), 'when = { vehicle = "blue/b1", within_m = 9, of = [0, 0, 0] }')
    campaign = f"""
[[attacks]]
id = "plot"
kind = "campaign"
start_s = 1
[attacks.params]
acts.dazzle = {{ kind = "lidar.blind", params = {{ {at(LASER)} }} }}
stages = [{{ name = "blind", acts = ["dazzle"], timeout_s = 1 }}]
"""
    for name, table in (("when", when), ("campaign", campaign)):
        run = fly(tmp_path / name, table)
        changed = differing(true, read(run))
        assert 9 <= len(changed) <= 11
        assert set(changed) <= set(range(10, 21))
        assert [row["at_ns"] for row in labels_of(run)] == [number * 100 * NS_PER_MS for number in changed]


BAD: Final = {
    'vehicles = ["blue/b1"], at = [40, 20, 5]': "at: .*a place outside buildings",
    'vehicles = ["blue/b1"], at = [0, 60, -1]': "at: .*on the ground",
    'vehicles = ["blue/b1"], at = [0, 60, 1], sensor = "eye"': "sensor: eye — expected the id of a LiDAR.*ring",
    'vehicles = ["blue/b9"], at = [0, 60, 1]': "vehicles.0: blue/b9",
    'vehicles = ["blue/b1"], at = [0, 60, 1], reach_deg = 0': "reach_deg",
}


@pytest.mark.parametrize("bad", BAD)
def test_what_cannot_be_is_named_before_the_run(bad: str) -> None:
    with pytest.raises(InputError, match=BAD[bad]):
        build(Scenario.from_toml(PARKED + act("lidar.blind", bad)))


def test_an_aircraft_without_the_sensor_is_named_before_the_run() -> None:
    bare = PARKED[: PARKED.index("sensors =")]
    with pytest.raises(InputError, match="vehicles: blue/b1 — expected an aircraft with a LiDAR"):
        build(Scenario.from_toml(bare + act("lidar.blind", at(LASER))))


@pytest.mark.rotating
@pytest.mark.parametrize("kind", ["lidar.relay", "lidar.remove", "lidar.blind"])
def test_an_aircraft_that_believes_its_lidar_is_led_by_the_lie(kind: str, tmp_path: Path) -> None:
    """The shipped examples: it avoids what is not there, or does not avoid in time what is."""
    attack = load_example(kind).attacks[0].id
    runs = {
        name: skyrange.run(load_example(kind, changes), tmp_path / name)
        for name, changes in (("lied", []), ("muted", [f"attacks.{attack}.muted=true"]))
    }
    avoided = {
        name: [row["time_ns"] for row in run.table("decisions").to_pylist() if row["kind"] == "decision.avoid"]
        for name, run in runs.items()
    }
    if kind == "lidar.relay":
        assert avoided["lied"]
        assert not avoided["muted"]
    else:
        assert avoided["muted"]
        assert not avoided["lied"] or avoided["lied"][0] > avoided["muted"][0] + 5 * NS_PER_S
