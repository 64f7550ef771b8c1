"""Do the plausibility checks of GNSS keep their contract, alone and two on one aircraft?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.assembly.build import build
from skyrange.core.time import from_seconds
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.model.attacks import AttackTable
from skyrange.scenario.model.defences import DefenceTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.testing import check_defence
from skyrange.testing.checks.attacks import two_squares

pytestmark = pytest.mark.rotating

JUMP = {"kind": "gnss.jump", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_m": [30, 0, 0]}}
CLIMB = {"kind": "gnss.jump", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_m": [0, 0, 12]}}
TIME = {"kind": "gnss.time", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_s": 20}}
REJECT = {"action": "reject"}
KINDS: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Collection[str]]] = [
    ("gnss.innovation", {}, JUMP, ()),
    ("gnss.innovation", REJECT, JUMP, ("sensor",)),
    ("gnss.barometer", {}, CLIMB, ()),
    ("gnss.barometer", REJECT, CLIMB, ("sensor",)),
    ("gnss.integrity", {"detection": 1}, JUMP, ()),
    ("gnss.integrity", {**REJECT, "detection": 1}, TIME, ("sensor",)),
    ("gnss.receiver", {}, TIME, ()),
    ("gnss.receiver", REJECT, TIME, ("sensor",)),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("name", "params", "attack", "acts"), KINDS, ids=[f"{k[0]}-{i}" for i, k in enumerate(KINDS)])
def test_checks_of_gnss_conform(
    name: str, params: Mapping[str, Any], attack: Mapping[str, Any], acts: Collection[str]
) -> None:
    check_defence(name, params, attack, acts=bool(acts) and acts)


def pair_of_one_operator(duration_s: float) -> Scenario:
    return load_text(f"""
name = "pair"
seed = 4
duration_s = {duration_s}
origin = [47.3977, 8.5456]
[[operators]]
id = "blue"
vehicles = [
  {{ id = "b1", plan = {{ square = {{ side_m = 20, alt_m = 10 }} }} }},
  {{ id = "b2", start = [60, 0], plan = {{ square = {{ side_m = 20, alt_m = 10 }} }} }},
]
""")


@pytest.mark.catalogue
@pytest.mark.parametrize("action", ["alarm", "land"])
def test_the_comparison_of_receivers_conforms(action: str) -> None:
    spoofer = {"transmitter_m": [30, -40, 2], "at": [30, 30, 10], "reacquire_s": 1.0}
    attack = {"kind": "gnss.capture", "start_s": 8.0, "params": spoofer}
    check_defence(
        "gnss.multi_receiver", {"action": action}, attack, scenario=pair_of_one_operator, duration_s=17.0, acts=False
    )


def test_two_checks_on_one_aircraft_both_act() -> None:
    attack = {**JUMP, "params": {"vehicles": ["blue/b1"], "offset_m": [30, 0, 20]}}
    scenario = two_squares(9.0).model_copy(
        update={
            "attacks": (AttackTable.model_validate({"id": "foe", **attack}),),
            "defences": tuple(
                DefenceTable(id=one, kind=f"gnss.{one}", params=REJECT) for one in ("barometer", "innovation")
            ),
        }
    )
    seen = MemoryObserver()
    kernel = Kernel(build(scenario).wiring, [seen])
    kernel.advance(from_seconds(9.0))
    kernel.finish()
    first = {alert.detector: alert.time_ns for alert in reversed(seen.alerts)}
    acts = [str(note.note.about) for note in seen.notes if note.note.kind == "event.defence_act"]
    assert set(first) == {"barometer"}, "the first check has taken the fix away before the second sees it"
    assert len(acts) == 1
