"""RADIO_STATUS of SiK radios, and how the builtin autopilot paces its streams by it."""

from __future__ import annotations

import pytest

from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Inject
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_S, Time
from skyrange.radio.control_link.interference import Interference
from skyrange.radio.control_link.sik.link import SikLink, make_conditions
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.radio.control_link.sik.radio import RadioReport, SikRadio
from skyrange.radio.control_link.sik.slots import AIRCRAFT, STATION
from skyrange.radio.control_link.sik.status import StatusReporter, heartbeat_version, pack_report, place_reporters
from skyrange.vehicle.builtin.telemetry.radio_status import next_slowdown_ms

REPORT = RadioReport(120, 110, 87, 40, 0, 513, 7)


def pack(message: mav.MAVLink_message, *, version: int = 2) -> bytes:
    return bytes(message.pack(mav.MAVLink(None, 1, 1), force_mavlink1=version == 1))


def heartbeat(version: int = 2) -> bytes:
    return pack(mav.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3), version=version)


def make_link(**params: object) -> SikLink:
    model = SikParams.model_validate(params)
    radios = SikRadio("ground", 20, model.serial_bps), SikRadio("a/1", 20, model.serial_bps)
    link = SikLink("gcs:a/1", model, 25, radios, Chance(1))
    quiet = Interference(link.noise_dbm[0]), Interference(link.noise_dbm[1])
    link.update(0, {0: make_conditions(link, -60.0, quiet)})
    return link


def show(tap: StatusReporter, now: Time, direction: str, payload: bytes) -> None:
    frame = Frame("gcs:a/1", direction, "a.gcs", 0, "a.gcs", "a/1.companion", sent_ns=now, payload=payload)
    assert not tap.on_frame(now, frame)


# ---------------------------------------------------------------- the message


@pytest.mark.parametrize("version", [1, 2])
def test_a_report_is_radio_status_from_51_68(version: int) -> None:
    payload = pack_report(REPORT, 200, version)
    assert len(payload) == 9 + {1: 8, 2: 12}[version]  # the firmware leaves zeros at the end
    message = decode(payload)
    assert isinstance(message, mav.MAVLink_radio_status_message)
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (51, 68, 200)
    named = message.rssi, message.remrssi, message.txbuf, message.noise, message.remnoise
    assert (*named, message.rxerrors, message.fixed) == (120, 110, 87, 40, 0, 513, 7)


def test_heartbeats_are_known_by_their_first_bytes() -> None:
    assert [heartbeat_version(heartbeat(version)) for version in (1, 2)] == [1, 2]
    assert heartbeat_version(pack(mav.MAVLink_ping_message(1, 2, 3, 4))) == 0
    assert heartbeat_version(heartbeat()[:9]) == 0
    assert heartbeat_version(b"") == 0


# ---------------------------------------------------------------- when it is sent


def test_a_radio_reports_once_after_each_heartbeat_of_its_computer() -> None:
    link = make_link()
    tap = StatusReporter(link, STATION)
    assert tap.next_wakeup() is None
    show(tap, NS_PER_S, "rev", heartbeat())  # of the other end
    show(tap, NS_PER_S, "fwd", pack(mav.MAVLink_ping_message(1, 2, 3, 4)))
    assert tap.next_wakeup() is None
    show(tap, NS_PER_S, "fwd", heartbeat())
    show(tap, NS_PER_S + 1, "fwd", heartbeat())
    due = tap.next_wakeup()
    assert due == NS_PER_S + (21 + 21) * link.radios[STATION].byte_ns
    (verdict,) = tap.on_wakeup(due)
    assert isinstance(verdict, Inject)
    assert (verdict.direction, verdict.src, verdict.dst) == ("rev", "ground", "a.gcs")
    assert decode(verdict.payload).get_seq() == 0
    assert tap.next_wakeup() is None
    show(tap, 2 * NS_PER_S, "fwd", heartbeat(1))
    (again,) = tap.on_wakeup(tap.next_wakeup() or 0)
    assert isinstance(again, Inject)
    assert (again.payload[0], decode(again.payload).get_seq()) == (0xFE, 1)


def test_radios_that_do_not_frame_do_not_report() -> None:
    assert place_reporters([make_link(mavlink=False)]) == []
    assert [tap.side for tap in place_reporters([make_link()])] == ["gcs", "companion"]
    narrow = StatusReporter(make_link(air_speed_kbps=4, ecc=True), AIRCRAFT)  # no packet has room for a HEARTBEAT
    show(narrow, 0, "rev", heartbeat())
    assert narrow.next_wakeup() is None


# ---------------------------------------------------------------- what the autopilot makes of it


def test_slowdown_follows_the_free_buffer_as_in_ardupilot() -> None:
    """`GCS_MAVLINK::handle_radio_status`: +60, +20, 0, -20, -40 ms by free space, from 0 to 2 s and a step."""
    assert [next_slowdown_ms(300, free) for free in (0, 19, 20, 49, 50, 90, 91, 95, 96, 100)] == [
        360, 360, 320, 320, 300, 300, 280, 280, 260, 260,
    ]  # fmt: skip
    assert [next_slowdown_ms(ms, 100) for ms in (0, 10, 20, 200, 201)] == [0, 0, 0, 180, 161]
    slowdown, steps = 0, []
    for _ in range(40):
        slowdown = next_slowdown_ms(slowdown, 5)
        steps.append(slowdown)
    assert steps[:3] == [60, 120, 180]
    assert steps[-1] == 2040  # 1980 is below 2000, so one more step
