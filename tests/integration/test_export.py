"""Does Wireshark find in a run's captures what was in the air and on the links? Flown, exported, read by tshark."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from skyrange.cli.app import app
from skyrange.codec import f3411
from skyrange.codec.f3411 import Location, MessagePack
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import Transport
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.export.packet_captures import mavlink, receivers_of, remote_id
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.tiers import needs_tshark

TSHARK = shutil.which("tshark")

START_UTC_NS = 1_767_268_800 * NS_PER_S  # 2026-01-01T12:00:00Z
RF_CHANNEL = {37: 0, 38: 12, 39: 39}
"""Bluetooth Core 5.4, Vol 6 Part B, table 1.2."""

SCENARIO = """
name = "overheard"
seed = 3
duration_s = 9
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }
start_utc = 2026-01-01T12:00:00Z
[radio]
[[radio.receivers]]
id = "mast"
operator = "blue"
place = [10, 0, 4]
kind = "companion"
[[radio.receivers]]
id = "roof"
operator = "red"
place = [60, 20, 12]
kind = "hopper"
[[operators]]
id = "blue"
remote_id = { transports = ["wifi_beacon", "wifi_nan", "bluetooth"], text = "survey", operator_id = "OP-1" }
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 20, alt_m = 10 } }
[[operators]]
id = "red"
  [[operators.vehicles]]
  id = "r1"
  start = [40, 0]
  plan = { square = { side_m = 20, alt_m = 10 } }
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 4
params = { form = "ghost", at = [30, 30, 15], transmitter_m = [35, 10, 2] }
"""


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(load_text(SCENARIO), tmp_path_factory.mktemp("overheard") / "run")


def read(path: Path, *fields: str, only: str = "frame") -> list[dict[str, str]]:
    """The last value of each field of each packet, of those that a display filter lets pass."""
    assert TSHARK is not None
    wanted = [word for field in fields for word in ("-e", field)]
    options = ["-o", "wlan.check_checksum:TRUE", "-o", "ip.check_checksum:TRUE", "-E", "occurrence=l"]
    done = subprocess.run(
        [TSHARK, "-n", "-r", path, "-Y", only, *options, "-T", "fields", *wanted],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return [dict(zip(fields, line.split("\t"), strict=True)) for line in done.stdout.splitlines()]


def received(record: RunRecord, name: str) -> list[tuple[dict[str, Any], link_payload.RidFrame]]:
    """What the `receptions` table has of a receiver, by time, each with the frame that its sender's radio was given."""
    given = {
        (frame.link, frame.direction, frame.sender, frame.serial): frame.payload
        for frame in record.frames_with_payloads()
        if frame.link.startswith("rid_up:")
    }
    rows = [row for row in record.table("receptions").to_pylist() if row["receiver"] == name]
    rows = sorted((row for row in rows if row["outcome"] == "decoded"), key=lambda row: row["time_ns"])
    told = [given[row["link"], row["direction"], row["sender"], row["serial"]] for row in rows]
    return [(row, link_payload.unpack(payload)) for row, payload in zip(rows, told, strict=True)]


def hexadecimal(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", "").replace("-", ""))


@needs_tshark
def test_every_reception_is_in_the_capture_as_it_was(record: RunRecord, tmp_path: Path) -> None:
    """Against the table of receptions, which the exporter does not read: who, when, channel, strength, all bytes."""
    made = remote_id(record, tmp_path / "all.pcapng")
    packets = read(
        made.path, "frame.interface_name", "frame.comment", "frame.time_epoch", "wlan.fc.type_subtype",
        "radiotap.channel.freq", "radiotap.dbm_antsignal", "wlan.fcs.status", "wlan.sa", "wlan.tag.vendor.data",
        "nan.sda.service_info", "btle_rf.channel", "btle_rf.signal_dbm", "btle.advertising_header.pdu_type",
        "btle.advertising_address", "btcommon.eir_ad.entry.service_data",
    )  # fmt: skip
    assert len(packets) == made.packets == sum(made.by.values())
    times = [packet["frame.time_epoch"] for packet in packets]
    assert times == sorted(times)
    names = receivers_of(record)
    assert names == ["blue/b1", "red/r1", "mast", "roof"]
    transports = set()
    for name in names:
        wanted = received(record, name)
        own = [packet for packet in packets if packet["frame.interface_name"].rpartition(" ")[0] == name]
        assert len(own) == len(wanted) == made.by[name] > 5
        for packet, (row, sent) in zip(own, wanted, strict=True):
            utc_ns = START_UTC_NS + row["time_ns"]
            assert packet["frame.time_epoch"] == f"{utc_ns // NS_PER_S}.{utc_ns % NS_PER_S:09d}"
            assert packet["frame.comment"] == f"received by {name}"
            wifi = packet["frame.interface_name"].endswith(" wifi")
            strength = packet["radiotap.dbm_antsignal" if wifi else "btle_rf.signal_dbm"]
            assert abs(int(strength) - row["rssi_dbm"]) <= 0.51  # whole dB, of hundredths
            header = sent.header
            if wifi:
                assert packet["wlan.fcs.status"] == "1"
                assert int(packet["radiotap.channel.freq"]) == 2407 + 5 * row["channel"]
                beacon = int(packet["wlan.fc.type_subtype"], 0) == 8
                transport = Transport.WIFI_BEACON if beacon else Transport.WIFI_NAN
                said = (
                    hexadecimal(packet["wlan.tag.vendor.data"])[1:]
                    if beacon
                    else hexadecimal(packet["nan.sda.service_info"])
                )
                address = packet["wlan.sa"]
            else:
                index = row["channel"]
                rf = RF_CHANNEL.get(index, index + 1 if index <= 10 else index + 2)
                assert int(packet["btle_rf.channel"]) == rf
                legacy = int(packet["btle.advertising_header.pdu_type"], 0) == 2
                transport = Transport.BT4 if legacy else Transport.BT5
                said = hexadecimal(packet["btcommon.eir_ad.entry.service_data"])[1:]
                address = packet["btle.advertising_address"]
            assert transport == header.transport
            assert transport.name.lower() == row["transport"]
            assert hexadecimal(address) == header.address
            assert said == bytes([header.counter]) + sent.body
            transports.add(transport)
    assert transports == set(Transport)


@needs_tshark
def test_the_places_in_the_bytes_are_where_the_aircraft_was(record: RunRecord, tmp_path: Path) -> None:
    """Latitude, longitude and height decoded from what tshark shows, against truth: 10 m, of GNSS and its latency."""
    made = remote_id(record, receivers=["mast"], path=tmp_path / "mast.pcapng")
    assert set(made.by) == {"mast"}
    origin = Origin(40.7780, -73.9550, 20.0, -32.7)
    truth = [row for row in record.table("truth").to_pylist() if row["vehicle"] == "blue/b1"]
    own = {sent.header.address for row, sent in received(record, "mast") if row["link"] == "rid_up:blue/b1"}
    checked = 0
    for packet in read(made.path, "frame.time_epoch", "btle.advertising_address", "btcommon.eir_ad.entry.service_data"):
        if not packet["btle.advertising_address"] or hexadecimal(packet["btle.advertising_address"]) not in own:
            continue
        message = f3411.decode(hexadecimal(packet["btcommon.eir_ad.entry.service_data"])[2:])
        for part in message.messages if isinstance(message, MessagePack) else (message,):
            if not isinstance(part, Location) or part.lat_deg is None:
                continue
            seconds, _, rest = packet["frame.time_epoch"].partition(".")
            at_ns = int(seconds + rest) - START_UTC_NS
            row = min(truth, key=lambda row: abs(row["time_ns"] - at_ns))
            assert part.lon_deg is not None
            east, north = origin.enu_of(part.lat_deg, part.lon_deg)
            assert part.alt_geo_m is not None
            up = part.alt_geo_m - origin.geoid_m - origin.alt_msl_m
            assert abs(east - row["east_m"]) < 10
            assert abs(north - row["north_m"]) < 10
            assert abs(up - row["up_m"]) < 10
            checked += 1
    assert checked >= 5


@needs_tshark
def test_mavlink_as_delivered(record: RunRecord, tmp_path: Path) -> None:
    made = mavlink(record, tmp_path / "mavlink.pcapng")
    packets = read(
        made.path, "frame.time_epoch", "frame.comment", "ip.src", "ip.dst", "ip.checksum.status", "udp.srcport",
        "udp.dstport", "udp.payload",
    )  # fmt: skip
    wanted = [
        frame
        for frame in record.frames_with_payloads()
        if frame.link.startswith("gcs:") and frame.arrived_ns is not None
    ]
    assert len(packets) == len(wanted) == made.packets > 100
    assert {packet["ip.checksum.status"] for packet in packets} == {"1"}
    addresses = {"gcs:blue/b1": ("10.0.0.1", "10.255.0.1"), "gcs:red/r1": ("10.0.0.2", "10.255.0.2")}
    found = sorted(
        (int(p["frame.time_epoch"].replace(".", "")) - START_UTC_NS, p["frame.comment"], p["ip.src"], p["ip.dst"],
         p["udp.srcport"], p["udp.dstport"], hexadecimal(p["udp.payload"]))
        for p in packets
    )  # fmt: skip
    expected = []
    for frame in wanted:
        aircraft, station = addresses[frame.link]
        ends = (
            (station, aircraft, "14550", "14555") if frame.direction == "fwd" else (aircraft, station, "14555", "14550")
        )
        expected.append((frame.arrived_ns, frame.link, *ends, frame.payload))
    assert found == sorted(expected)


@needs_tshark
def test_the_filters_of_the_how_to_find_packets(record: RunRecord, tmp_path: Path) -> None:
    """As the page has them, with an address of this run; none finds all packets, each some."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "look-at-broadcasts-in-wireshark.md"
    filters = re.findall(r"^\| [^|]+ \| (`.+`) \|$", page.read_text(encoding="utf-8"), re.MULTILINE)
    told = [one for row in filters for one in re.findall(r"`([^`]+)`", row)]
    assert len(told) == 8
    capture = remote_id(record, tmp_path / "all.pcapng")
    address = received(record, "mast")[0][1].header.address.hex(":")
    for one in told:
        wanted = re.sub(r"(?:[0-9a-f]{2}:){5}[0-9a-f]{2}", address, one)
        found = read(capture.path, "frame.number", only=wanted)
        assert 0 < len(found) < capture.packets, one


def test_the_command_line(record: RunRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app(["export", str(record.path), "--json"], standalone_mode=False)
    made = json.loads(capsys.readouterr().out)
    assert {name: Path(one["path"]).parent for name, one in made.items()} == {
        "remote_id": record.path,
        "mavlink": record.path,
    }
    for one in made.values():
        assert Path(one["path"]).stat().st_size > 10_000
    arguments = ["export", str(record.path), "--only", "remote_id", "--receiver", "mast", "--out", str(tmp_path)]
    app(arguments, standalone_mode=False)
    assert [path.name for path in tmp_path.iterdir()] == ["remote_id.pcapng"]
    for wrong, says in (
        (["--receiver", "mats"], "Did you mean 'mast'"),
        (["--only", "mavlink", "--receiver", "mast"], "no --receiver, or --only remote_id"),
        (["--out", str(tmp_path / "nowhere")], "a folder that exists"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            app(["export", str(record.path), *wrong], standalone_mode=False)
        assert caught.value.exit_code == 2


def test_files_of_operators(record: RunRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not (record.path / "operators").exists(), "not unless they are wanted"
    app(["export", str(record.path), "--csv", "--out", str(tmp_path), "--json"], standalone_mode=False)
    made = json.loads(capsys.readouterr().out)
    assert set(made) == {"blue.csv", "red.csv", "fields.csv"}
    with (tmp_path / "operators" / "blue.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["vehicle"] for row in rows} == {"blue/b1"}
    assert len([row for row in rows if row["message"] == "ATTITUDE"]) == sum(
        vehicle == "blue/b1" for vehicle in record.telemetry("ATTITUDE")["vehicle"].to_pylist()
    )
    app(["export", str(record.path), "--tlog", "--out", str(tmp_path)], standalone_mode=False)
    assert {path.name for path in (tmp_path / "operators").glob("*.tlog")} == {"blue.tlog", "red.tlog"}
    assert f"bytes  {tmp_path}/operators/blue.tlog" in capsys.readouterr().out
    assert (tmp_path / "operators" / "blue.tlog").stat().st_size > 5_000
    with pytest.raises(InputError, match="with --only or --receiver"):
        app(["export", str(record.path), "--csv", "--only", "mavlink"], standalone_mode=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="a folder that exists"):
        app(["export", str(record.path), "--csv", "--out", str(tmp_path / "file")], standalone_mode=False)


def test_the_ground_station_knows_whom_its_receivers_heard(record: RunRecord) -> None:
    """Each operator's, of its own receivers only; and the report says how strong and how old."""
    seen = [
        (row["about"], row["source"], json.loads(row["data"]))
        for row in record.table("events").to_pylist()
        if row["kind"] == "event.track_seen"
    ]
    by_mast = {data["address"] for about, _, data in seen if about == "blue"}
    heard = {sent.header.address.hex() for _, sent in received(record, "mast")}
    assert by_mast == heard
    assert len(heard) == 3  # two aircraft and the ghost
    assert {(about, source, data["receiver"]) for about, source, data in seen} == {
        ("blue", "blue.gcs", "mast"),
        ("red", "red.gcs", "roof"),
    }
    page = (record.path / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<section id="air"') :]
    rows = [row for row in received(record, "mast") if row[0]["link"] == "rid_up:ghost"]
    start = section.index("<th scope=row>mast</th><td>ghost</td>")
    assert f"<td class=num>{len(rows)}</td>" in section[start : start + 80]
