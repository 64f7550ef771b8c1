"""What each receiver decoded, field by field: derived after the run, joined with frames, labels and truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.codec import f3411
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.frames import Fate
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.read.observations import FRAME_COLUMNS, read_decoded_receptions
from skyrange.record.read.tables import Tables
from skyrange.record.schema import arrow_schema
from skyrange.record.write.files.derivation import Derivation
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from tests.unit.record_sample import HEADER, MS, make_frame, traffic

ORIGIN = {"lat_deg": 40.778, "lon_deg": -73.955, "alt_msl_m": 20.0, "geoid_m": -32.7}
MAC = bytes.fromhex("d684ffb030b7")


def whole_body() -> bytes:
    """A pack of every message."""
    lat, lon = Origin(40.778, -73.955).geodetic_of(100.0, 50.0)
    return f3411.encode(
        f3411.MessagePack(
            (
                f3411.BasicId(1, 2, "SKYRBLUE1"),
                f3411.BasicId(4, 2, "\x01\x02\x00\x03"),
                f3411.Location(
                    2, lat, lon, 20.0 - 32.7 + 30.0, None, 30.0, 1, 5.25, -1.5, 270.0, 11, 5, 0, 4, 1, 1234.5
                ),
                f3411.Authentication(1, 0, b"a" * 17, 1, 40, 77),
                f3411.Authentication(1, 1, b"b" * 23),
                f3411.SelfId(1, "survey"),
                f3411.System(1, 40.7, -73.9, None, 2, 20.0, 120.0, 0.0, 1, 2, 3, 99),
                f3411.OperatorId(0, "OP-1"),
            )
        )
    )


def up(vehicle: str, serial: int, sent_ns: int, body: bytes, **changes: Any) -> Any:
    payload = link_payload.pack(RidHeader(Transport.WIFI_BEACON, 6, serial & 255, MAC, time_ns=sent_ns), body)
    return make_frame(f"rid_up:{vehicle}", "fwd", f"{vehicle}.companion", serial, sent_ns, payload, **changes)


def receptions(rows: Sequence[dict[str, Any]]) -> pa.RecordBatch:
    usual = {
        "direction": "fwd", "east_m": 1.5, "north_m": 2.5, "up_m": 4.0, "transport": "wifi_beacon", "channel": 6,
        "rssi_dbm": -71.25, "snir_db": 20.0, "outcome": "decoded",
    }  # fmt: skip
    schema = arrow_schema("receptions")
    told = [{**usual, "sender": row["link"].removeprefix("rid_up:") + ".companion", **row} for row in rows]
    return pa.RecordBatch.from_pylist(told, schema=schema)


def recorded(path: Path, frames: Sequence[Any], rows: Sequence[dict[str, Any]], ending: str) -> RunRecord:
    recorder = Recorder.open(path, {**HEADER, "origin": ORIGIN})
    for frame in frames:
        recorder.on_frame(frame)
    recorder.flush()
    if rows:
        recorder.on_rows("receptions", receptions(rows))
    if ending == "closed":
        recorder.close()
    else:
        recorder.flush()
    return load(path)


@pytest.mark.parametrize("ending", ["closed", "killed"])
def test_every_field_is_there(tmp_path: Path, ending: str) -> None:
    frames = [*traffic(3), up("blue/b1", 7, 400 * MS, whole_body())]
    rows = [
        {"time_ns": 420 * MS, "link": "rid_up:blue/b1", "serial": 7, "receiver": "mast"},
        {"time_ns": 421 * MS, "link": "rid_up:blue/b1", "serial": 7, "receiver": "green/g1", "outcome": "weak"},
    ]
    run = recorded(tmp_path / "run", frames, rows, ending)
    table = run.table("observations")
    assert table.schema.names == arrow_schema("observations").names
    assert (tmp_path / "run" / "observations.parquet").exists() == (ending == "closed")
    [seen] = table.to_pylist()
    east, north = seen.pop("east_m"), seen.pop("north_m")
    assert (east, north) == (pytest.approx(100.0, abs=0.02), pytest.approx(50.0, abs=0.02))
    lat, lon = seen.pop("lat_deg"), seen.pop("lon_deg")
    assert Origin(40.778, -73.955).enu_of(lat, lon) == pytest.approx((east, north))
    assert seen == {
        "time_ns": 420 * MS, "receiver": "mast", "receiver_east_m": 1.5, "receiver_north_m": 2.5, "receiver_up_m": 4.0,
        "transport": "wifi_beacon", "channel": 6, "rssi_dbm": -71.25,
        "frame": "rid_up:blue/b1|fwd|blue/b1.companion|7", "radio": "blue/b1",
        "mac": "d6:84:ff:b0:30:b7", "counter": 7, "valid": True, "version": 2,
        "messages": "basic_id basic_id location authentication authentication self_id system operator_id",
        "uas_id": "SKYRBLUE1", "id_type": 1, "ua_type": 2, "second_uas_id": "session:01020003", "second_id_type": 4,
        "status": 2, "alt_geo_m": 17.5, "alt_baro_m": None, "height_m": 30.0, "height_type": 1,
        "up_m": pytest.approx(30.2),
        "speed_mps": 5.25, "vertical_mps": -1.5, "track_deg": 270.0, "timestamp_s": 1234.5, "timestamp_accuracy": 1,
        "timestamp_age_s": None,
        "horizontal_accuracy": 11, "vertical_accuracy": 5, "baro_accuracy": 0, "speed_accuracy": 4,
        "operator_lat_deg": 40.7, "operator_lon_deg": -73.9, "operator_alt_geo_m": None, "operator_location_type": 1,
        "area_count": 2, "area_radius_m": 20.0, "area_ceiling_m": 120.0, "area_floor_m": 0.0, "classification": 1,
        "category": 2, "ua_class": 3, "system_timestamp_s": 99, "operator_id": "OP-1", "operator_id_type": 0,
        "self_id": "survey", "description_type": 1, "auth_type": 1, "auth_page": 0, "auth_last_page": 1,
        "auth_length": 40, "auth_timestamp_s": 77, "auth_data": b"a" * 17 + b"b" * 23,
    }  # fmt: skip


def test_what_is_no_message_is_a_row_without_fields(tmp_path: Path) -> None:
    frames = [up("blue/b1", 0, 100 * MS, b"\xff" * 30)]
    rows = [
        {"time_ns": 150 * MS, "link": "rid_up:blue/b1", "serial": 0, "receiver": "mast"},
        {"time_ns": 160 * MS, "link": "rid_up:blue/b1", "serial": 1, "receiver": "mast"},
    ]
    broken, missing = recorded(tmp_path / "run", frames, rows, "closed").table("observations").to_pylist()
    assert (broken["valid"], broken["mac"], broken["messages"]) == (False, "d6:84:ff:b0:30:b7", None)
    assert (missing["valid"], missing["mac"], missing["frame"]) == (
        None,
        None,
        "rid_up:blue/b1|fwd|blue/b1.companion|1",
    )
    assert broken["uas_id"] is missing["uas_id"] is broken["lat_deg"] is None


def test_a_run_without_receptions_has_no_file_and_reads_no_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = recorded(tmp_path / "run", list(traffic(3)), [], "closed")
    monkeypatch.setattr(Tables, "frames_with_payloads", lambda *_, **__: pytest.fail("frames were read"))
    assert not (tmp_path / "run" / "observations.parquet").exists()
    assert "observations" not in run.manifest["counts"]
    assert run.table("observations").num_rows == run.rows("observations") == 0


def test_a_frame_that_was_held_back_is_found_and_memory_is_bounded(tmp_path: Path) -> None:
    """One frame reaches the medium 30 s after it was sent; frames older than a minute are not kept."""
    held = up("red/r1", 0, 2 * NS_PER_S, whole_body(), arrived_ns=32 * NS_PER_S)
    frames = []
    for second in range(200):
        frames.append(up("blue/b1", second, second * NS_PER_S, whole_body()))
        if second == 32:
            frames.append(held)
    frames.append(up("blue/b2", 0, 500 * NS_PER_S, whole_body(), fate=Fate.IN_FLIGHT))
    rows = [
        {"time_ns": (second * 1000 + 40) * MS, "link": "rid_up:blue/b1", "serial": second, "receiver": "mast"}
        for second in range(200)
    ]
    rows.insert(33, {"time_ns": 32_050 * MS, "link": "rid_up:red/r1", "serial": 0, "receiver": "mast"})
    run = recorded(tmp_path / "run", frames, rows, "closed")
    table = run.table("observations", ["radio", "mac", "time_ns"])
    assert table.column("mac").null_count == 0
    assert table.column("radio").to_pylist().count("red/r1") == 1
    found = list(read_decoded_receptions(run.tables, ["mast"], batch_rows=1))
    assert sum(part.rows.num_rows for part in found) == 201
    assert list(read_decoded_receptions(run.tables, ["nobody"])) == []


@pytest.mark.parametrize(
    ("minute", "second", "told_s", "age_s"),
    [(20, 34, 1234.4, 0.1), (20, 14, 1234.5, -20.0), (0, 10, 3595.5, 15.0), (59, 50, 2.5, -12.0), (0, 0, None, None)],
)
def test_the_age_of_a_claimed_position_is_that_in_the_nearest_hour(
    tmp_path: Path, minute: int, second: int, told_s: float | None, age_s: float | None
) -> None:
    header = {**HEADER, "origin": ORIGIN, "start_unix_ns": (1_767_268_800 + 60 * minute + second) * NS_PER_S}
    recorder = Recorder.open(tmp_path / "run", header)
    recorder.on_frame(up("blue/b1", 7, 400 * MS, f3411.encode(f3411.Location(2, 40.0, -73.0, timestamp_s=told_s))))
    recorder.flush()
    row = {"time_ns": 500 * MS, "link": "rid_up:blue/b1", "serial": 7, "receiver": "mast"}
    recorder.on_rows("receptions", receptions([row]))
    recorder.close()
    [seen] = load(tmp_path / "run").table("observations").to_pylist()
    assert seen["timestamp_age_s"] == (age_s if age_s is None else pytest.approx(age_s))


def test_frames_that_another_process_recorded_long_before_are_found(tmp_path: Path) -> None:
    """The rows of a minute and more come at once: no frame that they name is dropped before they are joined."""

    def encoded(frames: Sequence[Any]) -> tuple[pa.Table, pa.RecordBatch]:
        encoder = FrameEncoder(1 << 20)
        gathered = encoder.gather(frames)
        return pa.Table.from_batches([encoder.table(gathered)]), encoder.take_payloads()

    foreign = []
    for second in (1, 2, 100):
        frames, payloads = encoded([up("b/b1", second, second * NS_PER_S, whole_body())])
        bodies = payloads.column("payload")
        foreign.append(frames.select(list(FRAME_COLUMNS)).append_column("payload", pa.chunked_array([bodies])))
    frames, payloads = encoded([up("a/a1", n, n * NS_PER_S, whole_body()) for n in range(200)])
    named = {"link": "rid_up:b/b1", "receiver": "a/a1"}
    rows = receptions([{**named, "serial": n, "time_ns": n * NS_PER_S + MS} for n in (1, 2, 100)])
    (tmp_path / ".spool").mkdir()
    derivation = Derivation(tmp_path, Origin(40.778, -73.955), None)
    derivation.add(frames, [payloads], [rows], foreign)
    derivation._observations.finish()
    found = pq.read_table(derivation.observations_file)
    assert found.column("mac").to_pylist() == [MAC.hex(":")] * 3
