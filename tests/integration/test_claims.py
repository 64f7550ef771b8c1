"""Are claims read from a record as they were made, and shown in its report?"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import skyrange
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.metrics.approvals import Claim, inside_share, is_tracked, read_claims, shown_prisms
from skyrange.metrics.time_series import truth_tracks
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.utm.intent_states import IntentState
from skyrange.view.inline import STREAM_ID
from skyrange.view.stream.messages import decode_file

pytestmark = pytest.mark.rotating


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return skyrange.run(load("approval.false_details"), tmp_path_factory.mktemp("claims") / "run")


def test_a_flight_claims_is_activated_and_ends(record: RunRecord) -> None:
    claims = read_claims(record)
    assert set(claims) == {"blue/b1", "green/g1"}
    for own in claims.values():
        assert [claim.state for claim in own] == [IntentState.ACCEPTED, IntentState.ACTIVATED]
        assert own[0].until_ns == own[1].from_ns
        assert own[1].until_ns < NEVER, "it was ended"
        assert is_tracked(own)
    depart_ns = 20 * NS_PER_S
    first = claims["blue/b1"][0].volumes[0]
    assert first.start_ns <= depart_ns <= first.end_ns
    assert abs(first.ring_m.mean(axis=0)).max() < 1.0, "it begins where the aircraft stands"


def test_an_aircraft_that_keeps_to_its_volumes_was_inside_all_the_time(record: RunRecord) -> None:
    tracks, claims = truth_tracks(record), read_claims(record)
    for vehicle, own in claims.items():
        share = inside_share(own, tracks[vehicle])
        assert share is not None
        assert share > 0.99
    assert inside_share(claims["blue/b1"], tracks["green/g1"]) < 0.9  # type: ignore[operator]
    assert inside_share([], tracks["blue/b1"]) is None
    outside = [Claim("blue/b1", IntentState.NONCONFORMING, 0, NEVER, claims["blue/b1"][0].volumes)]
    assert inside_share(outside, tracks["blue/b1"]) == 0.0


def shown_scene(page: str) -> Mapping[str, Any]:
    """The scene of the stream in a report."""
    data = re.search(rf'id="{STREAM_ID}"[^>]*>([^<]*)<', page)
    assert data is not None
    scene, *_ = decode_file(base64.b64decode(data[1]))
    return scene.head


def test_the_report_has_a_row_for_each_flight_and_the_volumes_at_their_times(record: RunRecord) -> None:
    page = (record.path / "report.html").read_text()
    assert 'id="airspace"' in page
    scene = shown_scene(page)
    shown = shown_prisms(read_claims(record), round(scene["end_s"] * NS_PER_S))
    assert len(scene["volumes"]) == len(shown) > 5
    assert all(one["from_s"] < one["until_s"] <= scene["end_s"] + 0.1 for one in scene["volumes"])


def test_where_everything_is_approved_at_once_there_is_no_section(tmp_path: Path) -> None:
    run = skyrange.run(load("squares", ["duration_s=3"]), tmp_path / "run")
    assert 'id="airspace"' not in (run.path / "report.html").read_text()


def test_the_scene_shows_constraints_from_their_publication_on(tmp_path: Path) -> None:
    constraint = 'constraints=[{id="fire", corners_m=[[0, 0], [9, 0], [9, 9]], upper_m=50, published_s=2}]'
    run = skyrange.run(load("squares", ["duration_s=3", constraint]), tmp_path / "run")
    (shown,) = shown_scene((run.path / "report.html").read_text())["volumes"]
    assert (shown["name"], shown["from_s"], shown["until_s"]) == ("fire", 2.0, 3.0)
    assert (shown["lower_m"], shown["upper_m"], shown["ring"]) == (0.0, 50.0, [[0, 0], [9, 0], [9, 9]])
