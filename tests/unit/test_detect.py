"""Detectors: what is read from observed frames, and when the heartbeat gap detector alerts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from skyrange.codec.mavlink import Packer, dialect
from skyrange.codec.remote_id import link_payload
from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrame
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.detect.heartbeat.gap import HeartbeatGap
from skyrange.detect.messages import read_messages
from skyrange.detect.receptions import read_receptions
from skyrange.radio.ground_receptions import Reception, ReceptionReport, encode
from skyrange.record import RunRecord, replay_monitor
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import run
from skyrange.testing.checks.monitors import collect_frames, serve

pytestmark = pytest.mark.rotating

PORTS = (Port("blue.gcs", "gcs:blue/b1"), Port("blue.gcs", "gcs:blue/b2"))
GAP = MonitorPlacement("gap", HeartbeatGap, ["gcs:*"], "gcs")


def heartbeat(component: int = 1, version: int = 2) -> bytes:
    if version == 2:
        return Packer(7, component).pack(dialect.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3))
    link = dialect.MAVLink(None, 7, component)
    packed: bytes = dialect.MAVLink_heartbeat_message(2, 3, 81, 5, 4, 3).pack(link, force_mavlink1=True)
    return packed


def seen(at_s: float, payload: bytes, place: int = 0, received: bool = True) -> ObservedFrame:
    port = PORTS[place]
    return ObservedFrame(port, received, from_seconds(at_s), payload, "blue/b1.companion", "blue.gcs")


def alerts(frames: Sequence[ObservedFrame], until_s: float, **params: float) -> list[tuple[float, Alert]]:
    monitor = HeartbeatGap(**params)
    ordered = sorted(frames, key=lambda frame: (frame.at, frame.port))
    found = serve(monitor, PORTS, ordered, from_seconds(until_s))
    return [(now / NS_PER_S, alert) for now, _, said in found for alert in said]


def beats(times: Sequence[float], place: int = 0, payload: bytes | None = None) -> list[ObservedFrame]:
    return [seen(at, heartbeat() if payload is None else payload, place) for at in times]


HEARD = beats(range(60), 1)
"""The second link's: never silent."""


def test_heartbeats_on_time_raise_nothing() -> None:
    assert alerts([*HEARD, *beats(range(60))], 59.0) == []
    assert alerts([*HEARD, *beats([0, 5, 10, 15, 20])], 25.0) == []


def test_a_gap_raises_one_alert_as_soon_as_the_limit_is_passed() -> None:
    ((raised_s, alert),) = alerts([*HEARD, *beats([0, 1, 2, 3.25])], 59.0)
    assert raised_s == 8.5
    assert (alert.subject, alert.kind, alert.at / NS_PER_S) == ("blue/b1", "heartbeat.gap", 8.25)
    assert alert.score == pytest.approx(5.25 / 5.0)
    assert alert.data == {"link": "gcs:blue/b1", "last_s": 3.25, "limit_s": 5.0}


def test_each_gap_raises_its_own_and_a_short_gap_over_the_limit_is_found_too() -> None:
    found = alerts([*HEARD, *beats([0, 5.1, 6, 20, 21])], 24.0)
    assert [(raised_s, alert.at / NS_PER_S) for raised_s, alert in found] == [(5.5, 5.0), (11.5, 11.0)]
    assert found[0][1].score == pytest.approx(5.1 / 5.0)


def test_a_link_that_was_never_heard_is_silent_from_the_start() -> None:
    assert [(raised_s, alert.subject) for raised_s, alert in alerts(HEARD, 20.0)] == [(5.5, "blue/b1")]


@pytest.mark.parametrize(
    "payload",
    [heartbeat(190), heartbeat()[:-1], b"\xfd", Packer(7, 1).pack(dialect.MAVLink_ping_message(0, 0, 0, 0))],
    ids=["of another component", "cut", "garbage", "another message"],
)
def test_other_frames_are_no_heartbeats(payload: bytes) -> None:
    assert len(alerts([*HEARD, *beats(range(20), 0, payload)], 20.0)) == 1
    sent = [seen(at, heartbeat(), 0, received=False) for at in range(20)]
    assert len(alerts([*HEARD, *sent], 20.0)) == 1


def test_heartbeats_of_mavlink_1_count() -> None:
    assert alerts([*HEARD, *beats(range(20), 0, heartbeat(version=1))], 20.0) == []


def test_limit_and_component_are_parameters() -> None:
    found = alerts([*beats([0, 1, 2]), *HEARD], 10.0, limit_s=2.0)
    assert [alert.at / NS_PER_S for _, alert in found] == [4.0]
    ground = [seen(at, heartbeat(190), place) for at in range(10) for place in (0, 1)]
    assert alerts(ground, 10.0, component=190) == []
    with pytest.raises(ValueError, match="limit_s"):
        HeartbeatGap(limit_s=0.1)
    assert from_seconds(1.0) >= HeartbeatGap().service_ns  # so that a gap cannot begin and end within one batch


def test_messages_are_read_by_name_in_the_order_of_frames() -> None:
    payloads = [b"", heartbeat(), heartbeat(version=1), b"x" * 20, heartbeat(2)]
    frames = collect_frames(PORTS, [seen(at, payload) for at, payload in enumerate(payloads)])
    found = read_messages(frames, "HEARTBEAT")
    assert found.rows.tolist() == [1, 2, 4]
    assert (found.systems.tolist(), found.components.tolist()) == ([7, 7, 7], [1, 1, 2])
    assert found.values["custom_mode"].tolist() == [4, 5, 4]
    assert len(read_messages(frames, "ATTITUDE").rows) == 0
    assert len(read_messages(frames.take(np.zeros(5, dtype=np.bool_)), "HEARTBEAT").rows) == 0
    with pytest.raises(InputError, match="HEARTBEAT"):
        read_messages(frames, "HEARTBEET")


def test_receptions_of_aircraft_and_ground_receivers_are_read_alike() -> None:
    ports = (Port("blue/b1.companion", "rid_down:blue/b1"), Port("blue.gcs", "oracle:blue"))
    body = bytes(range(25))
    down = link_payload.pack(link_payload.RidHeader(3, 6, 1, b"abcdef", -4_550, 90), body)
    ground = Reception(
        receiver="roof", time_ns=95, transport=1, channel=37, counter=2, rssi_dbm=-61.5, address="010203040506",
        body=body.hex(),
    )  # fmt: skip
    report = encode(ReceptionReport(body=(ground, ground.model_copy(update={"receiver": "mast"}))))
    frames = [
        ObservedFrame(ports[0], True, 100, down, "oracle", "blue/b1.companion"),
        ObservedFrame(ports[1], True, 101, report, "oracle", "blue.gcs"),
        ObservedFrame(ports[0], True, 102, b"\x1d", "oracle", "blue/b1.companion"),
        ObservedFrame(ports[1], True, 103, b"{}", "oracle", "blue.gcs"),
        ObservedFrame(ports[1], False, 104, report, "blue.gcs", "oracle"),
        ObservedFrame(ports[0], True, 105, down, "oracle", "blue/b1.companion"),
    ]
    found = read_receptions(collect_frames(ports, frames))
    assert found.rows.tolist() == [0, 1, 1, 5]
    assert [found.receivers[row] for row in found.receiver.tolist()] == ["blue/b1", "roof", "mast", "blue/b1"]
    assert found.time_ns.tolist() == [90, 95, 95, 90]
    assert found.rssi_dbm.tolist() == pytest.approx([-45.5, -61.5, -61.5, -45.5])
    assert (found.transport.tolist(), found.channel.tolist()) == ([3, 1, 1, 3], [6, 37, 37, 6])
    assert found.address[0].tobytes() == b"abcdef"
    assert list(found.bodies) == [body] * 4
    assert len(read_receptions(collect_frames(ports, [])).rows) == 0


class Cut:
    """Drops everything from `at` on."""

    def __init__(self, at: Time) -> None:
        self.at = at

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()] if now >= self.at else []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return []


def gaps(record: RunRecord) -> list[tuple[str, float]]:
    return [(row["subject"], row["at_ns"] / NS_PER_S) for row in record.table("alerts").to_pylist()]


@pytest.mark.parametrize("side", ["gcs", "companion"])
def test_a_link_that_is_cut_in_flight_is_reported_and_no_other(tmp_path: Path, side: str) -> None:
    scenario = load_scenario("squares", ["duration_s=30"])
    cut = TapPlacement("gcs:blue/b1", side, lambda link: Cut(20 * NS_PER_S))
    nominal = run(scenario, tmp_path / "nominal", monitors=[GAP])
    attacked = run(scenario, tmp_path / "attacked", taps=[cut], monitors=[GAP])
    assert gaps(nominal) == []
    ((subject, at_s),) = gaps(attacked)
    assert subject == "blue/b1"
    assert 24.0 < at_s <= 25.1
    again = [(found.alert.subject, found.alert.at / NS_PER_S) for found in replay_monitor(attacked, GAP)]
    assert again == gaps(attacked)
    assert nominal.manifest["detectors"] == [{"id": "gap", "links": ["gcs:*"], "side": "gcs"}]
