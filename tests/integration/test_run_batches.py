"""Runs that fly together are, each of them, the run that flies alone: rows, types and digests."""

from __future__ import annotations

import random
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly import batches
from skyrange.assembly.batches import batch_key, build_batch, count_together, explain_alone
from skyrange.assembly.build import Additions, build
from skyrange.attack.gnss import drift
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrames
from skyrange.core.time import NS_PER_S
from skyrange.kernel import Kernel
from skyrange.record import Recorder, RunRecord
from skyrange.record.schema import TABLES
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.memory import RunGarbage
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import SHIPPED, load
from skyrange.scenario.toml_files import load_text
from skyrange.study.execution import flight
from skyrange.study.execution.flight import fly_runs
from skyrange.study.execution.plan import PlannedRun
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

TEXT = """
name = "street"
seed = 3
duration_s = 11
origin = [40.778, -73.955]
wind = { speed_mps = 3, from_deg = 200, turbulence = "light" }

[city]
grid = { blocks = [2, 2], height_m = [45, 90], street_m = 40, block_m = 90 }

[[operators]]
id = "blue"
station = [0, -60]
  [[operators.vehicles]]
  id = "b1"
  start = [0, -40]
  plan = { path = { points = [[0, 0], [0, 60]], alt_m = 8 }, speed_mps = 5 }
  [[operators.vehicles]]
  id = "b2"
  start = [3, -40]
  plan = { path = { points = [[4, 0]], alt_m = 6 }, speed_mps = 4 }

[[operators]]
id = "green"
station = [0, 60]
  [[operators.vehicles]]
  id = "g1"
  start = [0, 30]
  plan = { path = { points = [[0, 10]], alt_m = 7 }, speed_mps = 4 }
"""
RADIO = """
[radio]

[[radio.receivers]]
id = "corner"
operator = "blue"
place = [8, 0, 3]
placing = "clear"
"""
GNSS = """
[[attacks]]
id = "pull"
kind = "gnss.drift"
start_s = 5
params = { vehicles = ["blue/b1"], rate_mps = [0.5, 0, 0] }
[[defences]]
id = "test"
kind = "gnss.innovation"
"""
ACTS = {
    "nothing": "",
    "gnss": GNSS,
    "checks": """
[[attacks]]
id = "jump"
kind = "gnss.jump"
start_s = 6
stop_s = 8.25
params = { vehicles = ["blue/b1"], offset_m = [30, 0, 20] }
[[defences]]
id = "innovation"
kind = "gnss.innovation"
params = { action = "reject", recover_s = 0.5, vehicles = ["green/g1", "blue/b1"] }
[[defences]]
id = "height"
kind = "gnss.barometer"
params = { vehicles = ["blue/b1"] }
""",
    "link": """
[[attacks]]
id = "gap"
kind = "link.drop"
start_s = 4
params = { links = ["gcs:blue/*"], probability = 0.4 }
[[detectors]]
id = "seq"
kind = "mavlink.sequence"
links = ["gcs:*"]
side = "gcs"
""",
    "radio": RADIO
    + """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 3
params = { at = [2, 20, 8], transmitter_m = [5, 20, 2] }
[[faults]]
id = "gust"
kind = "motor.loss"
start_s = 5
params = { vehicles = ["blue/b2"], motor = 3, loss = 0.1 }
""",
    "honest": RADIO
    + """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 3
stop_s = 8.3
honest = true
params = { at = [2, 20, 8], transmitter_m = [5, 20, 2] }
"""
    + GNSS,
}


LONG_ACTS = ("checks", "honest")
EACH_ACTS = [pytest.param(acts, marks=[pytest.mark.slow] if acts in LONG_ACTS else []) for acts in ACTS]


def scenarios(acts: str, level: str, count: int) -> list[Scenario]:
    """Runs that differ in seed, and in whether what acts is muted."""
    scenario = load_text(TEXT + ACTS[acts]).model_copy(update={})
    record = scenario.record.model_copy(update={"level": level})
    muted = {
        name: tuple(
            act if getattr(act, "honest", False) else act.model_copy(update={"muted": True})
            for act in getattr(scenario, name)
        )
        for name in ("attacks", "faults", "defences")
    }
    return [
        scenario.model_copy(update={"seed": 3 + number, "record": record, **(muted if number % 2 else {})})
        for number in range(count)
    ]


def fly_together(chosen: Sequence[Scenario], path: Path, *, in_memory: bool) -> list[RunRecord]:
    batch = RunBatch.start([BatchedFlight(one, path / str(number), in_memory) for number, one in enumerate(chosen)])
    batch.execute()
    return batch.records()


def require_equal(alone: RunRecord, together: RunRecord) -> None:
    mine, other = alone.manifest, together.manifest
    assert mine["digests"] == other["digests"]
    assert [key for key in mine if key not in ("timings", "files") and mine[key] != other.get(key)] == []
    for table in TABLES:
        if alone.keeps(table):
            left, right = alone.table(table), together.table(table)
            assert left.schema.equals(right.schema), table
            if table in ("frames", "payloads"):  # payloads are numbered in the order in which they are first written
                left, right = left.drop_columns("payload_id"), right.drop_columns("payload_id")
            if table == "payloads":
                left, right = (one.sort_by([("payload", "ascending")]) for one in (left, right))
            assert left.equals(right), table
    if alone.keeps("frames"):
        assert [one.payload for one in alone.frames_with_payloads()] == [
            one.payload for one in together.frames_with_payloads()
        ]
    assert alone.outcomes == together.outcomes
    assert alone.city == together.city


@pytest.mark.parametrize("acts", EACH_ACTS)
def test_each_run_in_memory_is_that_of_itself_alone(acts: str, tmp_path: Path) -> None:
    chosen = scenarios(acts, "study", 2)
    together = fly_together(chosen, tmp_path / "batch", in_memory=True)
    assert not (tmp_path / "batch").exists()
    for number, scenario in enumerate(chosen):
        require_equal(fly(scenario, tmp_path / f"alone-{number}", report=False), together[number])


def test_real_aircraft_on_claimed_tracks_fly_together(tmp_path: Path) -> None:
    changes = {"start_s = 3": "start_s = 1", "stop_s = 8.3": "stop_s = 2.9", "start_s = 5": "start_s = 2"}
    text = TEXT + ACTS["honest"]
    for old, new in (changes | {"duration_s = 11": "duration_s = 4"}).items():
        text = text.replace(old, new)
    scenario = load_text(text)
    study = scenario.record.model_copy(update={"level": "study"})
    chosen = [scenario.model_copy(update={"seed": seed, "record": study}) for seed in (3, 4)]
    for number, together in enumerate(fly_together(chosen, tmp_path / "batch", in_memory=True)):
        assert together.manifest["honest"]
        require_equal(fly(chosen[number], tmp_path / f"alone-{number}", report=False), together)


@pytest.mark.parametrize(
    "acts", [pytest.param(acts, marks=[] if acts in ("nothing", "link") else [pytest.mark.slow]) for acts in ACTS]
)
def test_each_run_in_a_folder_is_that_of_itself_alone(acts: str, tmp_path: Path) -> None:
    chosen = scenarios(acts, "full", 2)
    together = fly_together(chosen, tmp_path / "batch", in_memory=False)
    for number, scenario in enumerate(chosen):
        alone = fly(scenario, tmp_path / f"alone-{number}", report=False)
        require_equal(alone, together[number])
        assert alone.messages == together[number].messages
        assert {path.name for path in alone.path.iterdir()} == {path.name for path in together[number].path.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 7, 64])
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios(name: str, size: int, tmp_path: Path) -> None:
    """In random company and order; fleets above 16 aircraft in twos alone. Two of the runs are flown alone as well."""
    scenario = load(name, ["record.level=study"])
    most = count_together(scenario)
    if reason := explain_alone(scenario):
        assert most == 1, reason
        return
    if size > 2 and sum(1 for _ in scenario.fleet) > 16:
        return
    muted = scenario.model_copy(
        update={"attacks": tuple(attack.model_copy(update={"muted": True}) for attack in scenario.attacks)}
    )
    chance = random.Random(f"{name} {size}")
    chosen = [scenario, muted.model_copy(update={"seed": 5})]
    while len(chosen) < min(size, most):
        chosen.append(chance.choice([scenario, muted]).model_copy(update={"seed": chance.randrange(1 << 16)}))
    order = chance.sample(range(len(chosen)), len(chosen))
    together = fly_together([chosen[place] for place in order], tmp_path / "batch", in_memory=True)
    for place in range(2):
        require_equal(fly(chosen[place], tmp_path / f"alone-{place}", report=False), together[order.index(place)])


@pytest.mark.slow
@pytest.mark.parametrize("size", [7, 64])
def test_company_and_order_do_not_matter(size: int, tmp_path: Path) -> None:
    chosen = scenarios("gnss", "study", size)
    forwards = fly_together(chosen, tmp_path, in_memory=True)
    backwards = fly_together(chosen[::-1], tmp_path, in_memory=True)[::-1]
    for one, other in zip(forwards, backwards, strict=True):
        require_equal(one, other)
    require_equal(fly(chosen[-1], tmp_path / "alone", report=False), forwards[-1])


@dataclass
class Keeper:
    """Keeps the frames that it is shown, by run."""

    service_ns: int = NS_PER_S
    seen: dict[int, list[tuple[Any, ...]]] = field(default_factory=dict)

    def observe(self, now: int, frames: ObservedFrames) -> Sequence[Alert]:
        for port, *frame in frames:
            self.seen.setdefault(port.run, []).append((now, port.endpoint, port.link, *frame))
        return ()

    def __call__(self) -> Keeper:
        return self


@pytest.mark.parametrize("acts", ["nothing", "link"])
def test_a_monitor_sees_what_it_would_see_alone_at_every_end(acts: str) -> None:
    """One for each run, and one that listens in all of them."""
    chosen = scenarios(acts, "study", 2)
    own, shared = [Keeper() for _ in chosen], Keeper()
    everywhere = ["gcs:*", "*:blue/*", "*:green/*"]
    placed = [Additions(monitors=[MonitorPlacement("own", keeper, everywhere, "*")]) for keeper in own]
    built = build_batch(chosen, placed)
    wirings, none = [run.wiring for run in built.runs], [()] * len(chosen)
    together = MonitorPlacement("all", shared, everywhere, "*")
    Kernel.of_batch(wirings, none, built.world, built.engines, [together]).advance(8 * NS_PER_S)
    for number, scenario in enumerate(chosen):
        alone = Keeper()
        Kernel(build(scenario, Additions(monitors=[MonitorPlacement("own", alone, everywhere, "*")])).wiring).advance(
            8 * NS_PER_S
        )
        assert any(frame[1].endswith(".autopilot") and frame[3] for frame in alone.seen[0])
        assert own[number].seen[0] == alone.seen[0]
        assert shared.seen[number] == alone.seen[0]


def planned(chosen: Sequence[Scenario]) -> list[PlannedRun]:
    return [PlannedRun(f"runs/{number}", one, in_memory=True) for number, one in enumerate(chosen)]


def test_a_run_that_fails_does_so_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = scenarios("gnss", "study", 3)
    wrong = load_text((TEXT + ACTS["gnss"]).replace("[0.5, 0, 0]", "[0.5, 0, 0.25]"))
    chosen[2] = wrong.model_copy(update={"seed": 4, "record": chosen[0].record})
    shift = drift.Drift.shift

    def broken(self: Any, seconds: Any) -> Any:
        if self.rate_mps[2] == 0.25:
            raise ArithmeticError("no shift")
        return shift(self, seconds)

    monkeypatch.setattr(drift.Drift, "shift", broken)
    found = fly_runs(planned(chosen), tmp_path)
    assert set(found.records) == {"runs/0", "runs/1"}
    assert "no shift" in found.errors["runs/2"]


def test_with_too_little_memory_each_half_flies_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    start = RunBatch.start

    def limited(flights: Sequence[BatchedFlight]) -> RunBatch:
        sizes.append(len(flights))
        if len(flights) > 2:
            raise MemoryError
        return start(flights)

    monkeypatch.setattr("skyrange.study.execution.flight.RunBatch.start", limited)
    chosen = [one.model_copy(update={"duration_s": 1.0}) for one in scenarios("nothing", "study", 5)]
    found = fly_runs(planned(chosen), tmp_path)
    assert sizes == [5, 2, 3, 2]
    assert set(found.records) == {f"runs/{number}" for number in range(5)}
    assert [remark.split(":")[0] for remark in found.remarks] == [
        f"{size} runs did not fit into memory together" for size in (5, 3)
    ]


@pytest.mark.parametrize("count", [1, 2])
def test_nothing_of_ended_runs_stays_in_memory(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorders: list[weakref.ref[Recorder]] = []
    attach = Recorder.attach_files

    def noted(recorder: Recorder, *args: Any) -> None:
        recorders.append(weakref.ref(recorder))
        attach(recorder, *args)

    monkeypatch.setattr(Recorder, "attach_files", noted)
    monkeypatch.setattr(RunGarbage, "EVERY", 1)
    chosen = [one.model_copy(update={"duration_s": 1.0}) for one in scenarios("nothing", "study", count)]
    found = fly_runs(planned(chosen), tmp_path)
    assert len(found.records) == count
    assert [recorder() for recorder in recorders] == [None] * count


def test_a_run_that_is_another_in_a_batch_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight, "CHECKED_SHARE", 1)
    chosen = scenarios("nothing", "study", 2)
    assert not fly_runs(planned(chosen), tmp_path).errors
    other = fly(chosen[0].model_copy(update={"seed": 9}), tmp_path / "other", report=False)
    monkeypatch.setattr(flight, "fly", lambda *_, **__: other)
    found = fly_runs(planned(chosen), tmp_path)
    assert not found.records
    assert all("another flight than alone" in error for error in found.errors.values())


def test_what_cannot_fly_together_says_why() -> None:
    scenario = load_text(TEXT)
    assert explain_alone(scenario) == ""
    assert count_together(scenario) == batches.MOST_AIRCRAFT // 3
    other = load_text(TEXT.replace('id = "b2"', 'id = "b2"\n  autopilot = "ardupilot"'))
    assert "its autopilots are ardupilot" in explain_alone(other)
    assert count_together(other) == 1
    windy = load_text(TEXT.replace("speed_mps = 3, from", "speed_mps = 4, from"))
    assert batch_key(windy) != batch_key(scenario)
    honest = [load_text(TEXT + ACTS[acts]) for acts in ("radio", "honest")]
    for unlike in ([scenario, windy], honest):
        with pytest.raises(ValueError, match="cannot fly in one batch"):
            build_batch(unlike)
