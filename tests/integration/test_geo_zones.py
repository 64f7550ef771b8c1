"""Attack `ground.geo_zones` in flight: through a closed area, and away from an open one."""

from __future__ import annotations

import pytest

from skyrange.record import RunRecord
from tests.flights import shared_run
from tests.integration.test_signed_flights import notes, outcome

pytestmark = pytest.mark.catalogue

NAME = "ground.geo_zones"


def flown(*changes: str) -> RunRecord:
    return shared_run(NAME, *changes)


def test_an_aircraft_flies_through_an_area_that_its_fence_keeps_it_out_of() -> None:
    held = flown("attacks=[]")
    assert notes(held, "event.fence_breach")
    assert outcome(held)[0] == "failed"
    record = flown()
    assert notes(record, "event.fence_breach") == []
    assert outcome(record) == ("complete", "")
    assert notes(record, "decision.verified"), "the read-back agrees"
    assert notes(record, "event.signature_refused") == notes(record, "decision.signature_refused") == []


def test_an_open_area_is_closed_by_a_zone_that_is_larger_or_elsewhere() -> None:
    away = "operators.blue.vehicles.b1.plan.fence.circles=[{center=[60,50],radius_m=30,inclusion=false}]"
    assert outcome(flown(away, "attacks=[]")) == ("complete", "")
    assert outcome(flown(away, "attacks.zones.params.factor=2"))[0] == "failed"
    moved = 'attacks.zones.params={vehicles=["blue/b1"],form="move",east_m=-40}'
    assert outcome(flown(away, moved))[0] == "failed"
