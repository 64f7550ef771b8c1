"""What the viewer's server answers about records, against the records themselves."""

from __future__ import annotations

import asyncio
from typing import Any

import aiohttp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.mavlink import decode
from skyrange.core.errors import DecodeError, InputError
from skyrange.record import RunRecord
from skyrange.view.frame_texts import MAX_TEXT, describe_payload
from skyrange.view.record_queries import FRAMES_SHOWN, POINTS, RecordQueries
from skyrange.view.server import RecordedStream, make_application, serve
from tests.flights import shared_run
from tests.integration.test_run_batches import ACTS, TEXT

VEHICLE = "blue/b1"


@pytest.fixture(scope="module")
def record() -> RunRecord:
    from skyrange.scenario.toml_files import load_text

    return shared_run(load_text(TEXT + ACTS["link"]))


@pytest.mark.parametrize("until_s", [0.5, 4.75, 8.0, 100.0])
def test_frames_are_the_newest_of_each_direction_of_each_link(record: RunRecord, until_s: float) -> None:
    frames = [frame for frame in record.frames_with_payloads() if frame.link.partition(":")[2] == VEHICLE]
    expected: dict[tuple[str, str], list[float]] = {}
    for frame in sorted(frames, key=lambda frame: frame.sent_ns):
        if frame.sent_ns <= until_s * 1e9:
            expected.setdefault((frame.link, frame.direction), []).append(frame.sent_ns / 1e9)
    told = RecordQueries([record]).read_frames(0, VEHICLE, until_s)["links"]
    found = {(group["link"], group["direction"]): [row["t"] for row in group["frames"]] for group in told}
    assert {key: times for key, times in found.items() if times} == {
        key: [pytest.approx(time, abs=1e-4) for time in reversed(times[-FRAMES_SHOWN:])]
        for key, times in expected.items()
    }


def test_what_is_recorded_of_a_frame_is_told_of_it_and_of_what_forwards_it(record: RunRecord) -> None:
    acts, links = RecordQueries([record])._index_frames(0, VEHICLE)
    labelled = {row["frame"] for row in record.table("labels").to_pylist()}
    ids = {frame.id: frame.parent for frame in record.frames_with_payloads() if frame.link.partition(":")[2] == VEHICLE}
    assert labelled
    for name, parent in ids.items():
        assert (name in acts) == (name in labelled or parent in acts), name
    assert sum(len(one.times_ns) for one in links) == len(ids)


def test_series_are_the_recorded_values(record: RunRecord) -> None:
    queries = RecordQueries([record])
    fields = queries.list_fields(0)
    assert ["up_m", "m"] in fields["truth"]
    assert ["relative_alt", "mm"] in fields["GLOBAL_POSITION_INT"]
    for source, field in (("truth", "up_m"), ("GLOBAL_POSITION_INT", "relative_alt")):
        table = record.table(source) if source == "truth" else record.telemetry(source)
        rows = sorted(
            (row["time_ns"] / 1e9, float(row[field])) for row in table.to_pylist() if row["vehicle"] == VEHICLE
        )
        told = queries.read_series(0, VEHICLE, source, field)
        assert 0 < len(told["t"]) <= 2 * POINTS
        assert {(round(t, 3), v) for t, v in zip(told["t"], told["v"], strict=True)} <= {
            (round(t, 3), v) for t, v in rows
        }
        assert (min(told["v"]), max(told["v"])) == (min(v for _, v in rows), max(v for _, v in rows))


def test_causes_of_a_decision_are_the_recorded_frames(record: RunRecord) -> None:
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    queries, checked = RecordQueries([record]), 0
    for row in record.table("decisions").to_pylist():
        if row["causes"] and checked < 20:
            told = queries.read_causes(0, row["time_ns"] / 1e9, row["kind"], row["about"])["frames"]
            times = {round(frames[name].sent_ns / 1e9, 4) for name in row["causes"]}
            assert times <= {frame["t"] for frame in told}
            checked += 1
    assert checked
    assert queries.read_causes(0, 0.0, "decision.none", "nobody") == {"frames": []}


@given(st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=1, max_size=4 * POINTS))
def test_thinned_series_keep_their_extremes(values: list[float]) -> None:
    from skyrange.view.record_queries import _thin

    times, given_values = np.arange(float(len(values))), np.array(values)
    kept_times, kept = _thin(times, given_values)
    assert len(kept) <= 2 * POINTS + 2
    assert (np.diff(kept_times) > 0).all()
    np.testing.assert_array_equal(given_values[kept_times.astype(int)], kept)
    if not np.isnan(given_values).all():
        assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(given_values), np.nanmax(given_values))


@given(st.binary(max_size=400))
def test_any_bytes_have_a_text(payload: bytes) -> None:
    name, text = describe_payload(payload)
    assert name
    assert len(text) <= MAX_TEXT


def test_texts_name_each_field_of_a_message(record: RunRecord) -> None:
    for frame in list(record.frames_with_payloads())[:200]:
        name, text = describe_payload(frame.payload)
        try:
            message = decode(frame.payload)
        except DecodeError:
            continue
        assert name == message.get_type()
        assert text.startswith(f"{message.fieldnames[0]} ")


@pytest.mark.parametrize(
    ("query", "problem"),
    [
        ("frames?arm=1&vehicle=blue/b1&until=1", "0 to 0"),
        ("frames?arm=-1&vehicle=blue/b1&until=1", "a number of 0 or more"),
        ("frames?arm=0&vehicle=blue/b1&until=nan", "a time in seconds"),
        ("series?arm=0&vehicle=blue/b1&source=truth&field=vehicle", "a number that is recorded"),
        ("series?arm=0&vehicle=blue/b1&source=../truth&field=up_m", "a number that is recorded"),
        ("fields", "a number of 0 or more"),
    ],
)
def test_a_wrong_question_is_answered_with_what_is_wrong(record: RunRecord, query: str, problem: str) -> None:
    async def ask() -> tuple[int, Any]:
        application = make_application(RecordedStream(b""), queries=RecordQueries([record]))
        async with serve(application, "127.0.0.1", 0) as url, aiohttp.ClientSession() as session:
            async with session.get(f"{url}record/fields?arm=0") as response:
                assert response.status == 200
                assert "truth" in await response.json()
            async with session.get(f"{url}record/{query}") as response:
                return response.status, await response.json()

    status, answer = asyncio.run(ask())
    assert status == 400
    assert problem in answer["problem"]


def test_a_record_without_frames_says_so(record: RunRecord) -> None:
    study = RunRecord(
        record.path, record.manifest | {"record": {**record.manifest["record"], "level": "study"}}, record.tables
    )
    with pytest.raises(InputError, match="level that keeps frames"):
        RecordQueries([study]).read_frames(0, VEHICLE, 1.0)
