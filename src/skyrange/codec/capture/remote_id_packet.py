"""Capture packets of Remote ID receptions: the 802.11 or BLE frame as transmitted, after its radio header.

Each receiver has two interfaces in a capture, Wi-Fi and then Bluetooth LE: `INTERFACES`, numbered on from its first.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from skyrange.codec.capture import pcapng
from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, RidHeader, Transport

INTERFACES: Final = (("wifi", pcapng.RADIOTAP), ("ble", pcapng.BLE_PHDR))
WIFI_RATE_MBPS: Final = 6.0
"""OFDM's lowest rate, which Beacons and NAN frames announce (`wifi.RATES`)."""
_WIFI: Final = frozenset((Transport.WIFI_BEACON, Transport.WIFI_NAN))


def packet_block(frame: RidFrame, start_utc_ns: int, comment: str = "", first: int = 0) -> bytes:
    """The pcapng block of a received broadcast, at `start_utc_ns` (Unix time of range time 0) plus its reception time.

    `first` is the number of its receiver's first interface. The header's channel must be known (not
    `link_payload.ANY_CHANNEL`). Raises `ValueError` if the transport's frame cannot hold the body, such as a message
    pack in a Bluetooth 4 advertisement, or if the channel does not exist.
    """
    header = frame.header
    signal_dbm = None if header.rssi_cdbm == NO_RSSI else header.rssi_cdbm / 100
    sent = _radio_frame(header.transport, header.counter, header.address, header.time_ns, frame.body)
    if header.transport in _WIFI:
        radio = pcapng.radiotap_header(header.channel, WIFI_RATE_MBPS, signal_dbm)
    else:
        first += 1
        extended = header.transport == Transport.BT5
        radio = pcapng.ble_radio_header(header.channel, signal_dbm, coded=extended, auxiliary=extended)
    return pcapng.packet_block(first, start_utc_ns + header.time_ns, radio + sent, comment)


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
