"""An attack on a scenario's link, live, muted and removed: what the record says of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from skyrange.assembly.build import Additions
from skyrange.codec.mavlink import message_name
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.verdicts import Delay, Drop, Verdict
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, Time, from_seconds
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly


@dataclass
class Blinds:
    """Drops positions on the way to the ground station and delays everything that goes up to the aircraft."""

    link: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        if frame.direction == "fwd":
            return [Delay(now + 250 * NS_PER_MS)]
        return [Drop()] if message_name(frame.payload) == "GLOBAL_POSITION_INT" else []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


def flown(folder: Path, plan: Act | None) -> RunRecord:
    taps = [TapPlacement("gcs:blue/b1", "companion", Blinds, "blind")] if plan else []
    return fly(
        load("squares", ["duration_s=18"]), folder, additions=Additions(taps, [plan] if plan else []), report=False
    )


def positions(record: RunRecord, vehicle: str) -> list[float]:
    rows = record.telemetry("GLOBAL_POSITION_INT", ["time_ns", "vehicle"]).to_pylist()
    return [r["time_ns"] / 1e9 for r in rows if r["vehicle"] == vehicle]


@pytest.mark.rotating
def test_live_muted_and_removed(tmp_path: Path) -> None:
    removed = flown(tmp_path / "removed", None)
    muted = flown(tmp_path / "muted", Act("blind", start_ns=from_seconds(11.0), muted=True))
    live = flown(tmp_path / "live", Act("blind", start_ns=from_seconds(11.0)))

    assert muted.manifest["digests"] == removed.manifest["digests"], "a muted attack is a nominal run to the byte"
    assert muted.rows("labels") == 0

    labels = live.table("labels").to_pylist()
    assert {row["action"] for row in labels} == {"drop", "delay"}
    assert {(row["attack"], row["actor"]) for row in labels} == {("blind", "blind@gcs:blue/b1.companion")}
    assert min(row["at_ns"] for row in labels) >= from_seconds(11.0)
    assert max(positions(live, "blue/b1")) < 11.1 < 17.0 < max(positions(live, "blue/b2"))

    def frames_before_onset(record: RunRecord) -> list[dict[str, object]]:
        rows = record.table("frames").drop_columns(["payload_id", "fate", "arrived_ns"]).to_pylist()
        return [row for row in rows if row["sent_ns"] < from_seconds(10.9)]

    def key(row: dict[str, object]) -> tuple[object, ...]:
        return row["sent_ns"], row["link"], row["direction"], row["sender"], row["serial"]

    assert sorted(frames_before_onset(live), key=key) == sorted(frames_before_onset(removed), key=key)
    others = [r for r in live.table("truth").to_pylist() if r["vehicle"] != "blue/b1"]
    assert others == [r for r in removed.table("truth").to_pylist() if r["vehicle"] != "blue/b1"]
    noticed = [r for r in live.table("decisions").to_pylist() if r["about"] == "blue/b1" and r["time_ns"] > 11e9]
    assert noticed, "the ground station reacts to streams that have gone stale"


def test_a_tap_on_a_link_that_is_not_there_leaves_nothing_behind(tmp_path: Path) -> None:
    taps = [TapPlacement("gcs:blue/b9", "companion", Blinds, "blind")]
    with pytest.raises(InputError, match=r"gcs:blue/b9.*Did you mean 'gcs:blue/b"):
        fly(load("squares"), tmp_path / "run", additions=Additions(taps, [Act("blind")]))
    assert list(tmp_path.iterdir()) == []
