"""What do flights do when the nodes that decide on them cannot reach each other?"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly as fly_scenario

pytestmark = pytest.mark.rotating

OPERATOR = """
[[operators]]
id = "{name}"
approval = "hashgraph"
request_ahead_s = 20
margins = {{ horizontal_m = {margin}, vertical_m = {margin} }}
  [[operators.vehicles]]
  id = "a"
  start = [0, {north}]
  plan = {{ path = {{ points = [[0, 0], [30, 0], [0, 0]], alt_m = 15 }}, speed_mps = 4, end = "land" }}
  depart_s = {depart}
"""
SILENCE = """
[[attacks]]
id = "cut"
kind = "link.drop"
start_s = {start}
params = {{ links = ["uss:*"] }}
"""


def fly(folder: Path, cut_s: float, margin: float = 8.0, late_s: float = 20.0) -> RunRecord:
    """Three flights, of which blue's departs at 20 s and the others at `late_s`; nodes are silent from `cut_s` on."""
    operators = [("blue", 0, 20.0), ("green", 60, late_s), ("red", 120, late_s)]
    text = 'name = "silence"\nduration_s = 88\norigin = [47.3977, 8.5456]\n' + "".join(
        OPERATOR.format(name=name, north=north, depart=depart, margin=margin) for name, north, depart in operators
    )
    return fly_scenario(load_text(text + SILENCE.format(start=cut_s)), folder, report=False)


def reasons(record: RunRecord, vehicle: str) -> list[str]:
    notes = read_notes(record, "decisions")
    return [str(note.data.get("reason")) for note in notes if note.about == vehicle and "reason" in note.data]


def outcome(record: RunRecord, vehicle: str) -> str:
    return str(record.manifest["outcomes"][vehicle]["state"])


def test_who_has_no_decision_stays_on_the_ground_and_who_has_one_flies(tmp_path: Path) -> None:
    record = fly(tmp_path / "run", cut_s=25.0, late_s=60.0)
    assert outcome(record, "blue/a") == "complete"
    assert outcome(record, "green/a") == outcome(record, "red/a") == "failed"
    assert any("approval: no answer" in reason for reason in reasons(record, "green/a"))
    armed = {note.about for note in read_notes(record, "decisions") if note.kind == "decision.armed"}
    assert armed == {"blue/a"}


def leaves_its_volumes(record: RunRecord) -> bool:
    """Whether it flies home because it is outside of them without an answer; that it is outside is noted."""
    notes = read_notes(record, "decisions")
    assert any(note.kind == "decision.intent_nonconforming" and note.about == "blue/a" for note in notes)
    return any("outside its volumes, and approval" in reason for reason in reasons(record, "blue/a"))


def test_outside_its_volumes_and_without_an_answer_an_aircraft_flies_home(tmp_path: Path) -> None:
    record = fly(tmp_path / "run", cut_s=25.0, margin=0.05)
    assert leaves_its_volumes(record)
    assert outcome(record, "blue/a") == "failed"


@pytest.mark.slow
def test_outside_its_volumes_with_an_answer_it_flies_on_and_others_ask_before_they_depart(tmp_path: Path) -> None:
    record = fly(tmp_path / "run", cut_s=87.0, margin=0.05, late_s=60.0)
    assert not leaves_its_volumes(record)
    assert outcome(record, "blue/a") == "complete"
    asked = {
        note.about: note.time_ns / 1e9
        for note in reversed(read_notes(record, "decisions"))
        if note.kind == "decision.approval_requested"
    }
    assert asked == pytest.approx({"blue/a": 0.0, "green/a": 40.0, "red/a": 40.0})
