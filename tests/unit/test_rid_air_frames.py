"""Remote ID as 802.11 and Bluetooth LE frames: built and parsed, checked, cut, flipped; and the capture around them."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec import capture
from skyrange.codec.f3411 import BasicId, Location, MessagePack, SelfId, encode
from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, RidHeader, Transport, pack, unpack
from skyrange.core.errors import DecodeError
from tests.remote_id_encoders import encode_nan_sync_beacon, encode_pointer

ADDRESS = bytes.fromhex("c21122334455")
SINGLE = encode(Location(2, 40.7, -73.9, 12.5))
PACK = encode(MessagePack((BasicId(1, 2, "MFR11"), Location(2, 40.7, -73.9, 12.5))))
FULL = encode(MessagePack((SelfId(0, "x" * 23),) * 9))


def frame(transport: int, body: bytes, counter: int = 0x55) -> RidFrame:
    return RidFrame(RidHeader(transport, counter=counter, address=ADDRESS), body)


SENT = [frame(Transport.WIFI_BEACON, PACK), frame(Transport.WIFI_BEACON, FULL), frame(Transport.WIFI_NAN, PACK),
        frame(Transport.WIFI_NAN, FULL), frame(Transport.BT4, SINGLE), frame(Transport.BT5, PACK),
        frame(Transport.BT5, FULL)]  # fmt: skip


def build(sent: RidFrame) -> bytes:
    maker: dict[Transport, Callable[[RidFrame], bytes]] = {
        Transport.WIFI_BEACON: wifi.encode_beacon,
        Transport.WIFI_NAN: wifi.encode_nan_action,
        Transport.BT4: ble.encode_legacy,
    }
    return maker.get(Transport(sent.header.transport), ble.encode_auxiliary)(sent)


def parse(transport: int, raw: bytes) -> RidFrame:
    if transport in (Transport.WIFI_BEACON, Transport.WIFI_NAN):
        return wifi.decode_frame(raw)
    return ble.decode_packet(raw, coded=transport == Transport.BT5)


@pytest.mark.parametrize("sent", SENT)
def test_a_frame_says_what_was_put_in(sent: RidFrame) -> None:
    assert parse(sent.header.transport, build(sent)) == sent


@pytest.mark.parametrize("sent", SENT)
def test_every_cut_and_every_flipped_bit_is_refused(sent: RidFrame) -> None:
    raw = build(sent)
    for size in range(len(raw)):
        with pytest.raises(DecodeError):
            parse(sent.header.transport, raw[:size])
    start = 5 if sent.header.transport == Transport.BT5 else 0  # the coding indicator is not covered by the CRC
    for place in range(start, len(raw)):
        wrong = bytearray(raw)
        wrong[place] ^= 1 << place % 8
        with pytest.raises(DecodeError):
            parse(sent.header.transport, bytes(wrong))


@given(st.sampled_from(SENT), st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), max_size=4), st.data())
@settings(deadline=None, max_examples=300)
def test_hostile_frames_with_a_right_checksum_are_survived(
    sent: RidFrame, changes: list[tuple[int, int]], data: st.DataObject
) -> None:
    transport = sent.header.transport
    raw = build(sent)
    covered = bytearray(raw[:-4] if transport >= Transport.WIFI_BEACON else raw[:-3])
    for place, change in changes:
        covered[place % len(covered)] ^= change
    covered = covered[: data.draw(st.integers(0, len(covered)))]
    if transport >= Transport.WIFI_BEACON:
        hostile = wifi._with_fcs(bytes(covered))
    else:
        hostile = bytes(covered) + ble.checksum(bytes(covered[5 if transport == Transport.BT5 else 4 :]))
    try:
        got = parse(transport, hostile)
    except DecodeError:
        return
    assert len(got.body) < len(hostile)
    assert unpack(pack(got.header, got.body)) == got


@given(st.binary(max_size=300), st.booleans())
@settings(deadline=None)
def test_any_bytes_are_survived(raw: bytes, coded: bool) -> None:
    with pytest.raises(DecodeError):
        wifi.decode_frame(raw)
    with pytest.raises(DecodeError):
        ble.decode_packet(raw, coded=coded)


def test_a_legacy_advertisement_byte_by_byte() -> None:
    """F3411-22a, Bluetooth Legacy: 31 bytes of advertising data, all used."""
    raw = ble.encode_legacy(frame(Transport.BT4, SINGLE))
    assert raw[:4].hex() == "d6be898e"
    assert raw[4:6].hex() == "4225"  # ADV_NONCONN_IND from a random address, 37 bytes
    assert raw[6:12] == ADDRESS[::-1]
    assert raw[12:18].hex() == "1e16faff0d55"
    assert raw[18:43] == SINGLE
    assert len(raw) == 43 + 3


@pytest.mark.parametrize(
    "packet",
    [
        "00119992b1ebd7900201050702031802180418" + "a85def",
        "05225f96ea3018009992b1ebd7901b0a8560a77b22020f0050000000d007ffffffff1fa9" + "48da02",
    ],
)
def test_crc_of_advertising_packets_by_others(packet: str) -> None:
    """BTLE of Jiao Xianjun, as printed on the hackrf-dev list, 2015-11-08, under "after crc24"."""
    raw = bytes.fromhex(packet)
    assert ble.checksum(raw[:-3]) == raw[-3:]


def test_an_extended_advertisement_byte_by_byte() -> None:
    raw = ble.encode_auxiliary(frame(Transport.BT5, FULL), set_id=3)
    assert raw[4:7].hex() == "0047f4"  # S=8; AUX_ADV_IND from a random address, 244 bytes
    assert raw[7:9].hex() == "0909"  # nine bytes of header: flags, address, data information
    assert raw[9:15] == ADDRESS[::-1]
    assert raw[15:17].hex() == "5530"
    assert raw[17:23].hex() == "e916faff0d55"


@pytest.mark.parametrize(
    ("channel", "offset_us", "expected"),
    [(20, 6000, 20 | 200 << 8 | 2 << 21), (36, 245_699, 36 | 8189 << 8 | 2 << 21),
     (0, 245_700, 1 << 7 | 819 << 8 | 2 << 21)],
)  # fmt: skip
def test_a_pointer_says_channel_time_and_phy(channel: int, offset_us: int, expected: int) -> None:
    raw = encode_pointer(frame(Transport.BT5, PACK), channel=channel, offset_us=offset_us)
    assert raw[5:9].hex() == "07070618"
    assert int.from_bytes(raw[11:14], "little") == expected
    with pytest.raises(DecodeError, match="address"):
        ble.decode_packet(raw, coded=True)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="one message"):
        ble.encode_legacy(frame(Transport.BT4, PACK))
    with pytest.raises(ValueError, match="does not fit"):
        ble.encode_auxiliary(frame(Transport.BT5, bytes(251)))
    with pytest.raises(ValueError, match="element"):
        wifi.encode_beacon(frame(Transport.WIFI_BEACON, bytes(251)))
    with pytest.raises(ValueError, match="service info"):
        wifi.encode_nan_action(frame(Transport.WIFI_NAN, bytes(255)))
    with pytest.raises(ValueError, match="ssid"):
        wifi.encode_beacon(frame(Transport.WIFI_BEACON, PACK), ssid=b"")
    with pytest.raises(ValueError, match="offset"):
        encode_pointer(frame(Transport.BT5, PACK), channel=37, offset_us=6000)


def test_other_networks_are_no_remote_id() -> None:
    foreign = bytes.fromhex("80000000ffffffffffff02030405060702030405060700000000000000000000640011040003414243010182")
    with pytest.raises(DecodeError, match="without Remote ID"):
        wifi.decode_frame(wifi._with_fcs(foreign))
    with pytest.raises(DecodeError, match="without Remote ID"):
        wifi.decode_frame(encode_nan_sync_beacon(ADDRESS))


def test_channels_and_frequencies() -> None:
    assert [capture.wifi_frequency_mhz(channel) for channel in (1, 6, 13, 14, 36, 149)] == [
        2412, 2437, 2472, 2484, 5180, 5745,
    ]  # fmt: skip
    for bad in (0, 15, 255):
        with pytest.raises(ValueError, match="Wi-Fi channel"):
            capture.wifi_frequency_mhz(bad)
    # Core 5.4, Vol 6 Part B, table 1.2: RF channel of a channel index
    assert [capture.ble_rf_channel(index) for index in (37, 0, 10, 38, 11, 36, 39)] == [0, 1, 11, 12, 13, 38, 39]
    assert sorted(map(capture.ble_rf_channel, range(40))) == list(range(40))
    with pytest.raises(ValueError, match="BLE channel"):
        capture.ble_rf_channel(255)


def test_radio_headers() -> None:
    assert capture.radiotap_header(6, 6.0, -67.6).hex() == "00000f002e000000" + "100c8509c000bc"
    assert capture.radiotap_header(149, 6.0, None).hex() == "00000e000e000000" + "100c71164001"
    assert capture.ble_radio_header(37, -67.6, coded=False, auxiliary=False).hex() == "00bc0000d6be898e130c"
    assert capture.ble_radio_header(20, None, coded=True, auxiliary=True).hex() == "16000000d6be898e918c"


def test_a_capture_is_a_chain_of_blocks() -> None:
    """draft-ietf-opsawg-pcapng: a block is type, length, body, length again; multiples of four."""
    sent = frame(Transport.WIFI_BEACON, PACK)
    sent = RidFrame(sent.header._replace(channel=6, rssi_cdbm=NO_RSSI, time_ns=7), PACK)
    raw = capture.file_header(capture.INTERFACES) + capture.reception_block(sent, 1_767_268_800 * 10**9, "forged")
    kinds, at = [], 0
    while at < len(raw):
        kind, size = struct.unpack_from("<II", raw, at)
        assert size % 4 == 0
        assert struct.unpack_from("<I", raw, at + size - 4)[0] == size
        kinds.append(kind)
        at += size
    assert kinds == [0x0A0D0D0A, 1, 1, 6]
    interface, high, low, kept, whole = struct.unpack_from("<IIIII", raw, at - size + 8)
    assert (interface, high << 32 | low, kept == whole) == (0, 1_767_268_800 * 10**9 + 7, True)
    with pytest.raises(ValueError, match="one message"):
        capture.reception_block(RidFrame(RidHeader(Transport.BT4, channel=37), PACK), 0)
