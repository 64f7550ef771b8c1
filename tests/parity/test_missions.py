"""Sixty random missions under both autopilots: 95 % of them agree in items, order, times and path; it takes minutes."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.study.compare.mission_parity import compare
from tests.ardupilot import needs_arducopter
from tests.catalogue import draw


@needs_arducopter
@pytest.mark.slow
@pytest.mark.parametrize("first", draw((0, 20, 40)))
def test_random_missions_are_flown_alike(first: int, tmp_path: Path) -> None:
    found = compare(tmp_path / "missions", 20, first=first, shrink=False)
    strays = [
        f"{one.mission.number} {one.miss}: {one.detail}; {one.mission.words}" for one in found.compared if one.miss
    ]
    assert found.share >= 0.95, strays
    assert not [one for one in found.compared if one.miss == "accepted items"], strays
