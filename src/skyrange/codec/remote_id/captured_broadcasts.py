"""Remote ID in captured packets: 802.11 frames with or without radiotap, and Bluetooth LE packets with a radio header.

Sources: radiotap.org (fields in the order of their bits, each at a multiple of its alignment); tcpdump.org,
LINKTYPE_IEEE802_11 (105), LINKTYPE_IEEE802_11_RADIOTAP (127) and LINKTYPE_BLUETOOTH_LE_LL_WITH_PHDR (256).
"""

from __future__ import annotations

from typing import Final
from zlib import crc32

from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import ANY_CHANNEL, NO_RSSI, RidFrame
from skyrange.core.errors import DecodeError

WIFI: Final = 105
RADIOTAP: Final = 127
BLE_PHDR: Final = 256
_FLAGS, _CHANNEL, _SIGNAL, _MORE = 1, 3, 5, 31
_SIZES: Final = ((8, 8), (1, 1), (1, 1), (4, 2), (2, 2), (1, 1))
"""Size and alignment of the first fields: TSFT, flags, rate, channel, FHSS, antenna signal in dBm."""
_FCS_AT_END, _BAD_FCS = 0x10, 0x40
_SIGNAL_VALID: Final = 0x0002
_CRC_CHECKED, _CRC_VALID = 0x0400, 0x0800
_CODED: Final = 2


def has_broadcasts(link_type: int) -> bool:
    """Whether packets of a link type can have Remote ID."""
    return link_type in (WIFI, RADIOTAP, BLE_PHDR)


def read_broadcast(link_type: int, data: bytes) -> RidFrame:
    """The broadcast in a packet, with channel and signal strength as far as its header says them, and time 0.

    Raises `DecodeError` for every other packet, such as other Beacons.
    """
    if link_type == BLE_PHDR:
        return _read_ble(data)
    channel, rssi_cdbm, frame, has_fcs = ANY_CHANNEL, NO_RSSI, data, False
    if link_type == RADIOTAP:
        channel, rssi_cdbm, frame, has_fcs = _read_radiotap(data)
    whole = frame if has_fcs else frame + crc32(frame).to_bytes(4, "little")
    found = wifi.decode_frame(whole)
    return RidFrame(found.header._replace(channel=channel, rssi_cdbm=rssi_cdbm), found.body)


def _read_radiotap(data: bytes) -> tuple[int, int, bytes, bool]:
    """Channel, signal strength, frame, and whether its check sequence is at its end."""
    size = int.from_bytes(data[2:4], "little")
    if len(data) < 8 or data[0] or not 8 <= size <= len(data):
        raise DecodeError("no radiotap header")
    present = int.from_bytes(data[4:8], "little")
    at, word = 8, present
    while word >> _MORE & 1 and at + 4 <= size:
        word, at = int.from_bytes(data[at : at + 4], "little"), at + 4
    channel, rssi_cdbm, flags = ANY_CHANNEL, NO_RSSI, 0
    for bit, (length, alignment) in enumerate(_SIZES):
        if not present >> bit & 1:
            continue
        at += -at % alignment
        value = data[at : at + length]
        at += length
        if at > size:
            break
        if bit == _FLAGS:
            flags = value[0]
        elif bit == _CHANNEL:
            channel = _wifi_channel(int.from_bytes(value[:2], "little"))
        elif bit == _SIGNAL:
            rssi_cdbm = 100 * int.from_bytes(value, "little", signed=True)
    if flags & _BAD_FCS:
        raise DecodeError("the receiver says that the check sequence is wrong")
    return channel, rssi_cdbm, data[size:], bool(flags & _FCS_AT_END)


def _wifi_channel(mhz: int) -> int:
    """The number of a 20 MHz channel by its centre (802.11-2016, annex E)."""
    if mhz == 2484:
        return 14
    for first, last, base in ((1, 13, 2407), (36, 177, 5000)):
        number, rest = divmod(mhz - base, 5)
        if first <= number <= last and not rest:
            return number
    return ANY_CHANNEL


def _read_ble(data: bytes) -> RidFrame:
    if len(data) < 10:
        raise DecodeError("no radio header")
    rf_channel, signal = data[0], int.from_bytes(data[1:2], "little", signed=True)
    flags = int.from_bytes(data[8:10], "little")
    if flags & _CRC_CHECKED and not flags & _CRC_VALID:
        raise DecodeError("the receiver says that the CRC is wrong")
    found = ble.decode_packet(data[10:], coded=flags >> 14 == _CODED)
    rssi_cdbm = 100 * signal if flags & _SIGNAL_VALID else NO_RSSI
    return RidFrame(found.header._replace(channel=_ble_index(rf_channel), rssi_cdbm=rssi_cdbm), found.body)


def _ble_index(rf_channel: int) -> int:
    """The channel index of an RF channel (Core 5.4, Vol 6 Part B, 1.4.1)."""
    advertising = {0: 37, 12: 38, 39: 39}
    if rf_channel > 39:
        return ANY_CHANNEL
    return advertising.get(rf_channel, rf_channel - 1 if rf_channel < 12 else rf_channel - 2)
