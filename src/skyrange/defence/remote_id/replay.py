"""Age check: drops broadcasts with old timestamps, ones that go back in time, and copies of the aircraft's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import skyrange.plugin as sky
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.receptions import HOUR_S, Claim, Finding, Held, Sender

OLD: Final = "remote_id.old"
BACKWARD: Final = "remote_id.backward"
OWN: Final = "remote_id.own"
STALE: Final = Finding("", 0.0)
"""An old position of a sender that says itself that its system fails: an honest one goes on to broadcast its last
position (F3411-22a, status 4), so this is no sign of an attack."""
WAIT_S: Final = 0.5
"""A Wi-Fi frame waits at most so long for the channel (`radio.builtin.channel_access`)."""


@sky.defence(
    "remote_id.replay",
    surface=("rid_down",),
    place="the companion's ends of rid_down and rid_data; knows the broadcasts received, and UTC from its autopilot",
    effect="drops old broadcasts, so that avoidance sees an aircraft only where it is; without an alarm those of a "
    "sender that says that its Remote ID fails",
    alerts=(OLD, BACKWARD, OWN),
    against=("remote_id.replay",),
    evasion="repeats within two seconds, or writes new timestamps into old positions; a copy that says that its "
    "Remote ID fails is dropped without an alarm",
    cost="a comparison of two times for each broadcast; no frame and no delay is added",
    realism={"clocks": "simulated: both are those of the aircraft's navigation receivers"},
)
class AgeCheck(BroadcastJudge):
    """Drops Remote ID that is older than a position may be or than what was said before, or that has the own UAS ID.

    It compares timestamps with the own clock, and with the newest of the same UAS ID from any address.
    """

    decides: ClassVar = "age check of Remote ID"

    latency_s: sky.Number = sky.param(
        "Longest time in seconds from the measurement of a position to its broadcast: 1 s in 14 CFR 89.310 and "
        "F3411-22a.",
        default=1.0, ge=0, le=60,
    )  # fmt: skip
    clock_error_s: sky.Number = sky.param(
        "Largest error of the receiver's clock in seconds, beside that of the sender's, which the broadcast says.",
        default=0.5, ge=0, le=60,
    )  # fmt: skip
    uas_id: str
    """Of the own aircraft. A radio does not receive itself, so what it receives under this id is a copy or a lie."""
    newest: Held = sky.state(Held)
    """Of each UAS ID, by a `Sender` without an address: timestamp and accuracy of its newest Location."""
    bad: Held = sky.state(Held)
    """Findings about senders whose last Location was refused: what they send beside it is refused as well."""

    def begin(self, aircraft: sky.Aircraft) -> None:
        self.uas_id = aircraft.uas_id

    def judge(self, now: sky.Time, sender: Sender, claim: Claim | None) -> Sequence[sky.Verdict]:
        """Drop a broadcast with an old Location, and those without one of a sender whose last Location was old."""
        if sender.uas_id == self.uas_id:
            return self.refuse(now, sender, Finding(OWN, 1.0))
        if claim is not None:
            self.bad.senders.pop(sender, None)
            finding = self._find(claim)
            if finding is not None:
                self.bad.put(sender, STALE if claim.failing else finding)
        refused = self.bad.touch(sender)
        return self.refuse(now, sender, refused) if isinstance(refused, Finding) else ()

    def _find(self, claim: Claim) -> Finding | None:
        hour_s, said_s = self.own.hour_s(claim.at_ns), claim.timestamp_s
        if said_s is None:
            return None
        most_s = self.latency_s + WAIT_S + claim.timestamp_error_s
        if hour_s is not None:
            age_s, clock_s = _since(said_s, hour_s), self.clock_error_s
            if age_s > most_s + clock_s or age_s < -(claim.timestamp_error_s + clock_s):
                return Finding(OLD, max(abs(age_s) / (most_s + clock_s), 1.0), (("age_s", age_s),))
        return self._compare(claim, said_s, most_s)

    def _compare(self, claim: Claim, said_s: float, most_s: float) -> Finding | None:
        """Several transports carry copies, so a position may be as much older than the newest as it may be old."""
        if not claim.sender.uas_id:
            return None
        who = Sender(b"", claim.sender.uas_id)
        newest = self.newest.touch(who)
        behind_s = _since(said_s, newest) if isinstance(newest, float) else 0.0
        if behind_s > most_s:
            return Finding(BACKWARD, behind_s / most_s, (("behind_s", behind_s),))
        if not isinstance(newest, float) or behind_s < 0.0:
            self.newest.put(who, said_s)
        return None


def _since(earlier_s: float, later_s: float) -> float:
    """Seconds from one time of the hour to another one, from minus to plus half an hour."""
    return (later_s - earlier_s + 0.5 * HOUR_S) % HOUR_S - 0.5 * HOUR_S
