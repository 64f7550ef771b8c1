"""What of a run goes into a capture: order, choice of receivers, memory, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from skyrange.codec import capture
from skyrange.codec.capture import SocketAddress
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.export import packet_captures
from skyrange.export.packet_captures import received_broadcasts as heard_in
from skyrange.export.packet_captures import receivers_of, select_receivers
from skyrange.record import RunRecord, load
from skyrange.record.schema import arrow_schema

LINKS = ["gcs:a/1", "rid_up:a/1", "rid_down:a/1", "rid_up:b/1", "rid_down:b/1", "oracle:a"]
MANIFEST = {
    "format": "skyrange.run/1", "status": "complete", "start_unix_ns": NS_PER_S,
    "record": {"level": "full", "features_hz": 1.0},
    "operators": [{"id": "a"}, {"id": "b"}],
    "vehicles": [{"id": "a/1", "operator": "a"}, {"id": "b/1", "operator": "b"}],
    "links": [{"name": name} for name in LINKS], "receivers": [{"id": "mast", "operator": "a"}],
}  # fmt: skip


Row = tuple[str, int, str, int]
"""Receiver, end of the reception in ns, the radio that sent, the serial number of its frame."""


def with_encoded_links(frames: pa.Table) -> pa.Table:
    """Frames as a record has them for its readers: names of links as dictionaries."""
    place = frames.column_names.index("link")
    return frames.set_column(place, "link", frames.column("link").dictionary_encode())


class Tables:
    """Receptions in batches, counted as they are read, and the frames that they name: one per radio and serial."""

    def __init__(self, batches: Sequence[list[Row]], payload: bytes | None) -> None:
        self._batches = batches
        self._payload = payload
        self.read = 0

    def batches(self, name: str, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
        assert name == "receptions"
        usual = {"direction": "fwd", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "transport": "wifi_beacon"}
        usual |= {"channel": 11, "rssi_dbm": -70.125}
        for batch in self._batches:
            self.read += 1
            rows = [
                {
                    **usual, "time_ns": at_ns, "link": f"rid_up:{radio}", "sender": f"{radio}.companion",
                    "serial": serial, "receiver": receiver, "outcome": "weak" if receiver == "deaf" else "decoded",
                }
                for receiver, at_ns, radio, serial in batch
            ]  # fmt: skip
            yield pa.RecordBatch.from_pylist(rows, schema=arrow_schema("receptions")).select(list(columns))

    def frames_with_payloads(self, columns: Sequence[str], *, encoded: bool = False) -> Iterator[pa.Table]:
        for batch in self._batches:
            sent = sorted({(at_ns - 5, radio, serial) for _, at_ns, radio, serial in batch})
            yield with_encoded_links(
                pa.table(
                    {
                        "link": [f"rid_up:{radio}" for _, radio, _ in sent],
                        "direction": ["fwd"] * len(sent),
                        "sender": [f"{radio}.companion" for _, radio, _ in sent],
                        "serial": [serial for _, _, serial in sent],
                        "sent_ns": [at_ns for at_ns, _, _ in sent],
                        "arrived_ns": [at_ns for at_ns, _, _ in sent],
                        "payload": [self._payload or broadcast(serial) for _, _, serial in sent],
                    }
                )
            )


def record(*batches: list[Row], payload: bytes | None = None, **changes: Any) -> RunRecord:
    return RunRecord(Path("run"), {**MANIFEST, **changes}, Tables(batches, payload))  # type: ignore[arg-type]


def broadcast(counter: int) -> bytes:
    return link_payload.pack(RidHeader(Transport.WIFI_BEACON, 6, counter & 255, b"abcdef"), bytes(25))


def test_receptions_are_ordered_by_time_and_say_who_sent_what() -> None:
    run = record(
        [("a/1", 500, "b/1", 3), ("mast", 300, "a/1", 1), ("mast", 700, "ghost", 0)],
        [("b/1", 100, "a/1", 0), ("deaf", 100, "a/1", 0)],
    )
    found = list(heard_in(run, ["a/1", "b/1", "mast"]))
    assert [(one.receiver, one.frame.header.time_ns) for one in found] == [
        ("b/1", 100), ("mast", 300), ("a/1", 500), ("mast", 700),
    ]  # fmt: skip
    ghost = found[-1]
    assert ghost.frame == (RidHeader(Transport.WIFI_BEACON, 11, 0, b"abcdef", -7012, 700), bytes(25))
    assert (ghost.radio, ghost.sender, ghost.serial) == ("ghost", "ghost.companion", 0)
    assert [one.frame_id for one in found[:2]] == [
        "rid_up:a/1|fwd|a/1.companion|0", "rid_up:a/1|fwd|a/1.companion|1",
    ]  # fmt: skip


def test_only_those_asked_for() -> None:
    rows = [("a/1", 1, "b/1", 0), ("mast", 2, "b/1", 0), ("other", 3, "b/1", 0)]
    assert [one.receiver for one in heard_in(record(rows), ["mast"])] == ["mast"]
    assert [one.receiver for one in heard_in(record(rows), ["a/1"])] == ["a/1"]


def test_a_long_record_is_read_as_it_is_written() -> None:
    """What is held is a batch of receptions and what lies within `WINDOW_NS`, here two batches' worth."""
    step = packet_captures.WINDOW_NS // 100
    batches = [[("a/1", (50 * n + k) * step, "b/1", 50 * n + k) for k in range(50)] for n in range(400)]
    run = record(*batches)
    stream = heard_in(run)
    ahead = packet_captures._BATCH_ROWS // 50 + 5
    for n, _ in zip(range(2_000), stream, strict=False):
        assert run.tables.read <= n // 50 + ahead  # type: ignore[attr-defined]
    assert sum(1 for _ in stream) == 18_000


def test_unknown_receivers_are_named_all_at_once() -> None:
    assert receivers_of(record()) == ["a/1", "b/1", "mast"]
    assert select_receivers(record(), ["mast", "mast"]) == ["mast"]
    with pytest.raises(InputError, match="Did you mean 'mast'") as caught:
        heard_in(record(), ["mst", "a/1", "c/1"])
    assert len(caught.value.problems) == 2


def test_a_run_without_a_radio_has_nothing_to_export(tmp_path: Path) -> None:
    manifest = {**MANIFEST, "links": [{"name": "gcs:a/1"}], "receivers": []}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    run = load(tmp_path)
    with pytest.raises(InputError, match="a run with a radio medium"):
        packet_captures.remote_id(run)
    assert packet_captures.mavlink(run).packets == 0


def test_an_injected_frame_goes_under_the_addresses_it_claims_and_its_comment_says_whose_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of what arrived, by arrival."""
    rows = {
        "link": ["gcs:b/1", "gcs:b/1", "gcs:b/1"], "direction": ["fwd", "rev", "fwd"],
        "sender": ["tap@gcs:b/1", "b/1.companion", "b.gcs"], "src": ["b.gcs", "b/1.companion", "b.gcs"],
        "arrived_ns": [500, 300, None], "payload": [b"INJECTED", b"TELEMETRY", b"LOST"],
    }  # fmt: skip
    run = record()
    monkeypatch.setattr(run.tables, "frames_with_payloads", lambda columns, *, encoded=False: iter([pa.table(rows)]))
    made = packet_captures.mavlink(run, tmp_path / "m.pcapng")
    assert made.by == {"gcs:a/1": 0, "gcs:b/1": 2}
    written = made.path.read_bytes()
    places = [written.index(part) for part in (b"TELEMETRY", b"INJECTED", b"gcs:b/1, sent by tap@gcs:b/1")]
    assert places == sorted(places)
    assert b"LOST" not in written
    start = places[1] - 28
    assert (
        capture.encode_datagram(SocketAddress(0x0AFF0002, 14550), SocketAddress(0x0A000002, 14555), b"INJECTED")
        == written[start:][:36]
    )


def test_half_a_file_is_not_left_behind(tmp_path: Path) -> None:
    whole = tmp_path / "c.pcapng"
    whole.write_bytes(b"before")
    with pytest.raises(Exception, match="at least 24"):
        packet_captures.remote_id(record([("a/1", 1, "b/1", 0)], payload=b"broken"), whole)
    assert [path.name for path in tmp_path.iterdir()] == ["c.pcapng"]
    assert whole.read_bytes() == b"before"


@pytest.mark.parametrize("start", [None, -1, 1.5, "2026", True])
def test_a_start_that_is_none_is_an_error(start: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="start_unix_ns"):
        packet_captures.remote_id(record(start_unix_ns=start), tmp_path / "c.pcapng")


def test_datagram_bytes() -> None:
    """The header of RFC 1071's method on a datagram by hand: words summed with end-around carry, and complemented."""
    made = capture.encode_datagram(SocketAddress(0x0A000001, 14555), SocketAddress(0x0AFF0001, 14550), b"\x01\x02\x03")
    assert made.hex() == (
        "4500001f00004000401125ce"  # 31 bytes, do not fragment, TTL 64, UDP; the other words sum to 0xda31
        "0a0000010aff0001"
        "38db38d6000b0000010203"
    )
    words = [int.from_bytes(made[at : at + 2], "big") for at in range(0, 20, 2)]
    total = sum(words)
    assert (total & 0xFFFF) + (total >> 16) == 0xFFFF
    with pytest.raises(ValueError, match="at most"):
        capture.encode_datagram(SocketAddress(1, 1), SocketAddress(2, 2), bytes(capture.MAX_PAYLOAD + 1))


def test_names_block() -> None:
    """pcapng draft, 4.4: type 4, record type 1 of address and zero-terminated name, padded, ended by an empty one."""
    block = capture.name_block({0x0A000001: "a/1"})
    assert block.hex() == "040000001c000000010008000a000001612f3100000000001c000000"
