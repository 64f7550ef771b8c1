"""Does a campaign keep the contract of attacks, and does it go through its stages by what it observes?"""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from skyrange.assembly.build import build
from skyrange.attack.campaign import Campaign
from skyrange.core.errors import InputError
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text
from skyrange.testing import check_attack

pytestmark = pytest.mark.rotating

GHOST = {"kind": "remote_id.spoof", "params": {"at": [10.0, 5.0, 20.0]}}
JUMP = {"kind": "gnss.jump", "params": {"vehicles": ["blue/b1"], "offset_m": [20.0, 0.0, 0.0]}}
ARMED: dict[str, Any] = {
    "acts": {"ghost": GHOST, "jump": JUMP},
    "taps": ["gcs:blue/b1"],
    "stages": [
        {"name": "watch", "until": {"messages": ["GLOBAL_POSITION_INT"]}, "timeout_s": 5.0},
        {"name": "deceive", "acts": ["ghost"], "until": {"after_s": 1.0}},
        {"name": "pull", "acts": ["ghost", "jump"], "timeout_s": 1.5},
    ],
}

AGAIN = {"name": "again", "acts": ["jump"], "timeout_s": 1.0}
PATIENT = {"after_s": 1.0, "messages": ["GLOBAL_POSITION_INT"]}
BLIND = {"name": "a", "acts": ["ghost", "jump"], "until": {"broadcasts": 1}, "timeout_s": 1.0}


@pytest.mark.catalogue
def test_a_campaign_conforms() -> None:
    check_attack(Campaign.plugin, ARMED, acts={"send", "sensor"})


def test_a_campaign_that_sees_nothing_does_nothing() -> None:
    stages = [
        {"name": "watch", "until": {"messages": ["SCALED_PRESSURE3"]}, "timeout_s": 2.0, "then": "end"},
        {"name": "act", "acts": ["ghost"], "timeout_s": 1.0},
    ]
    check_attack(Campaign.plugin, {"acts": {"ghost": GHOST}, "taps": ["gcs:blue/b1"], "stages": stages}, acts=False)


SCENARIO = """
name = "campaign"
seed = 4
duration_s = 40
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 20, alt_m = 10 }
[[attacks]]
id = "mallory"
kind = "campaign"
start_s = 1
[attacks.params]
taps = ["gcs:blue/b1"]
acts.jump = { kind = "gnss.jump", params = { vehicles = ["blue/b1"], offset_m = [20, 0, 0] } }
stages = [
  { name = "watch", until = { sighting = { vehicle = "blue/b1", place = [0, 20, 10], within_m = 5 } }, timeout_s = 35 },
  { name = "pull", acts = ["jump"], timeout_s = 3 },
]
"""


def test_it_acts_when_the_aircraft_is_where_telemetry_says() -> None:
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(SCENARIO)).wiring, [seen])
    kernel.advance(40_000_000_000)
    kernel.finish()
    stages = [
        (note.time_ns, note.note.data["stage"]) for note in seen.notes if note.note.kind == "event.campaign_stage"
    ]
    assert {note.note.about for note in seen.notes if note.note.kind == "event.campaign_stage"} == {"mallory"}
    assert [stage for _, stage in stages] == ["watch", "pull", "end"]
    began, ended = stages[1][0], stages[2][0]
    assert ended - began == pytest.approx(3e9, abs=60_000_000)
    tick = max((one for one in seen.truth if one.time_ns <= began), key=lambda one: one.time_ns)
    place = [float(tick.columns[name][0]) for name in ("east_m", "north_m", "up_m")]
    assert place == pytest.approx([0.0, 20.0, 10.0], abs=6.5)
    assert {label.action for label in seen.labels} == {"sensor"}
    assert all(began <= label.at_ns <= ended + 10_000_000 for label in seen.labels)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"stages": [{"name": "watch", "acts": ["ghost", "jump"]}]}, "longest duration"),
        ({"stages": [{"name": "watch", "acts": ["ghost", "jump"], "until": PATIENT}]}, "longest duration"),
        ({"stages": [{"name": "a", "acts": ["ghots", "jump", "ghost"], "timeout_s": 1.0}]}, "ghost"),
        ({"stages": [{"name": "a", "acts": ["ghost"], "timeout_s": 1.0}]}, "in no stage"),
        ({"stages": [BLIND]}, "receiver_m"),
        ({"stages": [*ARMED["stages"], {"name": "wait", "timeout_s": 1.0}, AGAIN]}, "starts again"),
        ({"taps": []}, "taps, on which"),
        ({"acts": {}, "stages": [{"name": "a", "timeout_s": 1.0}]}, "one act or more"),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused(change: dict[str, Any], where: str) -> None:
    with pytest.raises(ValidationError, match=where):
        Campaign.params_model.model_validate(ARMED | change)


@pytest.mark.parametrize(
    ("act", "where"),
    [
        ({"kind": "gnss.jmup"}, "gnss.jump"),
        ({"kind": "campaign"}, "no campaign"),
        ({"kind": "gnss.jump", "params": {"vehicles": ["blue/b9"], "offset_m": [1, 0, 0]}}, "blue/b1"),
        ({"kind": "gnss.jump", "params": {"vehicles": ["blue/b1"]}}, "offset_m"),
    ],
)
def test_wrong_acts_are_refused_before_the_run(act: dict[str, Any], where: str) -> None:
    scenario = load_text(SCENARIO)
    (attack,) = scenario.attacks
    params = attack.params | {"acts": {"jump": act}}
    changed = scenario.model_copy(update={"attacks": (attack.model_copy(update={"params": params}),)})
    with pytest.raises(InputError, match=where):
        build(changed)
