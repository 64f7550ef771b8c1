"""Alerts are recorded, read back and merged, and a monitor that runs over the record raises them again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from skyrange.contracts.alerts import Alert
from skyrange.contracts.links import Channel
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrames
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.record import Recorder, RunRecord, load, replay_monitor
from skyrange.record.live_merge.merge import merge
from tests.probes.test_monitors import Keeper, blocks_wiring, range_wiring, voices_wiring
from tests.probes.toys import MS, ROUGH
from tests.unit.live_parts import fly as fly_parts
from tests.unit.live_parts import header_of
from tests.unit.record_sample import HEADER

pytestmark = pytest.mark.rotating

END = NS_PER_S


def every(*placements: MonitorPlacement) -> tuple[MonitorPlacement, ...]:
    return placements or (
        MonitorPlacement("station", Keeper, ["gcs:*"], "gcs"),
        MonitorPlacement("all", lambda: Keeper(70 * MS), ["*"], "*"),
    )


def recorded(folder: Path, plan: Wiring, end: Time = END, close: bool = True) -> RunRecord:
    header = header_of(plan.links)
    if plan.monitors:
        header["detectors"] = [{"id": placement.id} for placement in plan.monitors]
    recorder = Recorder.open(folder, header)
    kernel = Kernel(plan, [recorder])
    kernel.advance(end)
    kernel.finish()
    if close:
        recorder.close(extra={"simulated_s": end / NS_PER_S})
    else:
        recorder.flush()
    return load(folder)


def rows(record: RunRecord) -> list[tuple[Any, ...]]:
    columns = ("time_ns", "detector", "at_ns", "subject", "kind", "score", "data")
    return [tuple(row[name] for name in columns) for row in record.table("alerts").to_pylist()]


def replayed(record: RunRecord, placements: Sequence[MonitorPlacement]) -> list[tuple[Any, ...]]:
    return [
        (found.time_ns, found.detector, alert.at, alert.subject, alert.kind, alert.score, json.dumps(dict(alert.data)))
        for placement in placements
        for found in replay_monitor(record, placement)
        for alert in [found.alert]
    ]


@pytest.mark.parametrize("make", [range_wiring, voices_wiring, blocks_wiring])
@pytest.mark.parametrize("tapped", [False, True])
@pytest.mark.parametrize("gcs", [None, ROUGH, Channel(latency_ns=9 * MS, jitter_ns=5 * MS, loss=0.1)])
def test_over_the_record_it_raises_the_same_alerts(
    make: Any, tapped: bool, gcs: Channel | None, tmp_path: Path
) -> None:
    record = recorded(tmp_path / "run", replace(make(gcs, tapped), monitors=every()))
    assert len(rows(record)) == 34 + 15
    assert sorted(replayed(record, every())) == sorted(rows(record))


@pytest.mark.parametrize("make", [range_wiring, voices_wiring, blocks_wiring])
@pytest.mark.parametrize("tapped", [False, True])
def test_monitors_at_the_same_ends_see_each_what_they_see_alone(make: Any, tapped: bool, tmp_path: Path) -> None:
    several = [
        MonitorPlacement("a", Keeper, ["gcs:*"], "gcs"),
        MonitorPlacement("b", Keeper, ["gcs:*"], "gcs"),
        MonitorPlacement("c", lambda: Keeper(70 * MS), ["gcs:*"], "gcs"),
        MonitorPlacement("d", Keeper, ["*"], "*"),
        MonitorPlacement("e", Keeper, ["gcs:*"], "gcs"),
    ]
    together = rows(recorded(tmp_path / "run", replace(make(ROUGH, tapped), monitors=several)))
    for one in several:
        alone = rows(recorded(tmp_path / one.id, replace(make(ROUGH, tapped), monitors=[one])))
        assert [row for row in together if row[1] == one.id] == alone
        assert len(alone) > 10
    assert [row[1] for row in together[:5]] == ["a", "b", "c", "d", "e"]


def test_a_record_that_ends_between_two_services_ends_there_again(tmp_path: Path) -> None:
    for number, end in enumerate((0, 1, 30 * MS - 1, 30 * MS, 59 * MS)):
        record = recorded(tmp_path / str(number), replace(range_wiring(None), monitors=every()), end)
        assert sorted(replayed(record, every())) == sorted(rows(record))
        assert len(rows(record)) == 2 + end // (30 * MS)


def test_what_is_written_is_what_was_raised(tmp_path: Path) -> None:
    record = recorded(tmp_path / "run", replace(range_wiring(None), monitors=every()))
    first = record.table("alerts").to_pylist()[0]
    assert {**first, "data": None} == {
        "time_ns": 0, "detector": "all", "kind": "kept", "subject": "batch", "score": first["score"], "at_ns": 0,
        "data": None,
    }  # fmt: skip
    assert record.manifest["counts"]["alerts"] == record.rows("alerts") == len(rows(record))


def test_there_is_a_file_only_where_there_are_detectors(tmp_path: Path) -> None:
    without = recorded(tmp_path / "without", range_wiring(None))
    assert not (without.path / "alerts.parquet").exists()
    assert "alerts" not in without.manifest["counts"]
    assert (without.table("alerts").num_rows, without.rows("alerts")) == (0, 0)

    class Silent(Keeper):
        def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
            return ()

    silent = MonitorPlacement("silent", Silent, ["*"], "*")
    with_one = recorded(tmp_path / "with", replace(range_wiring(None), monitors=[silent]))
    assert (with_one.path / "alerts.parquet").exists()
    assert with_one.manifest["counts"]["alerts"] == 0
    assert with_one.manifest["digests"] == without.manifest["digests"]
    files = [{path.relative_to(run.path) for path in run.path.rglob("*")} for run in (without, with_one)]
    assert files[1] - files[0] == {Path("alerts.parquet")}


def test_alerts_of_a_killed_run_are_in_its_spool(tmp_path: Path) -> None:
    record = recorded(tmp_path / "run", replace(range_wiring(None), monitors=every()), close=False)
    assert record.status == "killed or still running"
    assert len(rows(record)) == 34 + 15


@pytest.mark.parametrize("offset_ns", [0, 3 * NS_PER_S // 2, -NS_PER_S], ids=["one clock", "behind", "ahead"])
def test_parts_of_a_live_range_are_merged_with_their_alerts(tmp_path: Path, offset_ns: Time) -> None:
    class ByEnd(Keeper):
        """Alerts of each end by itself, as only that can be the same in several processes."""

        def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
            return [Alert(frame.at, frame.port.endpoint, "seen", 1.0, {"payload": repr(frame)}) for frame in frames]

    flown = fly_parts(tmp_path, None, lambda: {"monitors": [MonitorPlacement("all", ByEnd, ["*"], "*")]}, offset_ns)
    merge(flown.parts, tmp_path / "merged", {**flown.header, "detectors": [{"id": "all"}]})
    found, whole = load(tmp_path / "merged"), load(flown.whole)
    assert sorted(rows(found)) == sorted(rows(whole))
    assert len(rows(found)) > 100
    assert found.manifest["digests"] == whole.manifest["digests"]


def test_data_that_no_json_holds_is_blamed_on_the_detector(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    recorder.on_alert(0, "gap", Alert(0, "blue/b1", "heartbeat.gap", 1.0, {"most": float("inf")}))
    with pytest.raises(ComponentError, match=r"detector gap: raised heartbeat\.gap with data"):
        recorder.on_alert(0, "gap", Alert(0, "blue/b1", "heartbeat.gap", 1.0, {"set": {1}}))  # type: ignore[dict-item]
    recorder.close()
    (row,) = load(tmp_path / "run").table("alerts").to_pylist()
    assert row["data"] == '{"most": "inf"}'


def test_a_fork_takes_its_alerts_along(tmp_path: Path) -> None:
    plan = replace(range_wiring(None), monitors=every())
    straight = recorded(tmp_path / "straight", plan)
    recorder = Recorder.open(tmp_path / "stem", header_of(plan.links))
    kernel = Kernel(replace(range_wiring(None), monitors=every()), [recorder])
    kernel.advance(400 * MS)
    branch = recorder.fork(tmp_path / "branch")
    twin = kernel.fork([branch])
    for each, record in ((kernel, recorder), (twin, branch)):
        each.advance(END)
        each.finish()
        record.close()
        assert rows(load(record.path)) == rows(straight)


def test_a_placement_is_checked_against_the_records_links(tmp_path: Path) -> None:
    record = recorded(tmp_path / "run", range_wiring(None), 0)
    with pytest.raises(InputError, match="gcs:red"):
        list(replay_monitor(record, MonitorPlacement("d", Keeper, ["gcs:red/*"], "gcs")))
    with pytest.raises(InputError, match="service_ns"):
        list(replay_monitor(record, MonitorPlacement("d", lambda: Keeper(-NEVER), ["gcs:*"], "gcs")))
