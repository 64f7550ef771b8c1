"""Captures that tests write: MAVLink over Ethernet in pcapng and pcap, and broadcasts of Remote ID."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from skyrange.codec.capture import INTERFACES, file_header, packet_block, reception_block
from skyrange.codec.f3411 import Location, encode
from skyrange.codec.mavlink.telemetry_log import LogCounts, read_frames
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.core.time import NS_PER_S, NS_PER_US
from tests.written_logs import START_US, Moment, write_tlog

ETHERNET = 1
VEHICLE, STATION = ("10.0.0.1", 14555), ("10.0.0.9", 14550)
Socket = tuple[str, int]


def ip4(address: str) -> bytes:
    """An IPv4 address as bytes."""
    return bytes(map(int, address.split(".")))


def udp(source: Socket, target: Socket, payload: bytes) -> bytes:
    """An Ethernet frame with a datagram."""
    segment = struct.pack(">HHHH", source[1], target[1], 8 + len(payload), 0) + payload
    return ethernet(source[0], target[0], 17, segment)


def tcp(source: Socket, target: Socket, payload: bytes, sequence: int, flags: int = 0x18) -> bytes:
    """An Ethernet frame with a TCP segment."""
    head = struct.pack(">HHIIBBHHH", source[1], target[1], sequence % 2**32, 0, 5 << 4, flags, 65535, 0, 0)
    return ethernet(source[0], target[0], 6, head + payload)


def ethernet(source: str, target: str, protocol: int, segment: bytes) -> bytes:
    """An Ethernet frame with an IPv4 packet."""
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 1, 0x4000, 64, protocol, 0)
    return bytes(12) + b"\x08\x00" + head + ip4(source) + ip4(target) + segment


def logged(moments: Iterable[Moment]) -> list[tuple[int, bytes]]:
    """The frames of `write_tlog`, with their times in ns since 1970."""
    with TemporaryDirectory() as folder:
        data = write_tlog(Path(folder, "a.tlog"), moments).read_bytes()
    frames = read_frames(io.BytesIO(data), LogCounts())
    return [(time_us * NS_PER_US, frame) for time_us, frame in frames]


def packets_of(moments: Iterable[Moment]) -> Iterator[tuple[int, bytes]]:
    """Datagrams of these frames: those of system 255 to the vehicle, all others from it."""
    for time_ns, frame in logged(moments):
        system = frame[5] if frame[0] == 0xFD else frame[3]
        ends = (STATION, VEHICLE) if system == 255 else (VEHICLE, STATION)
        yield time_ns, udp(*ends, frame)


def write_pcapng(path: Path, packets: Iterable[tuple[int, bytes]], link_type: int = ETHERNET) -> Path:
    """Write packets with their times as pcapng."""
    blocks = (packet_block(0, time_ns, data) for time_ns, data in packets)
    path.write_bytes(file_header([("eth0", link_type)]) + b"".join(blocks))
    return path


def write_pcap(path: Path, packets: Iterable[tuple[int, bytes]], link_type: int = ETHERNET, order: str = "<") -> Path:
    """Write packets with their times as pcap in microseconds."""
    head = struct.pack(f"{order}IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link_type)
    records = [
        struct.pack(f"{order}IIII", time_ns // NS_PER_S, time_ns % NS_PER_S // 1000, len(data), len(data)) + data
        for time_ns, data in packets
    ]
    path.write_bytes(head + b"".join(records))
    return path


def write_mavlink_capture(path: Path, moments: Sequence[Moment]) -> Path:
    """A flight as pcapng."""
    return write_pcapng(path, packets_of(moments))


def write_old_capture(path: Path, moments: Sequence[Moment]) -> Path:
    """A flight as pcap."""
    return write_pcap(path, packets_of(moments))


def broadcast(time_ns: int, transport: Transport = Transport.WIFI_BEACON, lat_deg: float = 47.0) -> RidFrame:
    """A Location of a hovering aircraft, as it is received."""
    location = encode(Location(lat_deg=lat_deg, lon_deg=8.0, alt_geo_m=500.0, timestamp_s=time_ns / NS_PER_S % 3600.0))
    header = RidHeader(transport, channel=37 if transport == Transport.BT4 else 6, address=b"\2\0\0\0\0\1",
                       rssi_cdbm=-6100, time_ns=time_ns)  # fmt: skip
    return RidFrame(header, location)


def write_remote_id_capture(path: Path) -> Path:
    """Broadcasts that one receiver heard over Wi-Fi and Bluetooth in ten seconds."""
    interfaces = [(f"mast {kind}", link_type) for kind, link_type in INTERFACES]
    blocks = [
        reception_block(broadcast(tick * NS_PER_S // 2, transport), START_US * NS_PER_US)
        for tick in range(20)
        for transport in (Transport.WIFI_BEACON, Transport.BT4)
    ]
    path.write_bytes(file_header(interfaces) + b"".join(blocks))
    return path
