"""A trigger that holds in the world's process, or a person, starts a tap in another; in virtual time."""

from __future__ import annotations

import itertools
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_file
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared
from tests.live_ranges import VirtualSystem

pytestmark = pytest.mark.rotating

SCENARIO = """
name = "triggered"
seed = 4
duration_s = {duration_s}
origin = [-35.363328, 149.1652241]

[radio]

[[operators]]
id = "blue"
vehicles = [
  {{ id = "b1", remote_id = {{}}, plan = {{ path = {{ points = [[0.0, 30.0]], alt_m = 3.0 }}, end = "land" }} }},
]

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
when = {{ vehicle = "blue/b1", within_m = 1.0, of = [0.0, 0.0, 3.0] }}
for_s = {for_s}
params = {{ at = [50.0, 0.0, 20.0], via = "link", on = "blue/b1", rate_hz = 4.0 }}
"""
FOR_S = 2.5
PERIOD_NS = NS_PER_S // 4


def test_a_trigger_that_the_world_sees_starts_a_tap_elsewhere(tmp_path: Path) -> None:
    record = fly_virtual(prepared(SCENARIO.format(duration_s=10, for_s=FOR_S), tmp_path))
    assert record.manifest["live"]["links"]["rid_up:blue/b1"].startswith("zmq://")
    starts = [row for row in record.table("events").to_pylist() if row["kind"] == "event.attack_start"]
    (start_ns,) = [row["time_ns"] for row in starts]
    up_m = [(row["time_ns"], row["up_m"]) for row in record.table("truth").to_pylist()]
    assert max(time_ns for time_ns, up in up_m if up < 2.0) <= start_ns  # 1 m below that place
    assert min(up for time_ns, up in up_m if time_ns >= start_ns) > 1.9
    acts = sorted(row["at_ns"] for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    assert start_ns <= acts[0] < start_ns + PERIOD_NS + NS_PER_S // 10
    assert acts[-1] < start_ns + FOR_S * NS_PER_S <= acts[-1] + PERIOD_NS + NS_PER_S // 10
    assert len(acts) >= FOR_S * 4
    # what was put onto the companion's link went out by its radio, as its own
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    labels = [row for row in record.table("labels").to_pylist() if row["attack"] == "ghost"]
    assert {frames[row["child"] or row["frame"]].link for row in labels} == {"rid_up:blue/b1"}


def by_hand(text: str, *manual_acts: str) -> str:
    """The same with an attack that is started by hand, and what is planned."""
    line = next(line for line in text.splitlines() if line.startswith("when ="))
    return text.replace(line, "manual = true").replace(
        "\n[radio]\n", f"\nmanual_acts = [{', '.join(manual_acts)}]\n[radio]\n"
    )


def test_what_a_scenario_plans_by_hand_starts_and_stops_a_tap_elsewhere(tmp_path: Path) -> None:
    planned = [
        f'{{ at_s = {at_s}, act = "ghost", action = "{action}" }}' for at_s, action in ((2, "start"), (4, "stop"))
    ]
    record = fly_virtual(prepared(by_hand(SCENARIO.format(duration_s=6, for_s=60), *planned), tmp_path))
    require_acts(record, 2.0, 4.0, "scenario")


def test_a_person_starts_and_stops_a_tap_elsewhere(tmp_path: Path) -> None:
    told: list[float] = []

    async def play(flight: VirtualFlight) -> None:
        requests, answers = flight.range.requests, list[Future[Any]]()
        await flight.reach(2.0)
        for action, act in (("stop", "ghost"), ("start", "nobody"), ("start", "ghost"), ("start", "ghost")):
            answers.append(requests.submit(action, act, "viewer"))  # type: ignore[arg-type]
        await flight.until(lambda: all(answer.done() for answer in answers), 2.0, "answers")
        assert ["has not started" in str(answers[0].exception()), "ghost" in str(answers[1].exception())] == [True] * 2
        assert "one request" in str(answers[3].exception()) or "has started" in str(answers[3].exception())
        told.append(answers[2].result()["at_s"])
        await flight.reach(4.0)
        stop = requests.submit("stop", "ghost", "viewer")
        await flight.until(stop.done, 2.0, "an answer")
        told.append(stop.result()["at_s"])
        status = flight.range.members["world"].status
        assert [act["id"] for act in status["acts"]] == ["ghost"]

    flight = prepared(by_hand(SCENARIO.format(duration_s=6, for_s=60)), tmp_path)
    record = fly_virtual(flight, play)
    assert told[0] == pytest.approx(2.0, abs=0.3)
    assert told[1] == pytest.approx(4.0, abs=0.3)
    require_acts(record, told[0], told[1], "viewer")
    assert [(act.at_s, act.by) for act in load_file(record.path / "scenario.toml").manual_acts] == [
        (at_s, "viewer") for at_s in told
    ]
    with pytest.raises(InputError, match="the range has ended"):
        flight.range.requests.submit("stop", "ghost", "viewer")


def require_acts(record: RunRecord, start_s: float, stop_s: float, by: str) -> None:
    """That the attack acted in that time, in the process of the companion, as far as messages are in time."""
    rows = record.manifest["manual_acts"]
    assert [(row["at_s"], row["action"], row["by"], row["effective"]) for row in rows] == [
        (start_s, "start", by, True),
        (stop_s, "stop", by, True),
    ]
    noted = [row for row in record.table("events").to_pylist() if row["about"] == "ghost"]
    assert [(row["kind"], row["time_ns"] / NS_PER_S) for row in noted] == [
        ("event.attack_start", start_s),
        ("event.attack_stop", stop_s),
    ]
    acts = sorted(row["at_ns"] / NS_PER_S for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    assert start_s <= acts[0] < start_s + 0.35
    assert stop_s - 0.35 < acts[-1] < stop_s + 0.05
    assert len(acts) >= (stop_s - start_s) * 4 - 1


@pytest.mark.slow
def test_a_tap_whose_process_is_started_anew_acts_on(tmp_path: Path) -> None:
    async def kill_the_companion(flight: VirtualFlight) -> None:
        await flight.decided("world", "events", "event.attack_start")
        flight.system.process("blue/b1.companion").kill()

    system = VirtualSystem(start_s=2.0)
    text = SCENARIO.format(duration_s=13, for_s=5)
    record = fly_virtual(prepared(text, tmp_path, on_death="restart", system=system), kill_the_companion)
    assert list(record.manifest["live"]["started_anew"]) == ["blue/b1.companion"]
    (start_ns,) = [row["time_ns"] for row in record.table("events").to_pylist() if row["kind"] == "event.attack_start"]
    acts = sorted(row["at_ns"] for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    gaps = sorted(later - earlier for earlier, later in itertools.pairwise(acts))
    # two seconds to start, a second of labels that had not been written, and the moment until its end was noticed
    assert 2 * NS_PER_S < gaps[-1] < 3.5 * NS_PER_S
    assert gaps[-2] < PERIOD_NS + NS_PER_S // 10
    assert acts[-1] < start_ns + 5 * NS_PER_S <= acts[-1] + PERIOD_NS + NS_PER_S // 10
