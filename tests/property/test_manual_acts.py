"""Is a run with starts and stops by hand the run that its scenario gives when it is flown again? To the bit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.record import RunRecord, load
from skyrange.record.read.run import open_folder
from skyrange.record.schema import TABLES
from skyrange.record.verification import verify_run
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.run import Run
from skyrange.scenario.model.manual_acts import ManualActTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import DEFENCE_EXAMPLES, EXAMPLES, FAULT_EXAMPLES, FOLDER
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scenario.toml_files import load_data, load_file, load_text
from skyrange.study.runs import fly
from tests.catalogue import draw
from tests.tiers import examples

pytestmark = pytest.mark.rotating

DURATION_S = 4.0
TEXT = f"""
name = "hands"
seed = 5
duration_s = {DURATION_S}
origin = [40.778, -73.955]
record = {{ truth_hz = 50 }}

[radio]

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = {{ path = {{ points = [[0, 20]], alt_m = 4 }} }}

[[attacks]]
id = "gap"
kind = "link.delay"
manual = true
params = {{ links = ["gcs:blue/*"], delay_s = 0.1 }}

[[attacks]]
id = "flood"
kind = "link.flood"
manual = true
for_s = 0.7
params = {{ links = ["gcs:blue/*"], towards = "station", rate_hz = 40 }}

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
manual = true
start_s = 1
stop_s = 3.5
params = {{ at = [2, 20, 8], transmitter_m = [5, 20, 2], rate_hz = 5 }}

[[attacks]]
id = "jump"
kind = "gnss.jump"
manual = true
params = {{ vehicles = ["blue/b1"], offset_m = [3, 0, 2] }}

[[faults]]
id = "weak"
kind = "motor.loss"
manual = true
params = {{ vehicles = ["blue/b1"], motor = 3, loss = 0.1 }}

[[faults]]
id = "lossy"
kind = "link.loss"
start_s = 0.5
params = {{ links = ["gcs:blue/*"], burst_s = 0.2, gap_s = 0.2 }}

[[defences]]
id = "test"
kind = "gnss.innovation"
manual = true
params = {{ action = "reject" }}
"""
SCENARIO = load_text(TEXT)
PLAIN = ("gap", "ghost", "jump", "weak", "test", "flood")
"""Acts whose parts do the same whether they know their start before or not."""


class Request(NamedTuple):
    """A start or a stop by hand, asked for when the run has reached a time."""

    at_s: float
    act: str
    action: str


def requests(scenario: Scenario) -> st.SearchStrategy[list[Request]]:
    """Requests in order of time, more of them to start an act than to stop one."""
    times = st.integers(0, round(scenario.duration_s * 1000)).map(lambda ms: ms / 1000)
    one = st.builds(
        Request, times, st.sampled_from(sorted(scenario.acting)), st.sampled_from(["start", "start", "stop"])
    )
    return st.lists(one, min_size=3, max_size=12).map(sorted)


def fly_by_hand(scenario: Scenario, asked: Sequence[Request], folder: Path) -> RunRecord:
    run = Run.start(scenario, folder)
    for request in asked:
        run.advance(request.at_s)
        with suppress(InputError):  # of an act that has started, or has not, or whose time it is not
            act = run.acts[request.act]
            at_s = act.start(by="a hand") if request.action == "start" else act.stop(by="a hand")
            assert request.at_s < at_s <= request.at_s + 0.010001 or at_s == request.at_s == 0.0
    run.advance(scenario.duration_s)
    run.finish()
    return load(folder)


def fly_again(record: RunRecord, folder: Path) -> RunRecord:
    return fly(load_file(record.path / "scenario.toml"), folder, report=False)


def require_the_same_again(scenario: Scenario, asked: Sequence[Request]) -> None:
    with TemporaryDirectory() as folder:
        hand = fly_by_hand(scenario, asked, Path(folder, "hand"))
        assert_same(hand, fly_again(hand, Path(folder, "again")))


def with_hands(name: str) -> Scenario:
    """The example of one kind, with acts that start by hand, but for those that alter what is loaded at the start."""
    data = load_scenario(name, ["duration_s=45"]).data()
    from_start = {act.id for act in load_scenario(name).attacks if act.plugin.from_start}
    for table in (*data["attacks"], *data["faults"], *data["defences"]):
        table |= {"manual": table["id"] not in from_start, "start_s": 0.0, "muted": False}
        for key in ("when", "stop_s"):
            table.pop(key, None)
    return load_data(data, folder=FOLDER)


def assert_same(one: RunRecord, other: RunRecord) -> None:
    assert one.manifest["digests"] == other.manifest["digests"]
    assert one.manifest.get("manual_acts") == other.manifest.get("manual_acts")
    for table in TABLES:
        assert one.table(table).equals(other.table(table)), table


@settings(max_examples=examples(12))
@given(asked=requests(SCENARIO))
def test_a_run_by_hand_is_its_schedule_flown(asked: list[Request]) -> None:
    require_the_same_again(SCENARIO, asked)


@pytest.mark.slow
@settings(max_examples=examples(100))
@given(asked=requests(SCENARIO))
def test_many_runs_by_hand_are_their_schedules_flown(asked: list[Request]) -> None:
    require_the_same_again(SCENARIO, asked)


@pytest.mark.slow
@pytest.mark.parametrize("name", draw([*EXAMPLES, *FAULT_EXAMPLES, *DEFENCE_EXAMPLES], 6))
def test_each_kind_by_hand_is_its_schedule_flown(name: str) -> None:
    scenario = with_hands(name)
    starts = [Request(21.337, act, "start") for act in scenario.acting]
    require_the_same_again(scenario, [*starts, *(Request(35.001, act, "stop") for act in scenario.acting)])


@settings(max_examples=examples(8))
@given(start_ms=st.integers(1000, 2500), lasts_ms=st.integers(20, 600))
def test_a_start_by_hand_is_a_start_in_seconds(start_ms: int, lasts_ms: int) -> None:
    times = start_ms / 1000, (start_ms + lasts_ms) / 1000
    asked = [Request(at_s, act, action) for at_s, action in zip(times, ("start", "stop"), strict=True) for act in PLAIN]
    with TemporaryDirectory() as folder:
        hand = fly_by_hand(SCENARIO, asked, Path(folder, "hand"))
        windows: dict[str, list[float]] = {row["act"]: [] for row in hand.manifest["manual_acts"]}
        for row in hand.manifest["manual_acts"]:
            windows[row["act"]].append(row["at_s"])
        data = SCENARIO.data()
        for table in (*data["attacks"], *data["faults"], *data["defences"]):
            if table["id"] in windows:
                table["manual"], (table["start_s"], table["stop_s"]) = False, windows[table["id"]]
        assert (
            fly(load_data(data), Path(folder, "seconds"), report=False).manifest["digests"] == hand.manifest["digests"]
        )


def test_an_act_by_hand_in_one_of_two_branches_is_in_that_one_alone(tmp_path: Path) -> None:
    trunk = Run.start(SCENARIO, tmp_path / "trunk")
    trunk.acts["gap"].start()
    trunk.advance(1.0)
    branch = trunk.fork(tmp_path / "branch")
    branch.acts["jump"].start()
    trunk.acts["gap"].stop()
    for run in (trunk, branch):
        run.advance(DURATION_S)
        run.finish()
    records = [load(tmp_path / name) for name in ("trunk", "branch")]
    done = [[(row["act"], row["action"]) for row in record.manifest["manual_acts"]] for record in records]
    assert done == [[("gap", "start"), ("gap", "stop")], [("gap", "start"), ("jump", "start")]]
    for record in records:
        assert verify_run(open_folder(record.path)).ok
        assert_same(record, fly_again(record, tmp_path / f"{record.path.name}-again"))


def test_runs_of_a_batch_have_their_own_acts_by_hand(tmp_path: Path) -> None:
    planned = [
        ManualActTable(at_s=1.5, act="jump", action="start"),
        ManualActTable(at_s=2.5, act="jump", action="stop"),
    ]
    scenarios = [SCENARIO, SCENARIO.model_copy(update={"manual_acts": tuple(planned)}), SCENARIO]
    batch = RunBatch.start([BatchedFlight(one, tmp_path / str(n)) for n, one in enumerate(scenarios)])
    batch.runs[2].acts["gap"].start()
    batch.execute()
    for number in range(3):
        assert_same(load(tmp_path / str(number)), fly_again(load(tmp_path / str(number)), tmp_path / f"{number}-again"))
    assert [len(load(tmp_path / str(n)).manifest.get("manual_acts", ())) for n in range(3)] == [0, 2, 1]
