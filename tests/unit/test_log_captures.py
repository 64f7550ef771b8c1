"""Are packets of captures found, whatever wrote them, and are their frames at the right ends of the right links?"""

from __future__ import annotations

import io
import struct
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import pytest

from skyrange.codec.capture import BLE_PHDR, RADIOTAP, file_header, name_block, packet_block, reception_block
from skyrange.codec.capture_reading import CaptureCounts, Packet, read_packets
from skyrange.codec.internet_packets import Address, find_segment
from skyrange.codec.mavlink.frames import LAYOUTS, checksum
from skyrange.codec.remote_id import wifi
from skyrange.codec.remote_id.captured_broadcasts import WIFI, read_broadcast
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI, Transport
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.time import NS_PER_S
from skyrange.log_detection.capture_flows import FlowReader
from skyrange.log_detection.detector_choice import Request
from skyrange.log_detection.judging import judge
from skyrange.log_detection.observed_log import ObservedLog
from skyrange.log_detection.opening import LogOptions, open_log
from tests.captured_packets import (
    STATION,
    VEHICLE,
    broadcast,
    ethernet,
    ip4,
    logged,
    packets_of,
    tcp,
    udp,
    write_pcap,
    write_pcapng,
    write_remote_id_capture,
)
from tests.written_logs import START_US, hop

START_NS = START_US * 1000


def packets(data: bytes) -> tuple[list[Packet], CaptureCounts]:
    counts = CaptureCounts()
    return list(read_packets(io.BytesIO(data), counts)), counts


def frames(log: ObservedLog) -> list[tuple[int, str, bool, bytes]]:
    """Time, link, whether it arrived, and bytes of each frame of a log."""
    found = []
    for table in log.rows(log.ends):
        columns = (table[name].to_pylist() for name in ("at_ns", "place", "received", "payload"))
        found += [(at, log.ends[place].link, bool(here), data) for at, place, here, data in zip(*columns, strict=True)]
    return found


@pytest.mark.parametrize("order", ["<", ">"])
def test_pcap_of_both_byte_orders(order: str, tmp_path: Path) -> None:
    path = write_pcap(tmp_path / "a.pcap", [(START_NS + 1_234_567_000, b"abc"), (START_NS + NS_PER_S, b"")], 1, order)
    found, counts = packets(path.read_bytes())
    assert [(packet.time_ns, packet.data) for packet in found] == [
        (START_NS + 1_234_567_000, b"abc"), (START_NS + NS_PER_S, b""),
    ]  # fmt: skip
    assert found[0].interface.link_type == 1
    assert counts.packets == 2


def test_pcap_with_nanoseconds() -> None:
    head = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1)
    (packet,), _ = packets(head + struct.pack("<IIII", 5, 7, 2, 9) + b"ab")
    assert packet.time_ns == 5 * NS_PER_S + 7
    assert packet.is_cut


def test_pcapng_of_the_other_byte_order_and_of_other_resolutions() -> None:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        return struct.pack(">II", kind, len(body) + 12) + body + struct.pack(">I", len(body) + 12)

    section = block(0x0A0D0D0A, struct.pack(">IHHq", 0x1A2B3C4D, 1, 0, -1))
    option = struct.pack(">HH", 9, 1) + b"\x8a\0\0\0" + struct.pack(">HHq", 14, 8, 100)
    interfaces = block(1, struct.pack(">HHI", 101, 0, 0)) + block(1, struct.pack(">HHI", 228, 0, 0) + option)
    first = block(6, struct.pack(">IIIII", 0, 0, 2_500_000, 3, 3) + b"abc")  # microseconds where nothing is said
    second = block(6, struct.pack(">IIIII", 1, 0, 1536, 1, 1) + b"d")  # units of 2^-10 s, and 100 s to be added
    untimed = block(3, struct.pack(">I", 2) + b"ef")
    found, counts = packets(section + interfaces + first + untimed + second)
    assert [(packet.time_ns, packet.data) for packet in found] == [(2_500_000_000, b"abc"), (101_500_000_000, b"d")]
    assert [packet.interface.link_type for packet in found] == [101, 228]
    assert counts.untimed_packets == 1


def test_packets_behind_a_damaged_block_are_found() -> None:
    blocks = [packet_block(0, START_NS + k, bytes([k]) * 20) for k in range(6)]
    head = file_header([("eth0", 1)])
    broken = bytearray(blocks[2])
    broken[4] ^= 0x40  # its length
    data = head + blocks[0] + blocks[1] + bytes(broken) + blocks[3] + b"\x01garbage" + blocks[4] + blocks[5][:-5]
    found, counts = packets(data)
    assert [packet.data[0] for packet in found] == [0, 1, 3, 4]
    assert counts.bad_bytes == len(broken) + 8
    assert counts.cut_bytes == len(blocks[5]) - 5


def test_a_damaged_record_of_pcap_ends_it() -> None:
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    good = struct.pack("<IIII", 5, 0, 2, 2) + b"ab"
    found, counts = packets(head + good + struct.pack("<IIII", 5, 0, 2**31, 2) + good)
    assert len(found) == 1
    assert counts.bad_bytes == 16 + len(good)


@pytest.mark.parametrize("tags", [b"", b"\x81\x00\x00\x05", b"\x88\xa8\x00\x05\x81\x00\x00\x06"])
def test_datagrams_behind_vlan_tags(tags: bytes) -> None:
    whole = udp(VEHICLE, STATION, b"payload")
    found = find_segment(1, whole[:12] + tags + whole[12:] + bytes(6))  # Ethernet pads short frames
    assert found is not None
    assert found.payload == b"payload"
    assert found.source == Address(ip4("10.0.0.1"), 14555)
    assert str(found.target) == "10.0.0.9-14550"


def test_datagrams_in_ipv6_behind_an_extension() -> None:
    segment = struct.pack(">HHHH", 1, 2, 12, 0) + b"abcd"
    extension = bytes([17, 0]) + bytes(6)
    head = (
        struct.pack(">IHBB", 6 << 28, len(extension) + len(segment), 0, 64) + bytes(15) + b"\x01" + bytes(15) + b"\x02"
    )
    found = find_segment(229, head + extension + segment)
    assert found is not None
    assert (found.payload, str(found.source)) == (b"abcd", "::1-1")


@pytest.mark.parametrize("data", [b"", b"\x45", b"\x60" * 30, bytes(60)])
def test_packets_that_are_too_short_have_no_segment(data: bytes) -> None:
    for link_type in (0, 1, 101, 113, 228, 229, 276, 9999):
        assert find_segment(link_type, data) is None


def test_fragments_are_not_taken_for_datagrams() -> None:
    whole = bytearray(udp(VEHICLE, STATION, b"payload"))
    whole[14 + 6] = 0x20  # more fragments
    assert find_segment(1, bytes(whole)) is None


def test_a_tcp_stream_is_put_in_order() -> None:
    sent = [frame for _, frame in logged(hop(4.0, 2.0))]
    stream = b"".join(sent)
    cuts = sorted({0, len(stream), *range(7, len(stream), 31)})
    parts = [(begin, stream[begin:end]) for begin, end in pairwise(cuts)]
    parts[3], parts[5] = parts[5], parts[3]  # overtaken
    parts.insert(8, (parts[2][0], parts[2][1] + parts[4][1][:0]))  # sent again
    base = 2**32 - 50  # numbers wrap round
    reader, found = FlowReader(), []
    for begin, part in parts:
        segment = find_segment(1, tcp(VEHICLE, STATION, part, base + begin))
        assert segment is not None
        found += [data for data, is_frame in reader.read(segment) if is_frame]
    assert found == sent
    assert reader.counts.garbage_bytes == 0


def test_a_gap_of_a_tcp_stream_is_jumped_over() -> None:
    sent = [frame for _, frame in logged(hop(20.0, 4.0))]
    reader, found, at = FlowReader(), [], 1000
    for number, frame in enumerate(sent):
        segment = find_segment(1, tcp(VEHICLE, STATION, frame, at))
        assert segment is not None
        at += len(frame)
        if number != 10:  # was not captured
            found += [data for data, is_frame in reader.read(segment) if is_frame]
    assert found == sent[:10] + sent[11:]
    assert reader.counts.lost_segments == 1


def test_datagrams_are_frames_of_the_link_between_their_ends(tmp_path: Path) -> None:
    path = write_pcapng(tmp_path / "a.pcapng", packets_of(hop(6.0, 2.0)))
    log = open_log(path)
    assert [end.link for end in log.ends] == ["gcs:10.0.0.9-14550/10.0.0.1-14555"]
    expected = [(time_ns - START_NS, data, (data[5] if data[0] == 0xFD else data[3]) != 255)
                for time_ns, data in logged(hop(6.0, 2.0))]  # fmt: skip
    assert sorted((at, data, received) for at, _, received, data in frames(log)) == sorted(expected)
    on_board = frames(open_log(path, LogOptions(side="companion")))
    assert sorted((at, data, not received) for at, _, received, data in on_board) == sorted(expected)


def test_pcap_and_pcapng_give_the_same_alerts(tmp_path: Path) -> None:
    sent = [(time_ns, data) for time_ns, data in packets_of(hop(20.0, 2.0)) if not 8e9 < time_ns - START_NS < 16e9]
    request = Request(kinds=("heartbeat.gap", "mavlink.*"))
    new = judge(open_log(write_pcapng(tmp_path / "a.pcapng", sent)), request)
    old = judge(open_log(write_pcap(tmp_path / "a.pcap", sent)), request)
    assert new.alerts == old.alerts
    assert {raised.alert.kind for raised in new.alerts} >= {"heartbeat.gap"}


def test_names_of_a_capture_are_names_of_vehicles_and_stations(tmp_path: Path) -> None:
    blocks = [packet_block(0, time_ns, data) for time_ns, data in packets_of(hop(4.0, 2.0))]
    called = {int.from_bytes(ip4("10.0.0.1"), "big"): "blue/b1", int.from_bytes(ip4("10.0.0.9"), "big"): "blue.gcs"}
    path = tmp_path / "a.pcapng"
    path.write_bytes(file_header([("gcs", 1)]) + name_block(called) + b"".join(blocks))
    log = open_log(path)
    assert log.vehicles == ["blue/b1"]
    assert log.ends[0].endpoint == "blue.gcs"


def test_vehicles_behind_one_socket_have_links_of_their_own(tmp_path: Path) -> None:
    sent = list(packets_of(hop(4.0, 2.0)))
    for time_ns, frame in logged(hop(4.0, 2.0)):
        if frame[0] == 0xFD and frame[5] == 1 and frame[7] == 0:  # the same heartbeats of another vehicle
            other = bytearray(frame)
            other[5] = 7
            body = bytes(other[1 : 10 + other[1]])
            other[-2:] = checksum(body, LAYOUTS[0].crc_extra).to_bytes(2, "little")
            sent.append((time_ns, udp(VEHICLE, STATION, bytes(other))))
    path = write_pcapng(tmp_path / "a.pcapng", sorted(sent))
    log = open_log(path)
    assert [vehicle.rpartition("-")[2] for vehicle in log.vehicles] == ["sys1", "sys7"]
    assert all(data[5] == (7 if "sys7" in link else 1) for _, link, received, data in frames(log) if received)
    alone = open_log(path, LogOptions(systems=(7,)))
    assert {link.rpartition("-")[2] for _, link, _, _ in frames(alone)} == {"sys7"}


def test_an_attacker_with_an_address_of_its_own_has_a_link_of_its_own(tmp_path: Path) -> None:
    sent = list(packets_of(hop(4.0, 2.0)))
    order = next(frame for _, frame in logged(hop(4.0, 2.0)) if frame[5] == 255)
    sent.append((START_NS + 2 * NS_PER_S, udp(("10.0.0.66", 9999), VEHICLE, order)))
    log = open_log(write_pcapng(tmp_path / "a.pcapng", sorted(sent)))
    (strange,) = [row for row in frames(log) if "10.0.0.66" in row[1]]
    assert not strange[2], "it went towards the aircraft"


def test_what_is_not_read_is_counted(tmp_path: Path) -> None:
    sent = [*packets_of(hop(4.0, 2.0)), (START_NS + 9 * NS_PER_S, udp(VEHICLE, STATION, b"noise" * 5)),
            (START_NS + 9 * NS_PER_S, ethernet("1.2.3.4", "5.6.7.8", 1, b"ping"))]  # fmt: skip
    path = write_pcapng(tmp_path / "a.pcapng", sent)
    path.write_bytes(path.read_bytes() + file_header([("can0", 227)]) + packet_block(0, START_NS, b"can"))
    said = " ".join(remark.text for remark in open_log(path).remarks)
    assert "25 bytes of UDP and TCP payloads belong to no MAVLink frame" in said
    assert "1 packets have link types that are not read: 227" in said


def test_a_capture_without_either_is_refused(tmp_path: Path) -> None:
    path = write_pcap(tmp_path / "a.pcap", [(START_NS, udp(VEHICLE, STATION, b"noise"))])
    with pytest.raises(InputError, match="1 packets, 1 of UDP or TCP"):
        open_log(path)


def test_a_broadcast_is_read_back_from_its_packet() -> None:
    for transport in (Transport.WIFI_BEACON, Transport.BT4):
        sent = broadcast(3 * NS_PER_S, transport)
        (packet,), _ = packets(file_header([("w", RADIOTAP), ("b", BLE_PHDR)]) + reception_block(sent, START_NS))
        found = read_broadcast(packet.interface.link_type, packet.data)
        assert packet.time_ns == START_NS + 3 * NS_PER_S
        assert found.body == sent.body
        assert found.header == sent.header._replace(time_ns=0)


def test_a_broadcast_without_a_radio_header_or_check_sequence() -> None:
    sent = broadcast(0)
    frame = wifi.encode_beacon(sent)
    assert crc32(frame[:-4]) == int.from_bytes(frame[-4:], "little")
    found = read_broadcast(WIFI, frame[:-4])
    assert (found.body, found.header.rssi_cdbm, found.header.channel) == (sent.body, NO_RSSI, ANY_CHANNEL)
    extended = struct.pack("<BBHII", 0, 0, 8 + 4 + 8 + 1, 1 << 31 | 1 << 0 | 1 << 5, 1)
    head = extended + bytes(4) + bytes(8) + struct.pack("<b", -70)
    head = head[:2] + struct.pack("<H", len(head)) + head[4:]
    assert read_broadcast(RADIOTAP, head + frame[:-4]).header.rssi_cdbm == -7000


@pytest.mark.parametrize("data", [b"", b"\0\0\x08\0", bytes(40), b"\x01" * 60])
def test_other_radio_packets_are_no_broadcasts(data: bytes) -> None:
    for link_type in (WIFI, RADIOTAP, BLE_PHDR):
        with pytest.raises(DecodeError):
            read_broadcast(link_type, data)


def test_broadcasts_are_judged_around_the_middle_of_their_claims(tmp_path: Path) -> None:
    log = open_log(write_remote_id_capture(tmp_path / "a.pcapng"))
    assert (log.origin.lat_deg, log.origin.lon_deg) == pytest.approx((47.0, 8.0))
    assert [end.link for end in log.ends] == ["rid_down:mast"]
    findings = judge(log, Request(kinds=("remote_id.*",)))
    (chosen,) = findings.choice.chosen
    assert "places of receivers" in chosen.less[0]
    assert findings.frames == 40
    assert [one.subject for one in findings.exposures] == ["mast"]
