"""Motion check: drops broadcasts whose positions do not follow from each other, as of an aircraft that can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import ClassVar, Final

import skyrange.plugin as sky
from skyrange.core import elementary_python
from skyrange.core.elementary import hypot, log
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.receptions import HOUR_S, UNKNOWN_M, Claim, Finding, Held, Sender

SPEED: Final = "remote_id.speed"
JUMP: Final = "remote_id.jump"
VELOCITY: Final = "remote_id.velocity"
TWO_PLACES: Final = "remote_id.two_places"
UNKNOWN_MPS: Final = 1.0
"""Accuracy of the speed where none is said (assumed: code 3)."""
ROUNDING_MPS: Final = 0.25
"""Step of the speed up to 63.75 m/s (F3411-22a)."""
ROUNDING_RAD: Final = 0.0175
"""Step of the course: 1° (F3411-22a)."""
LATENCY_S: Final = 1.0
"""From measurement to transmission at most (14 CFR 89.310, F3411-22a): by so much times of reception may be wrong."""


@dataclass(slots=True)
class _Heard:
    """What is held of a sender."""

    first_ns: sky.Time
    last: Claim | None = None
    bad: Finding | None = None
    bad_ns: sky.Time = 0


@sky.defence(
    "remote_id.motion",
    surface=("rid_down",),
    place="the companion's end of rid_down; knows the broadcasts received",
    effect="drops broadcasts of a sender for some seconds after the finding, and of one that uses another's identity "
    "for good, so that avoidance sees no track of it",
    alerts=(SPEED, JUMP, VELOCITY, TWO_PLACES),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="claims a track that an aircraft can fly, under an identity that nobody near uses",
    cost="a comparison of two positions for each broadcast; no frame and no delay is added",
    realism={"errors of honest positions": "assumed: normal, with the accuracy that the broadcast says"},
)
class MotionCheck(BroadcastJudge):
    """Drops Remote ID of senders whose positions jump, contradict their velocity, or are at two places at once.

    It compares each Location with the one before it, and with those that other addresses send with the same id.
    """

    decides: ClassVar = "motion check"

    speed_mps: sky.Number = sky.param(
        "Largest speed over ground in m/s. 44.7 is the limit of 14 CFR 107.51(a) (100 mph).",
        default=44.7, gt=0, le=250,
    )  # fmt: skip
    acceleration_mps2: sky.Number = sky.param(
        "Largest horizontal acceleration in m/s². 9.8 is that of a multirotor that tilts by 45° in level flight "
        "(assumed as the most; ArduCopter's ANGLE_MAX is 30°).",
        default=9.8, gt=0, le=200,
    )  # fmt: skip
    false_alarm: sky.Number = sky.param(
        "Probability that two positions of an honest aircraft with normal errors are found to be a jump.",
        default=1e-6, gt=0, lt=0.05,
    )  # fmt: skip
    hold_s: sky.Number = sky.param(
        "Time in seconds for which a sender's broadcasts are dropped after the last finding; after 10 s without "
        "broadcasts a companion has forgotten the track. An address that uses the identity of another one is dropped "
        "for good.",
        default=10.0, ge=0, le=3600,
    )  # fmt: skip
    held: Held = sky.state(Held)

    def judge(self, now: sky.Time, sender: Sender, claim: Claim | None) -> Sequence[sky.Verdict]:
        """Drop a broadcast of a sender with a finding of late."""
        heard = self.held.touch(sender)
        if not isinstance(heard, _Heard):
            heard = _Heard(now)
            self.held.put(sender, heard)
        if claim is not None and claim.place is not None:
            finding = self._find(claim, heard)
            # that an identity is used twice does not end when its owner is out of reach
            if finding is not None and (heard.bad is None or heard.bad.kind != TWO_PLACES):
                heard.bad, heard.bad_ns = finding, now
            heard.last = claim
        if heard.bad is None:
            return ()
        if heard.bad.kind != TWO_PLACES and now - heard.bad_ns > sky.from_seconds(self.hold_s):
            return ()
        return self.refuse(now, sender, heard.bad)

    def _find(self, claim: Claim, heard: _Heard) -> Finding | None:
        finding = self._find_speed(claim)
        if finding is None and heard.last is not None:
            finding = self._compare(heard.last, claim)
        return finding or self._find_other(claim, heard)

    def _find_speed(self, claim: Claim) -> Finding | None:
        if claim.velocity is None:
            return None
        speed = hypot(claim.velocity[0], claim.velocity[1])
        least = speed - (claim.speed_error_mps or UNKNOWN_MPS) - ROUNDING_MPS
        if least <= self.speed_mps:
            return None
        return Finding(SPEED, speed / self.speed_mps, (("speed_mps", speed),))

    def _compare(self, old: Claim, new: Claim) -> Finding | None:
        """What is wrong with two positions that one sender claims one after another."""
        elapsed_s, error_s = elapsed(old, new)
        assert old.place is not None
        assert new.place is not None
        east_m, north_m = new.place[0] - old.place[0], new.place[1] - old.place[1]
        away_m, noise_m = hypot(east_m, north_m), self._noise_m(old, new)
        most_m = self.speed_mps * (elapsed_s + error_s) + noise_m
        if away_m > most_m:
            return Finding(JUMP, away_m / most_m, (("moved_m", away_m), ("in_s", elapsed_s)))
        if old.velocity is None or new.velocity is None:
            return None
        (u0, v0, _), (u1, v1, _) = old.velocity, new.velocity
        # an aircraft that accelerates by at most a is at most a·t²/4 from where the mean of its two velocities leads
        speed = max(hypot(u0, v0), hypot(u1, v1))
        reach_m = self.acceleration_mps2 * elementary_python.square(elapsed_s + error_s) / 4.0
        doubt_mps = (
            max(claim.speed_error_mps or UNKNOWN_MPS for claim in (old, new)) + ROUNDING_MPS + ROUNDING_RAD * speed
        )
        limit_m = noise_m + reach_m + doubt_mps * elapsed_s + speed * error_s
        off_m = hypot(east_m - 0.5 * (u0 + u1) * elapsed_s, north_m - 0.5 * (v0 + v1) * elapsed_s)
        if off_m <= limit_m:
            return None
        return Finding(VELOCITY, off_m / limit_m, (("off_m", off_m), ("in_s", elapsed_s)))

    def _noise_m(self, old: Claim, new: Claim) -> float:
        """Bound of the errors of two positions. For normal errors in the plane, r_p = r_95·√(ln p / ln 0.05)."""
        share = sqrt(log(0.5 * self.false_alarm) / log(0.05))
        return share * elementary_python.add_up(
            UNKNOWN_M if claim.horizontal_m is None else claim.horizontal_m for claim in (old, new)
        )

    def _find_other(self, claim: Claim, heard: _Heard) -> Finding | None:
        """Whether an address that was heard earlier sends the same id from a place that cannot be reached."""
        if not claim.sender.uas_id:
            return None
        stale_ns = sky.from_seconds(self.hold_s)
        for sender, other in self.held.senders.items():
            if sender == claim.sender or sender.uas_id != claim.sender.uas_id or not isinstance(other, _Heard):
                continue
            last = other.last
            if last is None or last.place is None or claim.at_ns - last.at_ns > stale_ns:
                continue
            assert claim.place is not None
            # of two that contradict each other the first one heard is believed
            if other.first_ns >= heard.first_ns:
                continue
            elapsed_s, error_s = elapsed(last, claim)
            away_m = hypot(claim.place[0] - last.place[0], claim.place[1] - last.place[1])
            most_m = self.speed_mps * (elapsed_s + error_s) + self._noise_m(last, claim)
            if away_m > most_m:
                return Finding(TWO_PLACES, away_m / most_m, (("apart_m", away_m), ("first", sender.address.hex())))
        return None


def elapsed(old: Claim, new: Claim) -> tuple[float, float]:
    """Time from one position to the other in seconds, and its error: by their timestamps if receptions agree."""
    received_s = (new.at_ns - old.at_ns) / sky.NS_PER_S
    if old.timestamp_s is not None and new.timestamp_s is not None:
        said_s = (new.timestamp_s - old.timestamp_s + 0.5 * HOUR_S) % HOUR_S - 0.5 * HOUR_S
        error_s = old.timestamp_error_s + new.timestamp_error_s
        if said_s >= 0.0 and abs(said_s - received_s) <= LATENCY_S + error_s:
            return said_s, error_s
    return max(received_s, 0.0), LATENCY_S
