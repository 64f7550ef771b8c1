"""Are the tests of Remote ID plausibility right in their arithmetic, and do hostile bytes never stop them?"""

from __future__ import annotations

from math import log
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.attack.contract import GroundReceiver
from skyrange.codec.f3411 import Location, Status
from skyrange.codec.remote_id.link_payload import RidHeader, pack
from skyrange.contracts.frames import Frame
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.bases.signal_strengths import USUAL, StrengthTest, free_space_loss_db, shadowing_db
from skyrange.defence.placement import Alarm
from skyrange.defence.receptions import Claim, OwnAircraft, OwnTap, Place, Reader, Sender
from skyrange.defence.remote_id.appearance import AppearanceCheck
from skyrange.defence.remote_id.ground import GroundCheck
from skyrange.defence.remote_id.motion import JUMP, VELOCITY, MotionCheck, elapsed
from skyrange.defence.remote_id.replay import AgeCheck
from skyrange.defence.remote_id.signal import SignalCheck
from skyrange.radio.ground_receptions import Reception, ReceptionReport, encode

ORIGIN = Origin(40.778, -73.955, 20.0)
WHO = Sender(b"\xc2abcde", "SKYRF1")
LEGAL = (0.0, 36.0)


def test_loss_is_that_of_free_space() -> None:
    # ITU-R P.525-4, eq. 4: 32.4 + 20·log f (MHz) + 20·log d (km)
    assert free_space_loss_db(100.0) == pytest.approx(32.45 + 20 * np.log10(2437.0) - 20.0, abs=0.02)


def test_spread_of_fading_is_that_of_rices_distribution() -> None:
    rng = np.random.default_rng(1)
    k, n = 15.85, 200_000
    x = np.sqrt(k / (k + 1)) + rng.normal(size=n) * np.sqrt(0.5 / (k + 1))
    y = rng.normal(size=n) * np.sqrt(0.5 / (k + 1))
    assert np.std(10 * np.log10(x * x + y * y)) == pytest.approx(USUAL.fading_db, rel=0.07)


def _fly_past(rng: np.random.Generator, sends_from: Place | None, power_dbm: float, cells: int = 25) -> float:
    """Greatest evidence while a receiver flies 500 m towards a claimed place; the sender is there, or elsewhere."""
    test, claimed, most = StrengthTest(LEGAL), (0.0, 600.0, 30.0), -np.inf
    for step in range(cells):
        here = (0.0, 20.0 * step + 8.0, 30.0)
        true = claimed if sends_from is None else sends_from
        away = float(np.linalg.norm(np.subtract(true, here)))
        sigma = shadowing_db(min(true[2], here[2]))
        strength = power_dbm - free_space_loss_db(away) + rng.normal() * sigma + rng.normal() * USUAL.fading_db
        test.add("b1", here, claimed, strength)
        most = max(most, test.log_evidence)
    return most


@pytest.mark.parametrize("power_dbm", [0.0, 15.0, 36.0])
def test_honest_senders_are_rejected_no_more_often_than_stated(power_dbm: float) -> None:
    rng = np.random.default_rng(2)
    evidence = [_fly_past(rng, None, power_dbm) for _ in range(200)]
    assert np.mean(np.array(evidence) >= log(1 / 0.02)) <= 0.02 + 3 * (0.02 * 0.98 / 200) ** 0.5


def test_transmitters_elsewhere_and_powers_above_the_limit_are_rejected() -> None:
    rng = np.random.default_rng(3)
    beside_start = [_fly_past(rng, (20.0, -10.0, 2.0), 20.0) for _ in range(20)]
    too_strong = [_fly_past(rng, None, 56.0) for _ in range(20)]
    assert min(beside_start) >= log(1 / 0.001)
    assert min(too_strong) >= log(1 / 0.001)


def test_a_transmitter_at_the_claimed_place_is_believed() -> None:
    rng = np.random.default_rng(4)
    assert max(_fly_past(rng, (0.0, 605.0, 30.0), 20.0) for _ in range(20)) < log(1 / 0.001)


def _claim(second: float, north_m: float, speed: float, sender: Sender = WHO, said_s: float | None = None) -> Claim:
    at = round(second * NS_PER_S)
    said = second if said_s is None else said_s
    return Claim(sender, at, -60.0, (0.0, north_m, 30.0), (0.0, speed, 0.0), 3.0, 3.0, 0.3, said, 0.1, 30.0, False)


JudgeT = TypeVar("JudgeT", bound=BroadcastJudge)


def _tap(kind: type[JudgeT], **fields: object) -> JudgeT:
    """A tap of an aircraft that has heard nothing."""
    made = kind()
    made.vehicle, made.alarm, made.reader = "b1", Alarm("b1"), Reader(ORIGIN)
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def _kinds(judge: BroadcastJudge, own: OwnAircraft, *claims: Claim) -> list[set[str]]:
    """The kinds of alarms at each claim."""
    judge.own = own
    return [
        {getattr(verdict, "kind", "drop") for verdict in judge.judge(claim.at_ns, claim.sender, claim)}
        for claim in claims
    ]


def test_positions_follow_from_velocities() -> None:
    own = OwnAircraft(ORIGIN, 1)
    steady = _tap(MotionCheck)
    assert not any(_kinds(steady, own, *(_claim(t, 10.0 * t, 10.0) for t in range(10))))
    # from 0 to 9.8 m/s in a second, in the first moment or in the last: a·t²/4 from the mean of the velocities
    assert not any(_kinds(_tap(MotionCheck), own, _claim(0, 0, 0.0), _claim(1, 4.9, 9.8)))
    found = _kinds(_tap(MotionCheck), own, _claim(0, 0, 0.0), _claim(1, 35.0, 0.0))
    assert found == [set(), {"drop", VELOCITY}]
    found = _kinds(_tap(MotionCheck), own, _claim(0, 0, 0.0), _claim(1, 500.0, 0.0))
    assert found == [set(), {"drop", JUMP}]


def test_one_identity_is_at_one_place() -> None:
    own, judge = OwnAircraft(ORIGIN, 1), _tap(MotionCheck)
    other = Sender(b"\xc2other", WHO.uas_id)
    late = _claim(60, 300, 0.0, other)  # when the owner has not been heard for long
    found = _kinds(judge, own, _claim(0, 0, 5.0), _claim(0.5, 300, 0.0, other), _claim(1, 5, 5.0), late)
    assert found == [set(), {"drop", "remote_id.two_places"}, set(), {"drop", "remote_id.two_places"}]


def test_time_between_positions_is_that_of_their_timestamps_over_the_full_hour() -> None:
    passed_s, within_s = elapsed(_claim(0, 0, 0, said_s=3599.5), _claim(1.3, 0, 0, said_s=0.5))
    assert passed_s == pytest.approx(1.0)
    assert within_s == 0.2
    passed_s, within_s = elapsed(_claim(0, 0, 0, said_s=10.0), _claim(1.3, 0, 0, said_s=10.0 + 50))
    assert passed_s == pytest.approx(1.3)
    assert within_s == 1.0


@pytest.mark.parametrize(("age_s", "is_dropped"), [(0.3, False), (1.9, False), (4.0, True), (-2.0, True)])
def test_old_and_future_positions_are_dropped(age_s: float, is_dropped: bool) -> None:
    own = OwnAircraft(ORIGIN, 1)
    own._clock_ns = 3599 * NS_PER_S  # so that a full hour is near
    now = 2.0
    claim = _claim(now, 0, 0, said_s=(3599 + now - age_s) % 3600)
    assert bool(_kinds(_tap(AgeCheck, uas_id="SKYRFOWN"), own, claim)[0]) is is_dropped


def test_an_old_position_of_a_sender_that_says_it_fails_is_dropped_without_an_alarm() -> None:
    own, judge = OwnAircraft(ORIGIN, 1), _tap(AgeCheck, uas_id="SKYRFOWN")
    own._clock_ns = 0
    old = _claim(10.0, 0, 0, said_s=5.0)
    assert _kinds(judge, own, old._replace(failing=True), old) == [{"drop"}, {"drop", "remote_id.old"}]
    fresh = _claim(11.0, 0, 0, said_s=10.5, sender=Sender(b"\xc2other", "OTHER"))._replace(failing=True)
    assert _kinds(judge, own, fresh) == [set()]


@pytest.mark.parametrize("status", Status)
def test_a_sender_says_that_it_fails_by_its_status(status: Status) -> None:
    _, claim = Reader(ORIGIN).take(b"\xc2addr", 0, None, Location(status=status))
    assert claim is not None
    assert claim.failing is (status is Status.REMOTE_ID_SYSTEM_FAILURE)


def test_without_a_clock_positions_may_not_go_back_in_time() -> None:
    found = _kinds(
        _tap(AgeCheck, uas_id="SKYRFOWN"),
        OwnAircraft(ORIGIN, 1),
        _claim(0, 0, 0, said_s=20.0),
        _claim(1, 0, 0, said_s=5.0),
    )
    assert found == [set(), {"drop", "remote_id.backward"}]


def test_the_own_identity_is_never_received() -> None:
    judge = _tap(AgeCheck, uas_id=WHO.uas_id)
    assert _kinds(judge, OwnAircraft(ORIGIN, 1), _claim(0, 0, 0)) == [{"drop", "remote_id.own"}]


def test_the_number_of_missing_broadcasts_follows_from_the_error_rate() -> None:
    assert AppearanceCheck().broadcasts == 10  # 0.5^10 < 0.001 < 0.5^9


def _judges() -> list[BroadcastJudge]:
    return [
        _tap(SignalCheck, city=None),
        _tap(MotionCheck),
        _tap(AgeCheck, uas_id="SKYRFOWN"),
        _tap(AppearanceCheck, city=None),
    ]


def _frame(link: str, direction: str, payload: bytes) -> Frame:
    return Frame(link, direction, "x", 0, "x", "y", sent_ns=NS_PER_S, payload=payload)


BODIES = st.binary(min_size=25, max_size=25) | st.binary(max_size=240)


@given(st.lists(BODIES, max_size=6), st.binary(max_size=60), st.integers(min_value=-32768, max_value=32767))
def test_random_bytes_stop_no_tap(bodies: list[bytes], raw: bytes, rssi: int) -> None:
    own = OwnAircraft(ORIGIN, 1)
    own._at_ns, own.since_ns = NS_PER_S, 0
    own._clock_ns = 0
    OwnTap("rid_data:b1", own).on_frame(NS_PER_S, _frame("rid_data:b1", "fwd", raw))
    for tap in _judges():
        tap.own = own
        for number, body in enumerate(bodies):
            payload = pack(RidHeader(3, 6, number, b"\xc2abcde", rssi, NS_PER_S), body)
            tap.on_frame(20 * NS_PER_S, _frame("rid_down:b1", "fwd", payload))
        tap.on_frame(20 * NS_PER_S, _frame("rid_down:b1", "fwd", raw))
    receivers = {"mast": GroundReceiver("blue", (0.0, 0.0, 4.0))}
    ground = GroundCheck()
    ground.own, ground.city, ground.reader, ground.alarm = receivers, None, Reader(ORIGIN), Alarm("blue")
    heard = [
        Reception(receiver="mast", time_ns=0, transport=3, channel=6, counter=0, rssi_dbm=-60.0,
                  address="c26162636465", body=body.hex())
        for body in bodies
    ]  # fmt: skip
    ground.on_frame(NS_PER_S, _frame("oracle:blue", "rev", encode(ReceptionReport(body=tuple(heard)))))
    ground.on_frame(NS_PER_S, _frame("oracle:blue", "rev", raw))
