"""Faults of sensors that call themselves slow: their runs are those in which they are called at every tick."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.contracts.components import Sensors
from skyrange.kernel.acts import sensor_hooks
from skyrange.record import RunRecord
from skyrange.scenario.shipped import FAULT_EXAMPLES, load
from skyrange.study.runs import fly


def flown(name: str, folder: Path) -> RunRecord:
    acts = "faults" if name in FAULT_EXAMPLES else "attacks"
    return fly(load(name, ["duration_s=24", f"{acts}.*.start_s=8"]), folder, report=False)


@pytest.mark.catalogue
@pytest.mark.parametrize(
    "name", ["gnss.capture", "gnss.drift", "gnss.jam", "gnss.meacon", "gnss.multipath", "gnss.outage", "sensor.failure"]
)
def test_called_at_new_readings_alone_they_give_the_same_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0

    class Counting(sensor_hooks.SensorHookInjector):
        def alter(self, *arguments: Any) -> Sensors:
            nonlocal calls
            calls += 1
            return super().alter(*arguments)

    monkeypatch.setattr("skyrange.kernel.run_parts.SensorHookInjector", Counting)
    quick = flown(name, tmp_path / "quick")
    few, calls = calls, 0

    class AtEveryTick(Counting):
        @property
        def slow(self) -> bool:
            return False

        @slow.setter
        def slow(self, value: bool) -> None:
            pass

    monkeypatch.setattr("skyrange.kernel.run_parts.SensorHookInjector", AtEveryTick)
    thorough = flown(name, tmp_path / "thorough")
    assert 2 * few < calls
    assert quick.manifest["digests"]["fingerprint"] == thorough.manifest["digests"]["fingerprint"]
