"""Two runs that tell the same at slightly other times agree; what is late, missing or extra is named."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.cli import main
from skyrange.contracts.mailboxes import Note
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.metrics.agreement import Agreement, agreement
from skyrange.record import Recorder
from tests.unit.record_sample import StillWorld

HEADER = {
    "name": "twice",
    "seed": 1,
    "start_utc": "2026-01-01T12:00:00Z",
    "operators": [{"id": "blue"}],
    "vehicles": [{"id": "blue/b1", "operator": "blue"}],
    "links": [],
}
STORY: Sequence[tuple[float, str, dict[str, Any]]] = (
    (1.0, "event.takeoff", {}),
    (2.0, "decision.progress", {"item": 1, "height_m": 3.25}),
    (3.0, "decision.progress", {"item": 2, "height_m": 3.5}),
    (4.0, "event.mode", {"mode": "LAND"}),
    (5.0, "event.outcome", {"state": "complete", "reason": ""}),
)


class Passing(StillWorld):
    """One aircraft that flies east at 1 m/s, `late_s` behind and `aside_m` north of where it should be."""

    def __init__(self, late_s: float, aside_m: float) -> None:
        super().__init__(["blue/b1"])
        self.now_s = 0.0
        self._late_s = late_s
        self._aside_m = aside_m

    def truth(self) -> Any:
        truth = dict(super().truth())
        truth["east_m"], truth["north_m"] = np.array([self.now_s - self._late_s]), np.array([self._aside_m])
        return truth


def run(folder: Path, story: Any = STORY, late_s: float = 0.0, aside_m: float = 0.0, until_s: float = 10.0) -> Path:
    recorder = Recorder.open(folder, HEADER)
    world = Passing(late_s, aside_m)
    for tick in range(round(until_s * 10) + 1):
        world.now_s = tick / 10
        recorder.on_truth(round(world.now_s * NS_PER_S), world)
    for at_s, kind, data in story:
        recorder.on_note(round(at_s * NS_PER_S), "blue.gcs", Note(kind, "blue/b1", data))
    recorder.close(extra={"simulated_s": until_s})
    return folder


def against(folder: Path, story: Any, tolerance_s: float = 0.2, **how: float) -> Agreement:
    return agreement(run(folder / "a"), run(folder / "b", story, **how), tolerance_s)


def test_later_by_less_than_the_tolerance_and_otherwise_measured_is_the_same(tmp_path: Path) -> None:
    later = [(at + 0.15, kind, data | ({"height_m": 9.0} if "height_m" in data else {})) for at, kind, data in STORY]
    found = against(tmp_path, later, late_s=0.15)
    assert found.agree
    assert found.kinds["decision.progress"].found == 2
    assert found.kinds["decision.progress"].least_s == pytest.approx(-0.15)
    assert found.kinds["decision.progress"].median_s == pytest.approx(0.15)
    assert found.ways["blue/b1"].apart_m == pytest.approx(0.15)
    assert found.ways["blue/b1"].off_m == pytest.approx(0.0, abs=1e-6)
    assert "agree within 0.2 s until 10 s" in str(found)


def test_what_came_too_late_is_named_with_both_times(tmp_path: Path) -> None:
    found = against(tmp_path, [(4.5, *rest) if at == 4.0 else (at, *rest) for at, *rest in STORY])
    assert not found.agree
    assert [(odd.kind, odd.a_s, odd.b_s) for odd in found.odd] == [("event.mode", 4.0, 4.5)]
    assert 'blue/b1: event.mode {"mode": "LAND"}: at 4.000 s | 4.500 s' in str(found)


def test_what_only_one_has_is_named(tmp_path: Path) -> None:
    found = against(tmp_path, [*[one for one in STORY if one[0] != 2.0], (2.0, "decision.progress", {"item": 7})])
    assert [(json.loads(odd.details).get("item"), odd.a_s, odd.b_s) for odd in found.odd] == [
        (1, 2.0, None),
        (7, None, 2.0),
    ]
    assert "only in a, at 2.000 s" in str(found)
    assert "only in b, at 2.000 s" in str(found)


def test_an_extra_one_of_many_alike_is_the_one_without_a_neighbour(tmp_path: Path) -> None:
    beats: list[Any] = [(float(at), "event.beat", {}) for at in range(1, 8)]
    found = agreement(run(tmp_path / "a", [*beats, (3.5, "event.beat", {})]), run(tmp_path / "b", beats), 0.2)
    assert [(odd.a_s, odd.b_s) for odd in found.odd] == [(3.5, None)]


def test_one_more_at_the_start_does_not_make_all_that_follow_odd(tmp_path: Path) -> None:
    seen: list[Any] = [(float(n), "event.track_seen", {"uas_id": f"U{n}", "count": n}) for n in range(1, 6)]
    later = [(at, kind, {**data, "count": data["count"] - 1}) for at, kind, data in seen[1:]]
    found = agreement(run(tmp_path / "a", seen), run(tmp_path / "b", later), 0.2)
    assert [json.loads(odd.details)["uas_id"] for odd in found.odd] == ["U1"]


def test_another_outcome_is_told_whenever_it_came(tmp_path: Path) -> None:
    found = against(tmp_path, [*STORY[:4], (5.0, "event.outcome", {"state": "failed", "reason": "crash"})])
    mine, other = found.outcomes["blue/b1"]
    assert (mine["state"], other["state"]) == ("complete", "failed")
    assert "outcome of blue/b1: complete | failed crash" in str(found)


def test_what_comes_after_the_shorter_one_ended_does_not_count(tmp_path: Path) -> None:
    found = against(tmp_path, STORY[:3], until_s=4.1)  # the mode at 4.0 s may come within the tolerance
    assert found.agree
    assert found.until_s == 4.1


def test_a_way_beside_the_others_is_measured(tmp_path: Path) -> None:
    found = against(tmp_path, STORY, late_s=0.1, aside_m=2.0)
    assert found.ways["blue/b1"].off_m == pytest.approx(2.0)
    assert found.ways["blue/b1"].apart_m == pytest.approx((2.0**2 + 0.1**2) ** 0.5)


def test_the_command_says_it_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = run(tmp_path / "a"), run(tmp_path / "b", STORY[:4])
    monkeypatch.setattr("sys.argv", ["skyrange", "diff", str(a), str(b), "--tolerance", "0.2", "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["agree"], said["odd"][0]["kind"]) == (False, "event.outcome")
    assert said["outcomes"]["blue/b1"][1]["state"] == "unfinished"


@pytest.mark.parametrize("tolerance_s", [0.0, -1.0, float("nan"), 1e9])
def test_a_tolerance_has_to_be_a_time(tmp_path: Path, tolerance_s: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        agreement(run(tmp_path / "a"), tmp_path / "a", tolerance_s)
