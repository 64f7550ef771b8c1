"""gnss-drift: truth goes astray while belief, and what is broadcast of it, stays on the line; twins and page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.codec.f3411 import Location, MessagePack, decode
from skyrange.codec.remote_id import link_payload
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import Track, belief_tracks, truth_tracks
from skyrange.record import RunRecord
from skyrange.report.pair import belief
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from tests.flights import shared_pair, shared_run

pytestmark = pytest.mark.slow

ME = "blue/b1"
ONSET_NS = 25 * NS_PER_S
BEFORE_THE_WALL_NS = 60 * NS_PER_S


@pytest.fixture(scope="module")
def attacked() -> RunRecord:
    return shared_run("gnss-drift")


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    """The muted run, a little longer than what is compared."""
    changes = ["duration_s=61", "attacks.pull.muted=true"]
    return fly(load("gnss-drift", changes), tmp_path_factory.mktemp("gnss") / "nominal", report=False)


def rows(run: RunRecord, table: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = run.table(table).to_pylist()
    return found


def east_m(track: Track, time_ns: int) -> float:
    return float(track.at(np.array([time_ns]))[0, 0])


def test_twins_are_the_same_to_the_byte_until_the_onset_and_the_sham_throughout(
    attacked: RunRecord, nominal: RunRecord, tmp_path: Path
) -> None:
    short = ["duration_s=35", "attacks.pull.sham=true"]
    sham = fly(load("gnss-drift", short), tmp_path / "sham", report=False)
    for name, time in (("truth", "time_ns"), ("frames", "sent_ns")):
        first, twin = (
            sorted((row for row in rows(run, name) if row[time] < ONSET_NS), key=str) for run in (attacked, nominal)
        )
        if name == "frames":  # fates may be met later
            first, twin = ([row for row in each if row["fate"] == "delivered"] for each in (first, twin))
        assert first == twin, name
    end_ns = 35 * NS_PER_S
    assert rows(sham, "truth") == [row for row in rows(nominal, "truth") if row["time_ns"] <= end_ns]
    acts = [row["frame"] for row in rows(attacked, "labels") if row["at_ns"] < end_ns]
    assert [row["frame"] for row in rows(sham, "labels") if row["at_ns"] < end_ns] == acts
    assert rows(attacked, "truth")[: len(rows(nominal, "truth"))] != rows(nominal, "truth")


def test_the_aircraft_leaves_its_line_and_believes_to_keep_it(attacked: RunRecord, nominal: RunRecord) -> None:
    # 0.5 m/s for 35 s; GNSS wanders by 1.3 m and the aircraft lags a little
    assert east_m(truth_tracks(attacked)[ME], BEFORE_THE_WALL_NS) == pytest.approx(-17.5, abs=4.0)
    assert east_m(belief_tracks(attacked)[ME], BEFORE_THE_WALL_NS) == pytest.approx(0.0, abs=1.5)
    assert east_m(truth_tracks(nominal)[ME], BEFORE_THE_WALL_NS) == pytest.approx(0.0, abs=3.0)
    events = rows(attacked, "events")
    assert any(row["kind"] == "event.collision" and row["about"] == ME for row in events)
    assert not [row for row in events if row["kind"] in ("event.glitch", "event.estimator")]
    worst = {name: ratios.max() for name, (_, ratios) in belief.innovations(attacked, [ME]).items()}
    assert worst[ME] < 0.5, "no innovation comes near its gate"
    assert rows(nominal, "labels") == []


def test_what_it_broadcasts_is_what_it_believes(attacked: RunRecord) -> None:
    declared = attacked.manifest["origin"]
    origin = Origin(declared["lat_deg"], declared["lon_deg"])
    truth = truth_tracks(attacked)[ME]
    said = []
    for frame in attacked.frames_with_payloads():
        if frame.link != f"rid_up:{ME}" or not ONSET_NS + 30 * NS_PER_S < frame.sent_ns < BEFORE_THE_WALL_NS:
            continue
        message = decode(link_payload.unpack(frame.payload)[1])
        parts = message.messages if isinstance(message, MessagePack) else [message]
        said += [
            (origin.enu_of(part.lat_deg, part.lon_deg)[0], east_m(truth, frame.sent_ns))
            for part in parts
            if isinstance(part, Location) and part.lat_deg is not None and part.lon_deg is not None
        ]
    assert said
    for claimed_m, true_m in said:
        assert abs(claimed_m) < 1.5
        assert true_m < -11.0


@pytest.mark.slow
def test_the_page_shows_belief_beside_truth() -> None:
    page = shared_pair("gnss-drift").report.read_text(encoding="utf-8")
    section = re.search(r'<section id="belief">.*?</section>', page, re.DOTALL)
    assert section is not None
    assert section[0].count("<svg") == 2
    assert "The estimators recorded no event" in section[0]
    assert "where it believes to be" in page
    assert "alters gnss" in page


def test_a_pair_without_false_sensors_has_no_such_section() -> None:
    page = shared_pair("chain").report.read_text(encoding="utf-8")
    assert 'id="belief"' not in page
