"""Does Wireshark's dissector find in a capture what was broadcast? All four transports, through tshark."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from skyrange.codec import capture
from skyrange.codec.f3411 import BasicId, Location, MessagePack, System, encode
from skyrange.codec.remote_id import ble
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from tests.remote_id_encoders import encode_nan_sync_beacon, encode_pointer
from tests.tiers import needs_tshark

TSHARK = shutil.which("tshark")
pytestmark = needs_tshark

ADDRESS = bytes.fromhex("c21122334455")
START_UTC_NS = 1_767_268_800 * 10**9  # 2026-01-01T12:00:00Z
WHO = BasicId(1, 2, "1ABCC2345EF678XYZ")
PACK = encode(MessagePack((WHO, Location(2, 40.7, -73.9, 12.5, track_deg=271.0), System(1, 40.7, -73.9, 3.0))))


def sent(transport: int, channel: int, body: bytes, counter: int, rssi_cdbm: int, time_ns: int) -> RidFrame:
    return RidFrame(RidHeader(transport, channel, counter, ADDRESS, rssi_cdbm, time_ns), body)


SENT = [
    sent(Transport.WIFI_BEACON, 6, PACK, 0x11, -6789, 1_000_000_007),
    sent(Transport.WIFI_NAN, 149, PACK, 0x22, -5512, 2_000_000_000),
    sent(Transport.BT4, 37, encode(WHO), 0x33, -9000, 3_000_000_000),
    sent(Transport.BT5, 20, PACK, 0x44, -10_100, 4_000_000_000),
]


def read(packets: bytes, folder: Path, *fields: str) -> list[dict[str, str]]:
    """The first value of each field of each packet."""
    path = folder / "remote_id.pcapng"
    path.write_bytes(packets)
    assert TSHARK is not None
    wanted = [word for field in fields for word in ("-e", field)]
    done = subprocess.run(
        [TSHARK, "-n", "-r", path, "-o", "wlan.check_checksum:TRUE", "-T", "fields", "-E", "occurrence=l", *wanted],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return [dict(zip(fields, line.split("\t"), strict=True)) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def recorded() -> bytes:
    head = capture.file_header(capture.INTERFACES)
    return head + b"".join(
        capture.reception_block(frame, START_UTC_NS, f"frame {row}") for row, frame in enumerate(SENT)
    )


def test_wifi_frames(recorded: bytes, tmp_path: Path) -> None:
    beacon, nan = read(
        recorded, tmp_path, "frame.time_epoch", "frame.comment", "radiotap.channel.freq", "radiotap.dbm_antsignal",
        "radiotap.datarate", "wlan.fcs.status", "wlan.fc.type_subtype", "wlan.sa", "wlan.bssid", "wlan.da",
        "wlan.fixed.timestamp", "wlan.tag.oui", "wlan.tag.vendor.oui.type", "wlan.tag.vendor.data",
        "nan.service_id", "nan.sda.service_info",
        "nan.sdea.service_update_indicator",
    )[:2]  # fmt: skip
    assert beacon["frame.time_epoch"] == "1767268801.000000007"
    assert beacon["frame.comment"] == "frame 0"
    assert (beacon["radiotap.channel.freq"], nan["radiotap.channel.freq"]) == ("2437", "5745")
    assert (beacon["radiotap.dbm_antsignal"], nan["radiotap.dbm_antsignal"]) == ("-68", "-55")
    assert beacon["radiotap.datarate"] == nan["radiotap.datarate"] == "6"
    assert beacon["wlan.fcs.status"] == nan["wlan.fcs.status"] == "1"  # good
    assert [int(row["wlan.fc.type_subtype"], 0) for row in (beacon, nan)] == [8, 13]
    assert beacon["wlan.sa"] == nan["wlan.sa"] == beacon["wlan.bssid"] == "c2:11:22:33:44:55"
    assert beacon["wlan.da"] == "ff:ff:ff:ff:ff:ff"
    assert (nan["wlan.da"], nan["wlan.bssid"]) == ("51:6f:9a:01:00:00", "50:6f:9a:01:00:ff")
    assert int(beacon["wlan.fixed.timestamp"], 0) == 1_000_000
    assert (int(beacon["wlan.tag.oui"]), int(beacon["wlan.tag.vendor.oui.type"])) == (0xFA0BBC, 0x0D)
    assert hexadecimal(beacon["wlan.tag.vendor.data"]) == bytes([13, 0x11]) + PACK
    assert hexadecimal(nan["nan.service_id"]).hex() == "8869199d9209"
    assert hexadecimal(nan["nan.sda.service_info"]) == b"\x22" + PACK
    assert int(nan["nan.sdea.service_update_indicator"], 0) == 0x22


def test_bluetooth_packets(recorded: bytes, tmp_path: Path) -> None:
    legacy, extended = read(
        recorded, tmp_path, "frame.time_epoch", "btle_rf.channel", "btle_rf.signal_dbm", "btle_rf.flags",
        "btle.advertising_header.pdu_type", "btle.advertising_address", "btcommon.eir_ad.entry.uuid_16",
        "btcommon.eir_ad.entry.service_data", "btle.extended_advertising.advertising_data_info.did", "btle.crc",
    )[2:]  # fmt: skip
    assert legacy["frame.time_epoch"] == "1767268803.000000000"
    assert (legacy["btle_rf.channel"], extended["btle_rf.channel"]) == ("0", "22")  # index 37, index 20
    assert (legacy["btle_rf.signal_dbm"], extended["btle_rf.signal_dbm"]) == ("-90", "-101")
    assert [int(row["btle.advertising_header.pdu_type"], 0) for row in (legacy, extended)] == [2, 7]
    assert legacy["btle.advertising_address"] == extended["btle.advertising_address"] == "c2:11:22:33:44:55"
    assert (
        int(legacy["btcommon.eir_ad.entry.uuid_16"], 0) == int(extended["btcommon.eir_ad.entry.uuid_16"], 0) == 0xFFFA
    )
    assert hexadecimal(legacy["btcommon.eir_ad.entry.service_data"]) == bytes([13, 0x33]) + encode(WHO)
    assert hexadecimal(extended["btcommon.eir_ad.entry.service_data"]) == bytes([13, 0x44]) + PACK
    assert int(extended["btle.extended_advertising.advertising_data_info.did"], 0) == 0x44


def test_the_parts_that_only_announce(tmp_path: Path) -> None:
    extended = RidFrame(SENT[3].header, PACK)
    first = capture.ble_radio_header(38, -80.0, coded=True, auxiliary=False) + encode_pointer(
        extended, channel=20, offset_us=6000
    )
    sync = capture.radiotap_header(149, 6.0, -55.0) + encode_nan_sync_beacon(ADDRESS)
    both = capture.file_header(capture.INTERFACES) + capture.packet_block(1, START_UTC_NS, first)
    pointer, beacon = read(
        both + capture.packet_block(0, START_UTC_NS, sync), tmp_path, "_ws.col.Protocol",
        "btle.extended_advertising_header.aux_pointer.channel", "btle.extended_advertising_header.aux_pointer.aux_phy",
        "btle.extended_advertising_header.aux_pointer.aux_offset", "nan.service_id",
        "wlan.fcs.status", "wlan.bssid",
    )  # fmt: skip
    assert int(pointer["btle.extended_advertising_header.aux_pointer.channel"], 0) == 20
    assert int(pointer["btle.extended_advertising_header.aux_pointer.aux_phy"], 0) == 2
    assert int(pointer["btle.extended_advertising_header.aux_pointer.aux_offset"], 0) == 200
    assert (beacon["wlan.fcs.status"], beacon["wlan.bssid"]) == ("1", "50:6f:9a:01:00:ff")
    assert beacon["_ws.col.Protocol"] == "NAN"


@pytest.mark.parametrize(("flip", "complaint"), [(0, ""), (1, "Incorrect CRC")])
def test_tshark_agrees_on_the_crc(flip: int, complaint: str, tmp_path: Path) -> None:
    """The header's word that the CRC was checked is taken away, so that tshark checks it itself.

    Only of the uncoded packet: tshark 4.0 counts the coding indicator of a coded one into its CRC.
    """
    header = bytearray(capture.ble_radio_header(37, -80.0, coded=False, auxiliary=False))
    flags = struct.unpack_from("<H", header, 8)[0]
    struct.pack_into("<H", header, 8, flags & ~0x0C00)
    packet = bytearray(ble.encode_legacy(SENT[2]))
    packet[20] ^= flip
    raw = capture.file_header(capture.INTERFACES) + capture.packet_block(1, START_UTC_NS, bytes(header + packet))
    assert read(raw, tmp_path, "_ws.expert.message")[0]["_ws.expert.message"] == complaint


def hexadecimal(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", "").replace("-", ""))
