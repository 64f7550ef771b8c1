"""Detectors of MAVLink: what each rule finds in hand-made frames, and what it lets pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import DetectorPlugin, ObservedFrame
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.detect.mavlink.timing import find_interval, run_length
from skyrange.detect.messages import read_heads
from skyrange.detect.streams import EventCounts, StreamNumbers
from skyrange.testing.checks.monitors import collect_frames, serve

pytestmark = pytest.mark.rotating

MAVLINK_COMMANDS = DetectorPlugin.find("mavlink.commands")
MAVLINK_RATE = DetectorPlugin.find("mavlink.rate")
MAVLINK_SEQUENCE = DetectorPlugin.find("mavlink.sequence")
MAVLINK_SOURCE = DetectorPlugin.find("mavlink.source")
MAVLINK_TIMING = DetectorPlugin.find("mavlink.timing")

LINK = "gcs:blue/b1"
STATION = Port("blue.gcs", LINK)
COMPANION = Port("blue/b1.companion", LINK)
FORCE = 21196.0


class Sender:
    """One MAVLink component, seen at one end of the link."""

    def __init__(
        self, port: Port = STATION, system: int = 1, component: int = 1, src: str = "blue/b1.companion"
    ) -> None:
        self.port, self.src = port, src
        self.packer = Packer(system, component)
        self.received = True

    def send(self, at_s: float, message: Any, received: bool | None = None) -> ObservedFrame:
        arrived = self.received if received is None else received
        payload = self.packer.pack(message)
        return ObservedFrame(self.port, arrived, from_seconds(at_s), payload, self.src, "peer")


def beat(mode: int = 3, armed: bool = True) -> Any:
    return mav.MAVLink_heartbeat_message(2, 3, 81 | (128 if armed else 0), mode, 4, 3)


def attitude() -> Any:
    return mav.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)


def height(metres: float) -> Any:
    return mav.MAVLink_global_position_int_message(0, 0, 0, 0, round(metres * 1000), 0, 0, 0, 0)


def command(number: int, *values: float) -> Any:
    return mav.MAVLink_command_long_message(1, 1, number, 0, *values, *[0.0] * (7 - len(values)))


def find(plugin: DetectorPlugin, frames: Sequence[ObservedFrame], until_s: float, **params: Any) -> list[Alert]:
    ports = sorted({frame.port for frame in frames})
    ordered = sorted(frames, key=lambda frame: frame.at)
    monitor = plugin(plugin.params(**params), None)  # type: ignore[arg-type]
    return [alert for _, _, said in serve(monitor, ports, ordered, from_seconds(until_s)) for alert in said]


def kinds(alerts: Sequence[Alert]) -> list[tuple[float, str]]:
    return [(alert.at / NS_PER_S, alert.kind) for alert in alerts]


# ---------------------------------------------------------------- heads and streams


def test_heads_of_both_versions_with_their_way() -> None:
    link = mav.MAVLink(None, 9, 2)
    old = bytes(attitude().pack(link, force_mavlink1=True))
    down = Sender(COMPANION, 255, 190)
    frames = [
        Sender().send(0.0, beat()),
        ObservedFrame(STATION, True, 1, b"\xfd garbage that is long enough", "x", "y"),
        ObservedFrame(STATION, False, 2, old, "x", "y"),
        down.send(1.0, command(400)),
        down.send(1.0, beat(), received=False),
    ]
    heads = read_heads(collect_frames([STATION, COMPANION], frames))
    assert heads.rows.tolist() == [0, 2, 3, 4]
    assert heads.systems.tolist() == [1, 9, 255, 255]
    assert heads.components.tolist() == [1, 2, 190, 190]
    assert heads.messages.tolist() == [0, 30, 76, 0]
    assert heads.sequences.tolist() == [0, 0, 0, 1]
    assert heads.to_vehicle.tolist() == [False, True, True, False]
    assert len({*heads.senders.tolist()}) == 4


def test_numbers_of_streams_do_not_change() -> None:
    numbers = StreamNumbers()
    assert numbers.assign(np.array([70, 5, 70])).tolist() == [1, 0, 1]
    assert numbers.assign(np.array([6, 70, 5])).tolist() == [2, 1, 0]
    assert numbers.find(np.array([6, 1, 99])).tolist() == [2, -1, -1]
    assert len(numbers) == 3


def test_events_are_counted_until_it_is_quiet() -> None:
    counts = EventCounts(10)
    assert counts.add(np.array([1, 2, 3]), np.array([0, 1, 0])).tolist() == [1, 1, 2]
    assert counts.add(np.array([13, 13]), np.array([0, 1])).tolist() == [3, 1]


# ---------------------------------------------------------------- source


def test_an_unknown_sender_and_an_unknown_source_on_the_network() -> None:
    vehicle, stranger, other = Sender(), Sender(system=7), Sender(src="mallory")
    frames = [vehicle.send(at, beat()) for at in range(20)]
    assert find(MAVLINK_SOURCE, frames, 20) == []
    frames += [stranger.send(15.1, beat()), other.send(16.1, attitude())]
    found = find(MAVLINK_SOURCE, frames, 20)
    assert kinds(found) == [(15.1, "mavlink.source.unknown"), (16.1, "mavlink.source.endpoint")]
    assert found[0].subject == "blue/b1"
    assert found[0].data["system"] == 7
    assert kinds(find(MAVLINK_SOURCE, frames, 20, sources=[[7, 1]])) == [(16.1, "mavlink.source.endpoint")]
    assert find(MAVLINK_SOURCE, frames, 20, learn_s=18.0) == []


def test_the_score_of_a_sender_counts_its_frames() -> None:
    vehicle, stranger = Sender(), Sender(system=7)
    frames = [vehicle.send(at, beat()) for at in range(20)]
    frames += [stranger.send(12.1 + k, beat()) for k in range(5)]
    assert [alert.score for alert in find(MAVLINK_SOURCE, frames, 20)] == [1.0, 2.0, 4.0]
    assert [alert.score for alert in find(MAVLINK_SOURCE, frames, 20, report_above=3.0)] == [3.0]


def test_a_command_of_a_system_that_is_no_ground_station() -> None:
    station, vehicle = Sender(COMPANION, 255, 190), Sender(COMPANION, 8, 190)
    frames = [station.send(1.0, command(400)), vehicle.send(2.0, beat())]
    assert find(MAVLINK_SOURCE, frames, 5) == []
    frames.append(vehicle.send(3.0, command(400)))
    assert kinds(find(MAVLINK_SOURCE, frames, 5)) == [(3.0, "mavlink.source.command")]
    assert find(MAVLINK_SOURCE, frames, 5, ground_systems=[255, 8]) == []


def test_an_acknowledgement_that_nobody_asked_for() -> None:
    vehicle = Sender()
    station = Sender(STATION, 255, 190, "blue.gcs")
    ack = mav.MAVLink_command_ack_message(400, 0, 0, 0, 255, 190)
    frames = [station.send(1.0, command(400), received=False), vehicle.send(1.1, ack), vehicle.send(9.0, ack)]
    assert find(MAVLINK_SOURCE, frames, 30) == []
    frames += [
        vehicle.send(12.0, ack),  # too late
        vehicle.send(13.0, mav.MAVLink_command_ack_message(401, 0, 0, 0, 1, 191)),  # for a companion of its own
        vehicle.send(20.0, mav.MAVLink_mission_ack_message(255, 190, 0)),
        station.send(25.0, mav.MAVLink_mission_count_message(1, 1, 2), received=False),
        vehicle.send(25.5, mav.MAVLink_mission_ack_message(255, 190, 0)),
    ]
    found = find(MAVLINK_SOURCE, frames, 30)
    assert kinds(found) == [(12.0, "mavlink.source.reply"), (20.0, "mavlink.source.reply")]


# ---------------------------------------------------------------- commands


def flight(*orders: tuple[float, Any]) -> list[ObservedFrame]:
    """An aircraft that flies from 5 s to 50 s, as its companion sees it, and orders of its ground station."""
    vehicle, station = Sender(COMPANION), Sender(COMPANION, 255, 190)
    vehicle.received = False
    frames = [vehicle.send(at, beat(armed=3 <= at < 50)) for at in range(60)]
    frames += [vehicle.send(at + 0.25, height(20.0 if 5 <= at < 49 else 0.0)) for at in range(60)]
    return [*frames, *(station.send(at, message) for at, message in orders)]


@pytest.mark.parametrize(
    ("order", "score"),
    [
        (command(mav.MAV_CMD_DO_FLIGHTTERMINATION, 1.0), 4.0),
        (command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0), 2.0),
        (command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE), 4.0),
        (command(mav.MAV_CMD_DO_SET_MODE, 1.0, mav.COPTER_MODE_LOITER), 1.0),
        (mav.MAVLink_set_mode_message(1, 1, mav.COPTER_MODE_AUTO), 1.0),
        (mav.MAVLink_mission_clear_all_message(1, 1), 2.0),
        (mav.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 0.0, 2), 2.0),
        (mav.MAVLink_param_set_message(1, 1, b"WPNAV_SPEED", 0.0, 2), 1.0),
        (command(mav.MAV_CMD_DO_SET_HOME, 1.0), 1.0),
        (mav.MAVLink_command_int_message(1, 1, 0, mav.MAV_CMD_DO_FENCE_ENABLE, 0, 0, 0, 0, 0, 0, 0, 0, 0), 2.0),
    ],
)
def test_an_order_in_flight_has_its_severity_and_none_on_the_ground(order: Any, score: float) -> None:
    (alert,) = find(MAVLINK_COMMANDS, flight((30.0, order)), 60)
    assert (alert.at / NS_PER_S, alert.kind, alert.score) == (30.0, "mavlink.commands", score)
    assert find(MAVLINK_COMMANDS, flight((1.0, order), (55.0, order)), 60) == []


@pytest.mark.parametrize(
    "order",
    [
        command(mav.MAV_CMD_DO_SET_MODE, 1.0, mav.COPTER_MODE_RTL),
        command(mav.MAV_CMD_NAV_LAND),
        command(mav.MAV_CMD_DO_FENCE_ENABLE, 1.0),
        command(mav.MAV_CMD_REQUEST_MESSAGE, 33.0),
        beat(),
    ],
)
def test_usual_orders_raise_nothing(order: Any) -> None:
    assert find(MAVLINK_COMMANDS, flight((30.0, order)), 60) == []


def stick(target: int) -> Any:
    return mav.MAVLink_manual_control_message(target, 0, 0, 500, 0, 0)


def clear(target: int) -> Any:
    return mav.MAVLink_mission_clear_all_message(target, 1)


@pytest.mark.parametrize("make", [stick, clear])
def test_orders_to_other_systems_raise_nothing(make: Any) -> None:
    for target, alerts in ((1, 1), (0, 1), (251, 0), (2, 0)):
        assert len(find(MAVLINK_COMMANDS, flight((30.0, make(target))), 60)) == alerts, target


def test_a_forged_heartbeat_hides_no_order_and_all_orders_count_before_the_first() -> None:
    other = Sender(COMPANION, 7)
    other.received = False
    strange = [*flight((30.0, clear(1)), (40.0, clear(7)), (45.0, clear(8))), other.send(20.1, beat())]
    assert [at for at, _ in kinds(find(MAVLINK_COMMANDS, strange, 60))] == [30.0, 40.0]
    silent = [Sender(COMPANION, 255, 190).send(30.0, clear(8))]
    assert len(find(MAVLINK_COMMANDS, silent, 60, report_above=0.1)) == 1


def test_systems_are_those_of_each_place() -> None:
    link = "gcs:blue/b2"
    port = Port("blue/b2.companion", link)
    second, station = Sender(port, 2, src="blue/b2.companion"), Sender(port, 255, 190)
    second.received = False
    frames = [second.send(at, beat()) for at in range(60)] + [second.send(at + 0.25, height(20.0)) for at in range(60)]
    frames += [station.send(20.0, clear(1)), station.send(30.0, clear(2))]
    found = find(MAVLINK_COMMANDS, [*flight((40.0, clear(2)), (45.0, clear(1))), *frames], 60)
    assert [(at, alert.subject) for (at, _), alert in zip(kinds(found), found, strict=True)] == [
        (30.0, "blue/b2"), (45.0, "blue/b1"),
    ]  # fmt: skip


# ---------------------------------------------------------------- rate


def test_a_doubled_stream_and_a_flood() -> None:
    vehicle, second = Sender(), Sender()
    frames = [vehicle.send(at, attitude()) for at in range(60)]
    assert find(MAVLINK_RATE, frames, 60) == []
    doubled = [*frames, *(second.send(20.5 + k, attitude()) for k in range(30))]
    (alert,) = find(MAVLINK_RATE, doubled, 60)
    assert 28.0 <= alert.at / NS_PER_S <= 31.0
    assert alert.data["learned_per_s"] == 1.0
    ping = mav.MAVLink_ping_message(0, 0, 0, 0)
    slow = [second.send(20.0 + k / 5, ping) for k in range(100)]
    assert find(MAVLINK_RATE, [*frames, *slow], 60) == []
    fast = [second.send(20.0 + k / 50, ping) for k in range(500)]
    found = find(MAVLINK_RATE, [*frames, *fast], 60)
    assert {alert.data["message"] for alert in found} == {"PING"}
    assert max(alert.score for alert in found) > 2.0


def test_a_transfer_of_a_mission_is_no_flood() -> None:
    vehicle = Sender()
    request = mav.MAVLink_mission_request_int_message(255, 190, 0)
    assert find(MAVLINK_RATE, [vehicle.send(20.0 + k / 50, request) for k in range(500)], 60) == []


# ---------------------------------------------------------------- sequence


def numbered(at_s: float, number: int, message: Any = None) -> ObservedFrame:
    sender = Sender()
    sender.packer.sequence = number % 256
    return sender.send(at_s, attitude() if message is None else message)


def test_losses_late_frames_copies_and_a_restart_are_no_second_sender() -> None:
    numbers = [k for k in range(600) if k % 10 and k % 97 > 4]
    plain = [numbered(number / 10, number) for number in numbers]
    assert find(MAVLINK_SEQUENCE, plain, 70, report_above=0.01) == []
    late = [numbered(20.1 + 0.05, 200), numbered(30.3 + 0.2, 303), numbered(40.3 + 0.5, 403)]
    assert find(MAVLINK_SEQUENCE, [*plain, *late], 70, report_above=0.01) == []
    restart = [numbered(61.0 + k / 10, 150 + k) for k in range(100)]
    assert find(MAVLINK_SEQUENCE, [*plain, *restart], 75, report_above=0.01) == []


def test_two_counters_that_interleave_are_two_senders() -> None:
    first = [numbered(k / 10, k) for k in range(300)]
    second = [numbered(20.05 + k, 100 + k) for k in range(3)]
    found = find(MAVLINK_SEQUENCE, [*first, *second], 35)
    assert [alert.kind for alert in found] == ["mavlink.sequence.interleaved"] * len(found)
    assert [alert.score for alert in found] == [1.0, 3.0]
    assert found[0].at == from_seconds(20.1)


def test_one_number_with_two_contents_and_a_replay() -> None:
    first = [numbered(k / 10, k) for k in range(300)]
    (alert,) = find(MAVLINK_SEQUENCE, [*first, numbered(15.05, 151, beat())], 35)
    assert (alert.kind, alert.at) == ("mavlink.sequence.conflict", from_seconds(15.1))
    (alert,) = find(MAVLINK_SEQUENCE, [*first, numbered(15.05, 130)], 35)
    assert (alert.kind, alert.at) == ("mavlink.sequence.old", from_seconds(15.05))


# ---------------------------------------------------------------- timing


def test_run_lengths_are_those_of_the_literature() -> None:
    """One-sided charts of normal values: Montgomery, Introduction to Statistical Quality Control, has 336 and 938."""
    assert run_length(0.5, 4.0) == pytest.approx(336, rel=0.01)
    assert run_length(0.5, 5.0) == pytest.approx(938, rel=0.01)
    assert run_length(0.5, find_interval(0.5, 1e5)) == pytest.approx(1e5, rel=0.01)


def test_the_average_run_length_is_what_is_observed() -> None:
    interval = find_interval(0.5, 500.0)
    values = np.random.default_rng(7).normal(size=(2000, 4000)) - 0.5
    total, alive, lengths = np.zeros(2000), np.ones(2000, dtype=np.bool_), np.full(2000, 4000.0)
    for step in range(values.shape[1]):
        total = np.maximum(total + values[:, step], 0.0)
        ended = alive & (total >= interval)
        lengths[ended] = step + 1
        alive &= ~ended
    assert lengths.mean() == pytest.approx(500.0, rel=0.08)  # four standard errors


def stream(times: Sequence[float]) -> list[ObservedFrame]:
    vehicle = Sender()
    return [vehicle.send(at, attitude()) for at in times]


def test_regular_messages_and_single_losses_raise_nothing() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.01, size=600)
    times = [k / 2 + float(noise[k]) for k in range(600) if k % 50 != 17]
    assert find(MAVLINK_TIMING, stream(times), 300) == []
    random = np.random.default_rng(5).exponential(0.5, size=400).cumsum()
    assert find(MAVLINK_TIMING, stream(random.tolist()), 200) == []  # not periodic


@pytest.mark.parametrize(
    ("moved", "kind"),
    [
        (lambda k: 4.0, "late"),
        (lambda k: 0.03 * (k - 40), "late"),
        (lambda k: -0.1 * (k - 40), "early"),
        (lambda k: 0.2 * (k % 2), "irregular"),
    ],
    ids=["delay", "slower", "faster", "jitter"],
)
def test_delays_and_jitter_are_found(moved: Any, kind: str) -> None:
    times = [k + (moved(k) if k >= 40 else 0.0) for k in range(80)]
    found = find(MAVLINK_TIMING, stream(times), 90)
    assert found[0].kind == f"mavlink.timing.{kind}"
    assert found[0].at >= 40 * NS_PER_S
    assert found[0].data["period_s"] == pytest.approx(1.0)


def test_a_heartbeat_beside_the_regular_ones_that_reports_a_mode_is_left_out() -> None:
    vehicle = Sender()
    regular = [vehicle.send(at, beat(3)) for at in range(31)]
    extra = [vehicle.send(30.2 + k / 10, beat(4 + k)) for k in range(5)]
    rest = [vehicle.send(at, beat(8)) for at in range(31, 60)]
    assert find(MAVLINK_TIMING, [*regular, *extra, *rest], 60) == []
    same = [vehicle.send(30.2 + k / 10, beat(3)) for k in range(5)]
    assert find(MAVLINK_TIMING, [*regular, *same], 60) != []
