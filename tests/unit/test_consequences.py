"""Consequences of hostile acts that name no frame: states in force, and silence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from skyrange.metrics.time_series import RecordedNote
from skyrange.twins.consequences import Act, LostReception, Origin, follow

S = 1_000_000_000
V, W = "a/1", "b/1"
BAD = Origin("gcs:a/1|fwd|x|0", 2)


def note(at_s: float, kind: str, about: str = V, **data: Any) -> RecordedNote:
    return RecordedNote(round(at_s * S), kind, about, "engine", data)


Notes = Sequence[tuple[RecordedNote, Mapping[str, Origin]]]


def found(
    notes: Notes,
    acts: Sequence[Act] = (),
    lost: Sequence[LostReception] = (),
) -> list[tuple[float, str, str, str, int]]:
    rows = follow(notes, acts, lost, {"SERIAL": W})
    return [(row.note.time_ns / S, row.note.kind, row.attack, row.way, row.origin.depth) for row in rows]


def test_a_crash_follows_from_the_mode_that_a_hostile_frame_set() -> None:
    notes = [(note(1, "event.mode", mode="LAND", reason="gcs_command"), {"x": BAD}), (note(2, "event.crash"), {})]
    assert found(notes) == [(2.0, "event.crash", "x", "mode", 3)]


def test_a_later_change_by_somebody_else_ends_it() -> None:
    notes = [
        (note(1, "event.mode", mode="LAND", reason="gcs_command"), {"x": BAD}),
        (note(2, "event.mode", mode="AUTO", reason="gcs_command"), {}),
        (note(3, "event.crash"), {}),
    ]
    assert found(notes) == []


def test_several_attacks_are_all_named_and_own_causes_are_not_repeated() -> None:
    notes = [
        (note(1, "event.mission", items=3), {"x": BAD, "y": BAD}),
        (note(2, "event.fence_breach"), {"y": BAD}),
    ]
    assert found(notes) == [(2.0, "event.fence_breach", "x", "mission", 3)]


def test_both_aircraft_of_a_collision_follow_from_what_either_was_made_to_do() -> None:
    notes = [
        (note(1, "decision.avoid", about=f"{V}.companion"), {"x": BAD}),
        (note(2, "event.collision", about=V, **{"with": W}), {}),
        (note(2, "event.collision", about=W, **{"with": V}), {}),
        (note(3, "near_miss", about="c/1", **{"with": W}), {}),
    ]
    assert found(notes) == [(2.0, "event.collision", "x", "target", 3)] * 2


def test_an_estimator_follows_from_falsified_readings_and_not_before() -> None:
    acts = [Act(2 * S, "drift", "sensor", "gnss:a/1|fwd|drift|0", V)]
    notes: Notes = [
        (note(1, "event.glitch", on=True), {}),
        (note(3, "event.glitch", on=True), {}),
        (note(4, "event.mode", mode="LAND", reason="ekf_failsafe"), {}),
        (note(5, "event.crash"), {}),
    ]
    assert found(notes, acts) == [
        (3.0, "event.glitch", "drift", "estimate", 1),
        (4.0, "event.mode", "drift", "estimate", 1),
        (5.0, "event.crash", "drift", "mode", 2),
    ]


@pytest.mark.parametrize(("action", "expected"), [("drop", 3), ("delay", 3), ("inject", 0)])
def test_what_follows_from_dropped_frames(action: str, expected: int) -> None:
    acts = [Act(S, "cut", action, "gcs:a/1|fwd|gcs|7", V)]
    notes: Notes = [
        (note(3, "decision.link_lost", silent_s=2.0), {}),
        (note(4, "event.mode", mode="RTL", reason="gcs_failsafe"), {}),
        (note(5, "decision.link_restored"), {}),
        (note(9, "decision.failed", reason="timeout"), {}),
        (note(9, "event.mode", mode="RTL", reason="gcs_failsafe", about=W), {}),
    ]
    assert len(found(notes, acts)) == expected


def test_an_expired_track_follows_from_the_broadcast_that_was_lost_to_noise() -> None:
    def lost(at_s: float, sender: str) -> LostReception:
        return LostReception(round(at_s * S), "noise", "corner", sender, f"rid_up:{sender}|fwd|r|{at_s:.0f}", "burst")

    losses = [lost(1, W), lost(3, W), lost(4, V), lost(5, W), lost(30, W)]
    gone = note(20, "event.track_lost", about="a", uas_id="SERIAL", last_s=2.0)
    (row,) = follow([(gone, {})], [], losses, {"SERIAL": W})
    assert (row.attack, row.way, row.origin.frame) == ("noise", "silence", "rid_up:b/1|fwd|r|5")
    other = note(20, "event.track_lost", about="a", uas_id="OTHER", last_s=2.0)
    assert list(follow([(other, {})], [], losses, {"SERIAL": W})) == []


def test_a_mission_that_was_completed_follows_from_nothing() -> None:
    before = (note(1, "event.mode", mode="RTL", reason="gcs_command"), {"x": BAD})
    assert found([before, (note(2, "event.outcome", state="complete"), {})]) == []
    assert found([before, (note(2, "event.outcome", state="failed"), {})]) == [(2.0, "event.outcome", "x", "mode", 3)]
