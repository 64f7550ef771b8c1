"""What is recorded of sensors: as sensed, and as the autopilot received it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.plugins import registry as plugins
from skyrange.record import RunRecord
from skyrange.record.schema import TABLES
from skyrange.scenario.shipped import EXAMPLES, FAULT_EXAMPLES
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly

pytestmark = pytest.mark.slow
SENSORS = {"gnss", "baro", "compass", "accel", "gyro"}
KINDS = [
    kind
    for kind in plugins.kinds(AttackPlugin.group)
    if SENSORS.issuperset(AttackPlugin.find(kind).surface) and AttackPlugin.find(kind).surface
]
FAULTS = ["gnss.outage", "sensor.failure"]
FIRST_S, ACTS_S, PAUSE_S = 2.0, 0.7, 0.3
"""When the first kind begins to act, how long each acts, and how long nothing does before the next one."""
SLOW_S = {"gnss.pull_off": 7.0, "gnss.meacon": 3.0}
"""Kinds that begin with true fixes, or with old ones, act for longer."""


def windows() -> dict[str, tuple[float, float]]:
    """From when until when each kind acts, in seconds: one after the other."""
    found, start_s = {}, FIRST_S
    for kind in (*KINDS, *FAULTS):
        found[kind] = start_s, start_s + SLOW_S.get(kind, ACTS_S)
        start_s = found[kind][1] + PAUSE_S
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """One flight in which every kind acts, each with the parameters of its example and in its own time."""
    plan = {"path": {"points": [[0, 0], [40, 0]], "alt_m": 20}, "speed_mps": 1, "end": "land"}

    def act(kind: str, example: Path, table: str) -> dict[str, Any]:
        (declared, *_) = tomllib.loads(example.read_text())[table]
        start_s, stop_s = windows()[kind]
        return {**declared, "id": kind.replace(".", "-"), "start_s": start_s, "stop_s": stop_s}

    data = {
        "name": "every-sensor-act",
        "seed": 1,
        "duration_s": max(stop_s for _, stop_s in windows().values()) + PAUSE_S,
        "origin": {"lat": 40.778, "lon": -73.955, "alt_msl_m": 20, "geoid_m": -32.7},
        "record": {"sensors_hz": 7},  # 20 Hz of an act on gyros is at phase 0 at each tick of 10 Hz
        "operators": [{"id": "blue", "vehicles": [{"id": "b1", "plan": plan}]}],
        "attacks": [act(kind, EXAMPLES[kind], "attacks") for kind in KINDS],
        "faults": [act(kind, FAULT_EXAMPLES[kind], "faults") for kind in FAULTS],
    }
    return fly(load_data(data), tmp_path_factory.mktemp("sensors") / "run", report=False)


def test_what_is_received_departs_from_what_is_sensed_while_an_act_acts_and_at_no_other_time(run: RunRecord) -> None:
    sensed, received = by_row(run.table("sensors")), by_row(run.table("received_sensors"))
    assert received.keys() <= sensed.keys()
    labels = run.table("labels").to_pylist()
    for kind, (start_s, stop_s) in windows().items():
        began = min((row["at_ns"] for row in labels if row["attack"] == kind.replace(".", "-")), default=None)
        assert began is not None, kind
        assert any(began <= time_ns <= stop_s * 1e9 for time_ns, _ in received), f"{kind} alters nothing recorded"
        assert not any(start_s * 1e9 <= time_ns < began for time_ns, _ in received), f"{kind} altered before it acted"
    for (time_ns, vehicle), values in received.items():
        assert any(start_s * 1e9 <= time_ns <= stop_s * 1e9 for start_s, stop_s in windows().values()), time_ns
        assert values.tobytes() != sensed[time_ns, vehicle].tobytes(), time_ns


def by_row(table: pa.Table) -> dict[tuple[int, str], np.ndarray[Any, Any]]:
    names = [name for name in table.column_names if name not in ("time_ns", "vehicle")]
    values = np.column_stack([table.column(name).to_numpy() for name in names])
    keys = zip(table.column("time_ns").to_pylist(), table.column("vehicle").to_pylist(), strict=True)
    return dict(zip(keys, values, strict=True))


def test_the_columns_say_where_readings_were_taken(run: RunRecord) -> None:
    for table, stage in (
        ("sensors", b"as sensed, before attacks"),
        ("received_sensors", b"as received by the autopilot"),
    ):
        schema = run.table(table).schema
        assert schema.names == [column.name for column in TABLES[table]]
        for name in schema.names[2:]:
            assert stage in schema.field(name).metadata[b"meaning"], (table, name)
