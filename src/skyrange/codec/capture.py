"""Capture files: pcapng blocks, and the packets in them: Remote ID as received, and UDP datagrams.

Sources: IETF draft-ietf-opsawg-pcapng (section header, interface description and enhanced packet blocks, in the
writer's byte order, here little-endian); radiotap.org (802.11, link type 127); tcpdump.org,
LINKTYPE_BLUETOOTH_LE_LL_WITH_PHDR (link type 256). Functions return bytes; the caller writes the file.

Each receiver of Remote ID has two interfaces in a capture, Wi-Fi and then Bluetooth LE: `INTERFACES`, numbered on from
its first. A packet is the 802.11 or BLE frame as transmitted, after its radio header.

Datagrams are of IPv4 (RFC 791, with its checksum) and UDP (RFC 768); skyrange sends none of them itself.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Final, NamedTuple

from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, RidHeader, Transport

RADIOTAP: Final = 127
"""Link type: radiotap header, then an 802.11 frame."""
BLE_PHDR: Final = 256
"""Link type: a 10-byte radio header, then a Bluetooth LE packet from its access address on."""
IPV4: Final = 228
"""Link type: an IPv4 datagram (`encode_datagram`) without a link-layer header."""

_BYTE_ORDER: Final = 0x1A2B3C4D
_SECTION: Final = 0x0A0D0D0A
_INTERFACE: Final = 1
_NAMES: Final = 4
_PACKET: Final = 6
_NAME_OF_IPV4: Final = 1
_NAME: Final = 2
_RESOLUTION: Final = 9
_COMMENT: Final = 1

_FCS_AT_END: Final = 0x10
_OFDM_2_4: Final = 0x00C0
_OFDM_5: Final = 0x0140
"""Channel flags: OFDM, 2.4 or 5 GHz."""
_PRESENT: Final = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 5
"""Flags, rate, channel, antenna signal (radiotap.org, defined fields)."""
_NO_SIGNAL: Final = 1 << 1 | 1 << 2 | 1 << 3

_DEWHITENED: Final = 0x0001
_SIGNAL_VALID: Final = 0x0002
_REFERENCE_VALID: Final = 0x0010
_AUXILIARY: Final = 1 << 7
"""PDU type: auxiliary advertising."""
_CRC_CHECKED: Final = 0x0400
_CRC_VALID: Final = 0x0800
_CODED_PHY: Final = 2 << 14
_ADVERTISING: Final = 0x8E89BED6


def _block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack("<II", kind, size) + body + struct.pack("<I", size)


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def file_header(interfaces: Iterable[tuple[str, int]] = ()) -> bytes:
    """The beginning of a file: the section header, and the first interfaces (name, link type), numbered from 0."""
    section = _block(_SECTION, struct.pack("<IHHq", _BYTE_ORDER, 1, 0, -1))
    return section + b"".join(interface_block(name, link_type) for name, link_type in interfaces)


def interface_block(name: str, link_type: int) -> bytes:
    """The block of the next interface; packets refer to it by its order in the file. Its timestamps
    count nanoseconds.
    """
    options = _option(_NAME, name.encode()) + _option(_RESOLUTION, b"\x09") + _option(0, b"")
    return _block(_INTERFACE, struct.pack("<HHI", link_type, 0, 0) + options)


def name_block(by_address: Mapping[int, str]) -> bytes:
    """A name resolution block for IPv4 addresses, so that readers of the file show names instead of addresses."""
    rows = [
        _option(_NAME_OF_IPV4, address.to_bytes(4, "big") + name.encode() + b"\0")
        for address, name in by_address.items()
    ]
    return _block(_NAMES, b"".join(rows) + _option(0, b""))


def packet_block(interface: int, utc_ns: int, data: bytes, comment: str = "") -> bytes:
    """One packet, captured whole on interface number `interface` at `utc_ns` (nanoseconds of Unix time, 0 or later)."""
    fixed = struct.pack("<IIIII", interface, utc_ns >> 32, utc_ns & 0xFFFFFFFF, len(data), len(data))
    options = _option(_COMMENT, comment.encode()) + _option(0, b"") if comment else b""
    return _block(_PACKET, fixed + data + bytes(-len(data) % 4) + options)


def wifi_frequency_mhz(channel: int) -> int:
    """The centre of a 20 MHz channel (802.11-2016, annex E): 1…14 at 2.4 GHz, 36…177 at 5 GHz; else `ValueError`."""
    if channel == 14:
        return 2484
    if 1 <= channel <= 13:
        return 2407 + 5 * channel
    if 36 <= channel <= 177:
        return 5000 + 5 * channel
    raise ValueError(f"Wi-Fi channel {channel}: 1…14 or 36…177")


def radiotap_header(channel: int, rate_mbps: float, signal_dbm: float | None) -> bytes:
    """The radiotap header before an 802.11 frame with its FCS; the signal in whole dB, as the format requires."""
    flags = _OFDM_5 if channel > 14 else _OFDM_2_4
    fields = struct.pack("<BBHH", _FCS_AT_END, round(rate_mbps * 2), wifi_frequency_mhz(channel), flags)
    if signal_dbm is None:
        return struct.pack("<BBHI", 0, 0, 8 + len(fields), _NO_SIGNAL) + fields
    fields += struct.pack("<b", _whole_db(signal_dbm))
    return struct.pack("<BBHI", 0, 0, 8 + len(fields), _PRESENT) + fields


def ble_rf_channel(index: int) -> int:
    """The RF channel 0…39 (2402 MHz + 2 MHz each) of a channel index 0…39 (Core 5.4, Vol 6 Part B, 1.4.1)."""
    if not 0 <= index <= 39:
        raise ValueError(f"BLE channel index {index}: 0…39")
    if index >= 37:
        return (0, 12, 39)[index - 37]
    return index + 1 if index <= 10 else index + 2


def ble_radio_header(channel: int, signal_dbm: float | None, *, coded: bool, auxiliary: bool) -> bytes:
    """The header before a BLE packet that was received whole, on channel index `channel`; the signal in whole dB."""
    flags = _DEWHITENED | _REFERENCE_VALID | _CRC_CHECKED | _CRC_VALID
    flags |= _CODED_PHY * coded | _AUXILIARY * auxiliary | _SIGNAL_VALID * (signal_dbm is not None)
    signal = 0 if signal_dbm is None else _whole_db(signal_dbm)
    return struct.pack("<BbbBIH", ble_rf_channel(channel), signal, 0, 0, _ADVERTISING, flags)


def _whole_db(signal_dbm: float) -> int:
    return min(max(round(signal_dbm), -128), 127)


_IP: Final = struct.Struct(">BBHHHBBHII")
_UDP: Final = struct.Struct(">HHHH")
_WHOLE: Final = 0x4000
"""Flags: do not fragment, which permits an identification of 0 (RFC 6864)."""
_TTL: Final = 64
_PROTOCOL: Final = 17
MAX_PAYLOAD: Final = 0xFFFF - _IP.size - _UDP.size


class SocketAddress(NamedTuple):
    """One end of a datagram: an IPv4 address as a number, and a UDP port."""

    address: int
    port: int


def encode_datagram(source: SocketAddress, target: SocketAddress, payload: bytes) -> bytes:
    """The datagram from its IPv4 header on. The UDP checksum is omitted (0). Raises `ValueError` above `MAX_PAYLOAD`
    bytes.
    """
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"{len(payload)} bytes, a datagram holds at most {MAX_PAYLOAD}")
    size = _UDP.size + len(payload)
    fields = [0x45, 0, _IP.size + size, 0, _WHOLE, _TTL, _PROTOCOL, 0, source.address, target.address]
    fields[7] = _checksum(_IP.pack(*fields))
    return _IP.pack(*fields) + _UDP.pack(source.port, target.port, size, 0) + payload


def _checksum(header: bytes) -> int:
    """One's complement of the one's complement sum of the header's 16-bit words."""
    total: int = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


INTERFACES: Final = (("wifi", RADIOTAP), ("ble", BLE_PHDR))
WIFI_RATE_MBPS: Final = 6.0
"""OFDM's lowest rate, which Beacons and NAN frames announce (`wifi.RATES`)."""
_WIFI: Final = frozenset((Transport.WIFI_BEACON, Transport.WIFI_NAN))


def reception_block(frame: RidFrame, start_utc_ns: int, comment: str = "", first: int = 0) -> bytes:
    """The pcapng block of a received broadcast, at `start_utc_ns` (Unix time of range time 0) plus its reception time.

    `first` is the number of its receiver's first interface. The header's channel must be known (not
    `link_payload.ANY_CHANNEL`). Raises `ValueError` if the transport's frame cannot hold the body, such as a message
    pack in a Bluetooth 4 advertisement, or if the channel does not exist.
    """
    header = frame.header
    signal_dbm = None if header.rssi_cdbm == NO_RSSI else header.rssi_cdbm / 100
    sent = _radio_frame(header.transport, header.counter, header.address, header.time_ns, frame.body)
    if header.transport in _WIFI:
        radio = radiotap_header(header.channel, WIFI_RATE_MBPS, signal_dbm)
    else:
        first += 1
        extended = header.transport == Transport.BT5
        radio = ble_radio_header(header.channel, signal_dbm, coded=extended, auxiliary=extended)
    return packet_block(first, start_utc_ns + header.time_ns, radio + sent, comment)


@lru_cache(maxsize=1024)
def _radio_frame(transport: int, counter: int, address: bytes, time_ns: int, body: bytes) -> bytes:
    """Cached, because all receivers of one transmission follow each other."""
    frame = RidFrame(RidHeader(transport, counter=counter, address=address, time_ns=time_ns), body)
    match Transport(transport):
        case Transport.WIFI_BEACON:
            return wifi.encode_beacon(frame, timestamp_us=max(time_ns // 1000, 0))
        case Transport.WIFI_NAN:
            return wifi.encode_nan_action(frame)
        case Transport.BT4:
            return ble.encode_legacy(frame)
        case Transport.BT5:
            return ble.encode_auxiliary(frame)
