"""Every shipped detector keeps the contract of monitors, with the parameters that its kind has by default."""

from __future__ import annotations

import pytest

from skyrange.codec import f3411
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.monitors import DetectorPlugin
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S
from skyrange.radio.ground_receptions import Reception, ReceptionReport, encode
from skyrange.testing import check_monitor
from skyrange.testing.drivers.hostile_input import forged

HEARTBEAT_GAP = DetectorPlugin.find("heartbeat.gap")
MAVLINK_COMMANDS = DetectorPlugin.find("mavlink.commands")
MAVLINK_RATE = DetectorPlugin.find("mavlink.rate")
MAVLINK_SEQUENCE = DetectorPlugin.find("mavlink.sequence")
MAVLINK_SOURCE = DetectorPlugin.find("mavlink.source")
MAVLINK_TIMING = DetectorPlugin.find("mavlink.timing")
REMOTE_ID_PLAUSIBILITY = DetectorPlugin.find("remote_id.plausibility")

KINDS = {
    "heartbeat.gap": HEARTBEAT_GAP,
    "mavlink.commands": MAVLINK_COMMANDS,
    "mavlink.rate": MAVLINK_RATE,
    "mavlink.sequence": MAVLINK_SEQUENCE,
    "mavlink.source": MAVLINK_SOURCE,
    "mavlink.timing": MAVLINK_TIMING,
}


@pytest.mark.catalogue
@pytest.mark.parametrize("kind", KINDS)
def test_detector_of_mavlink(kind: str) -> None:
    check_monitor(KINDS[kind], payloads=list(forged())[::5], name=kind)


@pytest.mark.catalogue
@pytest.mark.parametrize("plugin", [MAVLINK_RATE, MAVLINK_SOURCE, MAVLINK_TIMING], ids=["rate", "source", "timing"])
def test_detector_that_has_learned(plugin: DetectorPlugin) -> None:
    """Most of the frames come after the time to learn, and the lowest score raises alerts."""
    learned = {"learn_s": 5.0, "report_above": 0.001}
    ports = (Port("blue.gcs", "gcs:blue/b1"), Port("blue/b1.companion", "gcs:blue/b1"))
    check_monitor(plugin, learned, ports=ports, payloads=list(forged())[::7] * 2, until=20 * NS_PER_S)


def receptions() -> list[bytes]:
    """Broadcasts as an aircraft and as a ground station gets them, some of them hostile."""
    places = [f3411.Location(lat_deg=40.778 + step, lon_deg=-73.955, alt_geo_m=10.0) for step in (0.0, 0.0001, 0.5)]
    messages: list[f3411.Message] = [f3411.BasicId(uas_id="SKYR1", id_type=1, ua_type=2), *places]
    bodies = [*(f3411.encode(message) for message in messages), bytes(25), b"\xff" * 25]
    found = []
    for number, body in enumerate(bodies * 6):
        header = link_payload.RidHeader(number % 4 + 1, 6, 1, b"abcdef", -5000, number * NS_PER_S // 4)
        one = Reception(
            receiver="mast", time_ns=header.time_ns, transport=1, channel=37, counter=0, rssi_dbm=-61.5,
            address="616263646566", body=body.hex(),
        )  # fmt: skip
        found += [link_payload.pack(header, body), encode(ReceptionReport(body=(one,)))]
    return found


def test_detector_of_remote_id() -> None:
    ports = (
        Port("blue.gcs", "oracle:blue"),
        Port("blue/b1.companion", "rid_data:blue/b1"),
        Port("blue/b1.companion", "rid_down:blue/b1"),
    )
    params = {"report_above": 0.001, "receivers": {"mast": [0.0, 0.0, 10.0]}, "calibration": 1}
    payloads = [*receptions(), *list(forged())[::40]]
    check_monitor(REMOTE_ID_PLAUSIBILITY, params, ports=ports, payloads=payloads)
