"""What MAVLink attacks make of a flight: two aircraft fly squares, and the first is attacked."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.codec.mavlink import decode, message_name
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.testing.checks.attacks import AttackCase, Flight, two_squares
from skyrange.vehicle.builtin.parameters.table import ALWAYS_LISTED

pytestmark = pytest.mark.rotating

COMMAND = AttackPlugin.find("mavlink.command")
EXFILTRATE = AttackPlugin.find("mavlink.exfiltrate")
FENCE = AttackPlugin.find("mavlink.fence")
GUIDED = AttackPlugin.find("mavlink.guided")
FILE_READ = AttackPlugin.find("mavlink.file_read")
FILE_WRITE = AttackPlugin.find("mavlink.file_write")
HOME = AttackPlugin.find("mavlink.home")
MISSION_ALTER = AttackPlugin.find("mavlink.mission_alter")
MISSION_CLEAR = AttackPlugin.find("mavlink.mission_clear")
MISSION_REPLACE = AttackPlugin.find("mavlink.mission_replace")
MODE = AttackPlugin.find("mavlink.mode")
PARAMETER = AttackPlugin.find("mavlink.parameter")
RC_OVERRIDE = AttackPlugin.find("mavlink.rc_override")

START_S = 9.0
"""When the square is flown, after the take-off."""


def flown(kind: AttackPlugin, params: dict[str, Any], duration_s: float, start_s: float, **how: bool) -> Flight:
    params = {"vehicles": ["blue/b1"], **params}
    times = from_seconds(start_s), from_seconds(duration_s)
    return AttackCase(kind, params, two_squares(duration_s), *times, True).fly(**how)


def noted(flight: Flight, kind: str, *parts: str, since_s: float = 0.0) -> bool:
    """Whether something was noted about the attacked aircraft."""
    rows = [row for row in flight.notes() if row[2] == kind and row[3] == "blue/b1" and row[0] >= since_s * NS_PER_S]
    return any(all(part in row[4] for part in parts) for row in rows)


def track(flight: Flight) -> Any:
    """East and north of the attacked aircraft over time, (n, 2) m."""
    return np.array([[t.columns["east_m"][0], t.columns["north_m"][0]] for t in flight.seen.truth])


NOTED: list[tuple[AttackPlugin, dict[str, Any], str, tuple[str, ...]]] = [
    (COMMAND, {"command": "DO_FLIGHTTERMINATION", "values": [1]}, "event.disarmed", ("termination",)),
    (COMMAND, {"command": "COMPONENT_ARM_DISARM", "values": [0, 21196]}, "event.disarmed", ("forced",)),
    (COMMAND, {"command": "DO_SET_MODE", "values": [1, 9], "sender": "own"}, "event.mode", ("LAND", "gcs_command")),
    (MODE, {"mode": "BRAKE"}, "event.mode", ("BRAKE",)),
    (GUIDED, {"track": [[60, 0, 10]]}, "event.mode", ("GUIDED",)),
    (RC_OVERRIDE, {"forward": 1}, "event.mode", ("LOITER",)),
    (MISSION_REPLACE, {"track": [[60, 0, 10], [60, 9, 10]]}, "event.mission", ("'items': 4",)),
    (MISSION_CLEAR, {}, "event.mission", ("'items': 0",)),
    (HOME, {"at": [60, 0, 0], "point": "rally"}, "event.rally", ("'items': 1",)),
    (FENCE, {"form": "move", "at": [300, 0, 0]}, "event.mode", ("LAND", "fence_breached")),
    (PARAMETER, {"values": {"RTL_ALT": 9000}}, "event.parameter", ("RTL_ALT", "9000")),
    (FILE_WRITE, {"values": {"RTL_ALT": 9000}}, "event.parameter", ("RTL_ALT", "9000")),
    (FILE_WRITE, {"track": [[60, 0, 10], [60, 9, 10]]}, "event.mission", ("items",)),
    (FILE_WRITE, {"path": "/APM/scripts/a.lua", "text": "x" * 500}, "event.file", ("a.lua", "'bytes': 500")),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "note", "parts"), NOTED, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(NOTED)]
)
def test_the_autopilot_obeys(kind: AttackPlugin, params: dict[str, Any], note: str, parts: tuple[str, ...]) -> None:
    assert noted(flown(kind, params, 12.0, START_S), note, *parts, since_s=START_S)
    assert not noted(flown(kind, params, 12.0, START_S, sham=True), note, *parts, since_s=START_S)


HARMLESS: list[tuple[AttackPlugin, dict[str, Any], set[str]]] = [
    (COMMAND, {"command": "DO_FLIGHTTERMINATION", "values": [1]}, {"COMMAND_ACK", "HEARTBEAT"}),
    (COMMAND, {"command": "DO_SET_HOME", "at": [60, 0, 0]}, {"COMMAND_ACK", "HEARTBEAT"}),
    (MODE, {"mode": "LAND"}, {"COMMAND_ACK", "HEARTBEAT"}),
    (RC_OVERRIDE, {"mode": "none", "yaw": 1}, set()),
    (RC_OVERRIDE, {"mode": "none", "yaw": 1, "message": "MANUAL_CONTROL"}, set()),
    (MISSION_CLEAR, {}, {"MISSION_ITEM_INT"}),
    (MISSION_CLEAR, {"by": "MISSION_CLEAR_ALL"}, {"MISSION_COUNT"}),
    (HOME, {"at": [60, 0, 0], "point": "rally"}, {"MISSION_COUNT", "MISSION_ACK"}),  # of an item that is not there
    (PARAMETER, {"values": {"RTL_ALT": 9000}}, set()),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params", "answers"), HARMLESS)
def test_an_aircraft_answers_a_sham_and_flies_on(kind: AttackPlugin, params: dict[str, Any], answers: set[str]) -> None:
    sham, nominal = (flown(kind, params, 11.0, START_S, **{how: True}) for how in ("sham", "muted"))
    assert np.array_equal(track(sham), track(nominal))
    names = []
    for flight in (sham, nominal):
        rows = (f.payload for f in flight.seen.frames if f.link == "gcs:blue/b1" and f.direction == "rev")
        names.append(Counter(message_name(payload) for payload in rows))
    assert set(names[0] - names[1]) == answers
    acks = [decode(f.payload) for f in sham.seen.frames if message_name(f.payload) == "COMMAND_ACK"]
    assert {ack.result for ack in acks} == {mav.MAV_RESULT_ACCEPTED}
    assert {label.action for label in sham.seen.labels} == {"inject"}


def test_a_running_mission_is_not_cleared_but_an_empty_one_is_uploaded() -> None:
    """AP_Mission::clear refuses while armed and running; AP_Mission::truncate does not."""
    assert not noted(flown(MISSION_CLEAR, {"by": "MISSION_CLEAR_ALL"}, 12.0, START_S), "event.mission", "'items': 0")
    stopped = track(flown(MISSION_CLEAR, {}, 16.0, START_S))[-20:]
    assert np.ptp(stopped, axis=0).max() < 0.5


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (GUIDED, {"track": [[60, 0, 10]]}),
        (MISSION_REPLACE, {"track": [[60, 0, 10]], "end": "hold"}),
        (FILE_WRITE, {"track": [[60, 0, 10]]}),
        (HOME, {"at": [60, 0, 0], "then_rtl": True}),
        (RC_OVERRIDE, {"right": 0.3, "forward": 0.0}),
    ],
)
def test_the_aircraft_flies_east(kind: AttackPlugin, params: dict[str, Any]) -> None:
    """The square is 10 m wide; the places are 60 m east of the start. The aircraft heads north, so right is east."""
    start_s = START_S if kind is not HOME else 12.0
    live, sham = (track(flown(kind, params, 26.0, start_s, sham=each)) for each in (False, True))
    assert live[:, 0].max() > 40.0
    assert sham[:, 0].max() < 12.0


def test_the_altered_mission_is_flown_and_the_operator_sees_its_own() -> None:
    flight = flown(MISSION_ALTER, {"offset_m": [40, 0, 0]}, 25.0, 0.0)
    assert noted(flight, "decision.verified")
    assert not noted(flight, "decision.failed")
    assert track(flight)[:, 0].max() > 35.0


def test_files_are_stolen_in_flight_and_altered_without_a_word_to_the_operator() -> None:
    """The log that is being written is among them; LOG_REQUEST_LIST is refused in flight."""
    live, muted = (flown(FILE_READ, {"sender": "own"}, 14.0, START_S, muted=each) for each in (False, True))
    learnt = [row[4] for row in live.notes() if row[2] == "event.learned"]
    files = [text for text in learnt if "'what': 'file'" in text]
    assert [name for name in ("param.pck", "mission.dat", "00000001.BIN", "LASTLOG.TXT") if name in str(files)] == [
        "param.pck", "mission.dat", "00000001.BIN", "LASTLOG.TXT"
    ]  # fmt: skip
    assert sum("'what': 'parameters'" in text for text in learnt) == len(ALWAYS_LISTED)
    assert not [row for row in muted.notes() if row[2] == "event.learned"]
    altered = flown(FILE_WRITE, {"values": {"RTL_ALT": 9000}}, 14.0, START_S)
    assert noted(altered, "event.parameter", "RTL_ALT", "9000", since_s=START_S)
    names = [message_name(f.payload) for f in altered.seen.frames if f.link == "gcs:blue/b1" and f.direction == "rev"]
    assert names.count("PARAM_VALUE") == 0


def test_the_aircraft_answers_whoever_requests() -> None:
    params = {"what": ["parameters", "mission"], "sender": "own", "every_s": 60}
    live, muted = (flown(EXFILTRATE, params, 14.0, START_S, muted=each) for each in (False, True))
    counts = []
    for flight in (live, muted):
        names = [
            message_name(f.payload) for f in flight.seen.frames if f.link == "gcs:blue/b1" and f.direction == "rev"
        ]
        counts.append((names.count("PARAM_VALUE"), names.count("MISSION_ITEM_INT")))
    assert counts[0][0] == len(ALWAYS_LISTED)
    assert counts[1][0] == 0
    items = counts[0][1] - counts[1][1]
    assert items >= 7, "all of the mission, beside the operator's own read-back"
    assert min(label.at_ns for label in live.seen.labels) == round(START_S * NS_PER_S)
