"""Are batches of ticks the same as single ticks, to the bit?"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

import skyrange
from skyrange.contracts.tick_batches import BatchStop
from skyrange.core.time import Time
from skyrange.kernel.kernel import Kernel
from skyrange.scenario.shipped import load
from skyrange.vehicle.builtin.tick_batch import FleetTickBatch

FLIGHTS = {
    "head-on": ["duration_s=60"],  # two collide, fall and hit the ground
    "wind": ["duration_s=40"],  # gusts, in which the air changes every 20 ms
    "city-fleet": ["duration_s=12"],  # walls, several operators, Remote ID
    "mitm-mission": ["duration_s=60"],
    "squares": ["duration_s=30", "sensors.noise=0"],
    "gnss.jump": ["duration_s=45", "attacks.jump.start_s=20.0033"],  # sensor faults, called every 10 ms
    "gnss.multipath": ["duration_s=30"],
    "gnss.drift": ["duration_s=45", 'defences=[{id="check",kind="gnss.barometer"}]'],
}


@pytest.mark.parametrize(("name", "changes"), FLIGHTS.items(), ids=list(FLIGHTS))
def test_batches_are_single_ticks(
    name: str, changes: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load(name, changes)
    stops: Counter[BatchStop] = Counter()
    run = FleetTickBatch.run

    def counted(batch: FleetTickBatch, first: Time, count: int) -> tuple[int, BatchStop]:
        begun, stop = run(batch, first, count)
        stops[stop] += begun > 0
        return begun, stop

    monkeypatch.setattr(FleetTickBatch, "run", counted)
    batched = skyrange.run(scenario, tmp_path / "batched")
    assert stops[BatchStop.COMPLETE] > 100
    assert stops[BatchStop.ENGINE] > 0  # a take-off at least
    if name == "head-on":
        assert stops[BatchStop.WORLD] > 0
    monkeypatch.setattr(Kernel, "_make_batch", lambda kernel: None)
    single = skyrange.run(scenario, tmp_path / "single")
    assert batched.manifest["digests"] == single.manifest["digests"]
    assert batched.manifest["outcomes"] == single.manifest["outcomes"]
