"""Encoders of Remote ID that no program needs: announcements over the air, and pages without parity."""

from __future__ import annotations

from typing import Final

from skyrange.codec.f3411 import Authentication
from skyrange.codec.f3411.encode import PAGE_0_DATA, PAGE_DATA
from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import RidFrame

MAX_DATA: Final = 255
"""Bytes of authentication data: their length has 8 bits."""
_POINTER: Final = 0x10
"""Extended header flag of AuxPtr (Bluetooth Core 5.4 vol. 6 part B 2.3.4.5)."""
_CODED: Final = 2
"""AUX PHY of the pointer: LE Coded."""
_MASTER: Final = 0x00
_CLUSTER: Final = 0x01
_SERVICE_LIST: Final = 0x02
_PREFERENCE: Final = 0xFE
_RANDOM_FACTOR: Final = 0xEA
"""Master preference and random factor that the European standard recommends, according to wifi.c."""
_NAN_INTERVAL_TU: Final = 512


def encode_pointer(frame: RidFrame, *, channel: int, offset_us: int, set_id: int = 0) -> bytes:
    """ADV_EXT_IND for the coded PHY on a primary channel, which announces when and where `ble.encode_auxiliary(frame)`
    follows.

    `channel` is the index 0…36 of the secondary channel. `offset_us` is the time from the start of this packet to the
    start of the announced one, 300…2,457,299 us; it is rounded down to units of 30 us, and from 245,700 us to units of
    300 us. Raises `ValueError` for values outside these ranges.
    """
    if not (0 <= channel <= 36 and 300 <= offset_us < 300 << 13):
        raise ValueError(f"channel {channel}, offset {offset_us} us: 0…36, 300…2457299 us")
    coarse = offset_us >= 245_700
    steps = offset_us // (300 if coarse else 30)
    aux = channel | coarse << 7 | steps << 8 | _CODED << 21  # bit 6, clock accuracy: 51…500 ppm
    extended = bytes([ble._DATA_INFO | _POINTER]) + ble._data_info(frame, set_id) + aux.to_bytes(3, "little")
    return (
        ble.ACCESS_ADDRESS
        + bytes([ble.S8])
        + ble._pdu_with_crc(ble.ADV_EXT_IND, bytes([len(extended)]) + extended, random=False)
    )


def encode_nan_sync_beacon(address: bytes, *, timestamp_us: int = 0, sequence: int = 0) -> bytes:
    """The synchronisation Beacon that a NAN device sends immediately before its action frame, so
    that others find it.
    """
    attributes = (
        wifi._attribute(_MASTER, bytes([_PREFERENCE, _RANDOM_FACTOR]))
        + wifi._attribute(_CLUSTER, address + bytes([_RANDOM_FACTOR, _PREFERENCE]) + bytes(5))
        + wifi._attribute(_SERVICE_LIST, wifi.SERVICE_ID)
    )
    return wifi._with_fcs(
        wifi._head(wifi.BEACON, wifi.BROADCAST, address, wifi.NAN_CLUSTER, sequence)
        + wifi._BEACON.pack(timestamp_us, _NAN_INTERVAL_TU, wifi.CAPABILITY)
        + bytes([wifi.VENDOR, len(wifi.WFA_NAN) + len(attributes)]) + wifi.WFA_NAN + attributes
    )  # fmt: skip


def split_pages(auth_type: int, data: bytes, timestamp_s: int) -> tuple[Authentication, ...]:
    """The messages that carry `data` (0…255 bytes, else `ValueError`); `timestamp_s` since `EPOCH_2019_S`."""
    if len(data) > MAX_DATA:
        raise ValueError(f"{len(data)} bytes of authentication data, at most {MAX_DATA}")
    rest = range(PAGE_0_DATA, len(data), PAGE_DATA)
    first = Authentication(
        auth_type, 0, data[:PAGE_0_DATA].ljust(PAGE_0_DATA, b"\0"), len(rest), len(data), timestamp_s
    )
    return first, *(
        Authentication(auth_type, page, data[at : at + PAGE_DATA].ljust(PAGE_DATA, b"\0"))
        for page, at in enumerate(rest, start=1)
    )
