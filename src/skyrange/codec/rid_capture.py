"""Which packet does a capture show for a Remote ID reception? The frame as it was in the air, under its radio header.

Interface 0 of such a capture is Wi-Fi, interface 1 Bluetooth LE; `pcapng.head(INTERFACES)` begins the file.
"""

from __future__ import annotations

from typing import Final

from skyrange.codec import ble, pcapng, wifi
from skyrange.codec.rid_link import NO_RSSI, RidFrame, Transport

INTERFACES: Final = (("wifi", pcapng.RADIOTAP), ("ble", pcapng.BLE_PHDR))
WIFI_RATE_MBPS: Final = 6.0
"""OFDM's lowest, at which Beacons and NAN frames announce themselves (`wifi.RATES`)."""


def packet(frame: RidFrame, start_utc_ns: int, comment: str = "") -> bytes:
    """The pcapng block of a broadcast that was received, at `start_utc_ns` (Unix time of range time 0) plus its time.

    The header's channel must be known (not `rid_link.ANY_CHANNEL`). `ValueError` where the transport's frame cannot
    hold the body, as of a message pack in a Bluetooth 4 advertisement, or where there is no such channel.
    """
    header = frame.header
    signal_dbm = None if header.rssi_cdbm == NO_RSSI else header.rssi_cdbm / 100
    transport = Transport(header.transport)
    if transport in (Transport.WIFI_BEACON, Transport.WIFI_NAN):
        interface = 0
        radio = pcapng.radiotap(header.channel, WIFI_RATE_MBPS, signal_dbm)
        if transport == Transport.WIFI_BEACON:
            sent = wifi.beacon(frame, timestamp_us=max(header.time_ns // 1000, 0))
        else:
            sent = wifi.nan_action(frame)
    else:
        interface = 1
        extended = transport == Transport.BT5
        radio = pcapng.ble_phdr(header.channel, signal_dbm, coded=extended, auxiliary=extended)
        sent = ble.auxiliary(frame) if extended else ble.legacy(frame)
    return pcapng.packet(interface, start_utc_ns + header.time_ns, radio + sent, comment)
