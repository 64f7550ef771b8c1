"""Does ArduCopter react to attacks as the builtin does? A few examples of those that the page compares.

`skyrange parity attacks` flies them all.
"""

from __future__ import annotations

import pytest

from skyrange.parity.attacks.flights import ComparedAttack, agreement, compare
from tests.ardupilot import needs_arducopter
from tests.catalogue import in_turn

ALIKE = {
    "link.drop": "stays down",
    "link.duplicate": "obeys",
    "mavlink.command": "crashes",
    "mavlink.guided": "lands",
    "mavlink.parameter": "fails safe",
    "identity.keep_alive": "obeys",
    "identity.silence_station": "fails safe",
    "signing.stolen_key": "obeys",
    "telemetry.mode": "departs",
    "gnss.pull_off": "departs",
    "gnss.jam": "fails safe",
    "gnss.time": "departs",
    "sensor.barometer": "departs",
    "remote_id.spoof": "departs",
}
"""Kinds to which both react in the same way, at the same time, and with the same effect."""
DIFFER = {"mavlink.rc_override": ("obeys", "lands"), "mavlink.mode": ("obeys", "ignores")}
"""The reactions of builtin and ArduCopter where they differ."""
SAME = {"mavlink.mission_clear": "obeys", "mavlink.malformed": "obeys"}
"""Kinds to which both react in the same way, at different times."""


IN_TURN = in_turn("parity", "attacks")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ComparedAttack]:
    rows = compare(tmp_path_factory.mktemp("attacks"), [*ALIKE, *DIFFER, *SAME])
    return {one.kind: one for one in rows}


@IN_TURN
@needs_arducopter
@pytest.mark.parametrize(("kind", "reaction"), ALIKE.items())
def test_both_react_in_the_same_way_and_time(kind: str, reaction: str, compared: dict[str, ComparedAttack]) -> None:
    one = compared[kind]
    assert (one.first.reaction, one.second.reaction) == (reaction, reaction)
    assert one.alike, f"{one.first} against {one.second}"


@IN_TURN
@needs_arducopter
@pytest.mark.parametrize(("kind", "reactions"), DIFFER.items())
def test_the_differences_that_the_page_explains(
    kind: str, reactions: tuple[str, str], compared: dict[str, ComparedAttack]
) -> None:
    one = compared[kind]
    assert (one.first.reaction, one.second.reaction) == reactions


@IN_TURN
@needs_arducopter
def test_an_empty_mission_ends_the_builtins_at_once_and_arducopters_at_its_next_waypoint(
    compared: dict[str, ComparedAttack],
) -> None:
    first, second = compared["mavlink.mission_clear"].first, compared["mavlink.mission_clear"].second
    assert first.reaction == second.reaction == SAME["mavlink.mission_clear"]
    assert first.at_s is not None
    assert second.at_s is not None
    assert first.at_s < 3.0
    assert second.at_s > first.at_s + 5.0


@IN_TURN
@needs_arducopter
def test_most_agree(compared: dict[str, ComparedAttack]) -> None:
    found = agreement(list(compared.values()))
    assert found.kinds == found.effective == len(ALIKE) + len(DIFFER) + len(SAME)
    assert found.same == len(ALIKE) + len(SAME)
    assert found.alike >= len(ALIKE)
