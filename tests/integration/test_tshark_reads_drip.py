"""Does Wireshark's dissector read DRIP's pages? Headers, lengths and data of every page, over Bluetooth 4."""

from __future__ import annotations

from pathlib import Path

from skyrange.codec.capture import pcapng, remote_id_packet
from skyrange.codec.f3411 import encode
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.remoteid.drip.registry import Registry
from skyrange.remoteid.drip.schedule import Kind
from skyrange.remoteid.drip.sender import Sender
from tests.integration.test_tshark_reads_remote_id import ADDRESS, START_UTC_NS, read
from tests.tiers import needs_tshark

pytestmark = needs_tshark

T0 = 220_000_000
FIELDS = ("OpenDroneID.auth_type", "OpenDroneID.auth_page", "OpenDroneID.auth_lastpage", "OpenDroneID.auth_length")


def test_pages(tmp_path: Path) -> None:
    sender = Sender(Registry.of_seed(1, T0, T0 + 1000).register("alpha"), legacy=True)
    sender.sent(bytes.fromhex("12" + "00" * 24))
    pages = [page for kind in (Kind.HDA_UA, Kind.MANIFEST) for page in sender.make(kind, T0)]
    capture = pcapng.file_header(remote_id_packet.INTERFACES) + b"".join(
        remote_id_packet.packet_block(
            RidFrame(RidHeader(Transport.BT4, 37, 1, ADDRESS, -6000, row * 10**8), encode(page)), START_UTC_NS, ""
        )
        for row, page in enumerate(pages)
    )
    rows = read(capture, tmp_path, *FIELDS)
    assert len(rows) == len(pages)
    for row, page in zip(rows, pages, strict=True):
        assert int(row[FIELDS[0]], 0) == 5
        assert int(row[FIELDS[1]], 0) == page.page
        if page.page == 0:
            assert int(row[FIELDS[2]], 0) == page.last_page
            assert int(row[FIELDS[3]], 0) == page.length
