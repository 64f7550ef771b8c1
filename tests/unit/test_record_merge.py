"""The parts of a live run become the record that one kernel would have written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.agent.frames import Fate, Frame
from skyrange.agent.links import AttackPlan, Channel, TapPlacement
from skyrange.agent.messages import Note
from skyrange.agent.verdicts import Label
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Time
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.matching import TOLERANCE_NS, WINDOW_NS, LaneMatching, Sent
from skyrange.record.merge import merge
from tests.probes.test_taps import Meddler
from tests.probes.toys import MS, ROUGH
from tests.unit.live_parts import Flown, fly, frames_of
from tests.unit.record_sample import StillWorld, make_frame

WIRE = Channel(mode="reliable", latency_ns=20 * MS, loss=0.1)


def meddled(*sides: str) -> dict[str, Any]:
    return {
        "taps": [TapPlacement("gcs:blue/b1", side, Meddler, "mitm") for side in sides],
        "attacks": [AttackPlan("mitm")],
    }


def merged(flown: Flown, into: Path) -> tuple[RunRecord, RunRecord]:
    merge(flown.parts, into, flown.header)
    return load(into), load(flown.whole)


def rows(run: RunRecord, table: str) -> list[str]:
    return sorted(map(str, run.table(table).to_pylist()))


def same(found: RunRecord, whole: RunRecord) -> None:
    assert frames_of(found) == frames_of(whole)
    for table in ("decisions", "events", "labels"):
        assert rows(found, table) == rows(whole, table), table
    for table in ("truth", "sensors"):
        assert found.table(table).equals(whole.table(table)), table
    for key in ("digests", "counts", "outcomes", "simulated_s", "record", "operators", "links"):
        assert found.manifest[key] == whole.manifest[key], key
    assert found.telemetry.equals(whole.telemetry)


@pytest.mark.parametrize("offset_ns", [0, 3 * NS_PER_S // 2, -NS_PER_S], ids=["one clock", "behind", "ahead"])
@pytest.mark.parametrize(
    ("gcs", "sides"),
    [(None, ()), (ROUGH, ()), (WIRE, ()), (None, ("gcs", "companion")), (ROUGH, ("companion",))],
    ids=["steady", "rough", "reliable", "tapped", "rough and tapped"],
)
def test_two_parts_are_the_record_of_one_kernel(
    tmp_path: Path, gcs: Channel | None, sides: Sequence[str], offset_ns: Time
) -> None:
    flown = fly(tmp_path, gcs, lambda: meddled(*sides) if sides else {}, offset_ns)
    found, whole = merged(flown, tmp_path / "merged")
    same(found, whole)
    assert found.status == "complete"
    assert whole.rows("decisions") > 20
    assert whole.rows("truth") > 20
    assert found.outcomes["blue/b1"]["state"] == "complete"
    assert found.manifest["crossings"]["matched"] > 40
    assert found.manifest["crossings"]["outside"] == 0
    assert bool(whole.rows("labels")) == bool(sides)
    for table, key in (("frames", "sent_ns"), ("decisions", "time_ns"), ("labels", "at_ns"), ("truth", "time_ns")):
        times = found.table(table, [key]).column(0).to_pylist()
        assert times == sorted(times)
