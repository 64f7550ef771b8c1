"""One operator with more aircraft than MAVLink's 8-bit system ids, so two or three networks with the same ids."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.gcs.station import GroundStation
from skyrange.record import load
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Fleet, Operator, Origin, Record, Scenario, path

SIZES = {600: {0: 250, 1: 250, 2: 100}, 252: {0: 250, 1: 2}}
"""By number of aircraft: the aircraft of each network."""
APART_M = {600: 12.0, 252: 16.0}
"""By number of aircraft: the distance of neighbours."""
HOP = path([(0, 0)], 2, end="land")
"""Up to 2 m and down: with upload, pre-arm checks and disarming about 22 s."""


@pytest.fixture(scope="module", params=[pytest.param((600, 25), marks=pytest.mark.slow), (252, 4)])
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """So many aircraft for so many seconds; only the longer flight is flown to its end."""
    count, duration_s = request.param
    fleet = Fleet(count=count, spacing_m=(APART_M[count], APART_M[count]), plan=HOP)
    scenario = Scenario(
        name="many",
        origin=Origin(lat=47.4, lon=8.5),
        duration_s=duration_s,
        record=Record(truth_hz=1, sensors_hz=0),
        operators=(Operator(id="parcel", fleets=(fleet,)),),
    )
    folder = tmp_path_factory.mktemp("many") / "run"
    run = Run.start(scenario, folder)
    run.advance(scenario.duration_s)
    run.finish()
    return run, folder


def station(run: Run) -> GroundStation:
    [found] = [agent for agent in run.built.wiring.agents if isinstance(agent, GroundStation)]
    return found


def test_networks_share_the_system_ids(flown: tuple[Run, Path]) -> None:
    rows = flown[0].built.header["vehicles"]
    assert Counter(row["network"] for row in rows) == SIZES[len(rows)]
    assert len({(row["network"], row["system_id"]) for row in rows}) == len(rows)
    assert max(row["system_id"] for row in rows) == 250


def test_one_station_tells_all_of_them_apart(flown: tuple[Run, Path]) -> None:
    run, folder = flown
    gcs = station(run)
    origin = run.built.scenario.origin.datum
    apart_m = APART_M[len(run.built.header["vehicles"])]
    for row in run.built.header["vehicles"]:
        place = gcs.latest(row["id"], dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
        east_m, north_m = origin.enu_of(float(place["lat"]) * 1e-7, float(place["lon"]) * 1e-7)
        # a GNSS fix on the ground is nearer than a quarter of the way to a neighbour
        assert abs(east_m - row["home_enu_m"][0]) < apart_m / 4, row["id"]
        assert abs(north_m - row["home_enu_m"][1]) < apart_m / 4, row["id"]
    kinds = load(folder).table("decisions").column("kind").to_pylist()
    assert "decision.foreign_frame" not in kinds
    assert "decision.bad_frame" not in kinds


def test_every_one_of_them_flies_its_mission(flown: tuple[Run, Path]) -> None:
    run, folder = flown
    vehicles = {row["id"] for row in run.built.header["vehicles"]}
    events = load(folder).table("events").to_pylist()
    assert {row["about"] for row in events if row["kind"] == "event.armed"} == vehicles
    outcomes = load(folder).outcomes
    assert outcomes.keys() == vehicles
    if run.built.scenario.duration_s > 20.0:
        assert {outcome["state"] for outcome in outcomes.values()} == {"complete"}
