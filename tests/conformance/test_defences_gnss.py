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
from skyrange.testing import check_defence
from skyrange.testing.checks.attacks import two_squares

JUMP = {"kind": "gnss.jump", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_m": [30, 0, 0]}}
CLIMB = {"kind": "gnss.jump", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_m": [0, 0, 12]}}
TIME = {"kind": "gnss.time", "start_s": 5.0, "params": {"vehicles": ["blue/b1"], "offset_s": 20}}
REJECT = {"action": "reject"}
KINDS: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Collection[str]]] = [
    ("gnss.innovation", {}, JUMP, ()),
    ("gnss.innovation", REJECT, JUMP, ("sensor",)),
    ("gnss.barometer", {}, CLIMB, ()),
    ("gnss.barometer", REJECT, CLIMB, ("sensor",)),
    ("gnss.receiver", {}, TIME, ()),
    ("gnss.receiver", REJECT, TIME, ("sensor",)),
]


@pytest.mark.parametrize(("name", "params", "attack", "acts"), KINDS, ids=[f"{k[0]}-{i}" for i, k in enumerate(KINDS)])
def test_checks_of_gnss_conform(
    name: str, params: Mapping[str, Any], attack: Mapping[str, Any], acts: Collection[str]
) -> None:
    check_defence(name, params, attack, acts=bool(acts) and acts)


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
