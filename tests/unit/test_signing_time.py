"""Rules of the time of signatures: which settings of a clock count, stations that follow nobody, stored timestamps."""

from __future__ import annotations

import pytest

from skyrange.assembly.build import build
from skyrange.assembly.signing import derive_keys, derive_stored_key, read_signing_time
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import (
    MAX_LAG,
    SIGNING_TIME,
    UNIT_NS,
    ZERO_UNIX_NS,
    ClockRule,
    SignatureRefusal,
    SignedConnection,
    SignedConnections,
    Signer,
    SigningKey,
    SigningTime,
    secret_from_passphrase,
    sign_frame,
)
from skyrange.contracts.mailboxes import Outbox
from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text, to_toml

SECRET = secret_from_passphrase("correct horse")
SECOND = NS_PER_S // UNIT_NS
START = 10_000_000 * SECOND
SCENARIO = """
name = "s"
origin = [47.0, 8.0]

[[operators]]
id = "blue"
signing = "{signing}"
{time}
  [[operators.vehicles]]
  id = "b1"
  autopilot = "{autopilot}"
  plan = {{ square = {{ side_m = 20, alt_m = 10 }} }}
"""


def started(rule: ClockRule = ClockRule.EVERY_FIX, *, follows: bool = True) -> Signer:
    signer = Signer(SigningKey(SECRET, START), 0, SigningTime(rule, follows))
    signer.start(0)
    return signer


def set_clock(signer: Signer, ahead_s: int) -> int:
    """Set its clock so far ahead of the start; returns by how much the timestamp is ahead of it then, in seconds."""
    signer.set_clock(ZERO_UNIX_NS + (START // SECOND + ahead_s) * NS_PER_S)
    return (signer.timestamp - START) // SECOND


def frame(timestamp: int, link: int = 0) -> bytes:
    ping = mav.MAVLink_ping_message(0, 0, 0, 0)
    return sign_frame(Packer(255, 190).pack(ping), SECRET, link, timestamp)


def scenario(time: str = "", signing: str = "on", autopilot: str = "builtin") -> Scenario:
    return load_text(SCENARIO.format(time=time, signing=signing, autopilot=autopilot))


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        (ClockRule.EVERY_FIX, [30, 3600, 3600]),
        (ClockRule.FIRST_FIX, [30, 30, 30]),
        (ClockRule.BOUNDED, [30, 30, 80]),
        (ClockRule.NEVER, [0, 0, 0]),
    ],
)
def test_settings_of_the_clock_count_by_the_rule(rule: ClockRule, expected: list[int]) -> None:
    signer = started(rule)
    assert [set_clock(signer, ahead_s) for ahead_s in (30, 3600, 80)] == expected


def test_a_bound_of_each_setting_does_not_bound_many_of_them() -> None:
    signer = started(ClockRule.BOUNDED)
    assert [set_clock(signer, ahead_s) for ahead_s in range(50, 1001, 50)][-1] == 1000


def test_time_ahead_refuses_new_streams_and_no_known_one() -> None:
    signer = started()
    assert signer.check(frame(START)) is None
    set_clock(signer, 3600)
    assert signer.check(frame(START + 1)) is None
    assert signer.check(frame(START + 1, link=1)) is SignatureRefusal.OLD


@pytest.mark.parametrize("follows", [True, False])
def test_an_end_follows_what_it_accepts_or_its_own_clock_alone(follows: bool) -> None:
    port = Port("blue.gcs", "gcs:blue/b1")
    connection = SignedConnection("blue/b1", SigningKey(SECRET, START), port, port, time=SigningTime(follows=follows))
    ends = SignedConnections([port], [connection], 0, "note")
    ends.sign_outbox(0, Outbox())
    peer = started()
    assert ends._signers[0].check(peer.sign(Packer(1, 1).pack(mav.MAVLink_ping_message(0, 0, 0, 0)))) is None
    ahead = sign_frame(Packer(1, 1).pack(mav.MAVLink_ping_message(0, 1, 0, 0)), SECRET, 0, START + 3600 * SECOND)
    assert ends._signers[0].check(ahead) is None
    stamps = []
    for now in (NS_PER_S, NS_PER_S, 2 * NS_PER_S):
        out = Outbox()
        out.send(port, Packer(255, 190).pack(mav.MAVLink_ping_message(0, 0, 0, 0)))
        ends.sign_outbox(now, out)
        stamps.append(int.from_bytes(out.departures[0].payload[-12:-6], "little") - START)
    first = 3600 * SECOND
    assert stamps == ([first, first + 1, first + 2] if follows else [SECOND, SECOND + 1, 2 * SECOND])


def test_the_rules_are_those_of_the_operator_and_by_default_none_is_given() -> None:
    (plain,) = scenario().operators
    assert read_signing_time(plain) == read_signing_time(plain, station=True) == SIGNING_TIME
    ruled = scenario('signing_time = { aircraft = "first-fix", station = "computer", saved_ago_s = 3600 }')
    (operator,) = ruled.operators
    assert read_signing_time(operator) == SigningTime(ClockRule.FIRST_FIX)
    assert read_signing_time(operator, station=True) == SigningTime(follows=False)
    now = derive_keys(ruled, operator).aircraft
    stored = derive_stored_key(ruled, operator)
    assert now is not None
    assert stored == now._replace(initial=now.initial - 3600 * SECOND + MAX_LAG)
    assert load_text(to_toml(ruled)).operators[0].signing_time == operator.signing_time
    assert "signing_time" not in to_toml(scenario())


@pytest.mark.parametrize(
    ("time", "signing", "autopilot", "told"),
    [
        ("signing_time = {}", "off", "builtin", "signing is off"),
        ('signing_time = { aircraft = "never" }', "on", "ardupilot", "RTC_TYPES"),
        ("signing_time = { saved_ago_s = 1 }", "on", "ardupilot", "RTC_TYPES"),
    ],
)
def test_rules_that_nobody_obeys_are_refused(time: str, signing: str, autopilot: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        build(scenario(time, signing, autopilot))
