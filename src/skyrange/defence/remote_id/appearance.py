"""Appearance check: drops new senders that claim to be near in the air, where they would have been heard before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import ceil
from typing import ClassVar, Final

import skyrange.plugin as sky
from skyrange.core import elementary_python
from skyrange.core.elementary import log
from skyrange.defence.bases.signal_strengths import SignalJudge, channel_of, free_space_loss_db
from skyrange.defence.receptions import Claim, Finding, Held, Sender
from skyrange.defence.remote_id.signal import ErrorRate, is_in_sight

KIND: Final = "remote_id.appearance"
SENSITIVITY_DBM: Final = -92.0
"""Wi-Fi OFDM at 6 Mb/s with a noise figure of 7 dB (docs: Radio, Channel access and reception)."""
MARGIN: Final = 2.33
"""Standard deviations of shadowing and fading that a signal in reach has to spare: 99 % of signals are decoded."""
TAKE_OFF_M: Final = 15.0
"""An aircraft that is heard first below this height above its take-off or the ground has just taken off: at 1 Hz and
several metres a second it is not heard sooner, and one radio that starts late has as many seconds (assumed)."""


@sky.defence(
    "remote_id.appearance",
    surface=("rid_down",),
    place="the companion's ends of rid_down and rid_data; knows the broadcasts received, its own aircraft's position, "
    "and a map of the buildings",
    effect="drops the sender's broadcasts for a time, so that avoidance sees no track of it",
    alerts=(KIND,),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="lets its ghost take off, or come from out of reach or from behind a building; or waits",
    cost="about ten lines of sight for each new sender; no frame and no delay is added",
    realism={
        "reach": "simulated",
        "power of honest aircraft": "assumed: at least power_dbm",
        "building map": "assumed: the receiver has the range's own",
    },
)
class AppearanceCheck(SignalJudge):
    """Drops Remote ID of senders that appear near, in sight and in the air, without having been heard on their way.

    It decides once about each UAS ID, when its first Location is received.
    """

    decides: ClassVar = "appearance check"

    power_dbm: sky.Number = sky.param(
        "Power (EIRP) in dBm that every honest aircraft has at least; with it the reach follows from the model of "
        "signals (assumed: modules have 10 to 20 dBm).",
        default=10.0, ge=-30, le=50,
    )  # fmt: skip
    miss: ErrorRate = sky.param(
        "Largest share of an aircraft's broadcasts within reach that is lost, to collisions and traffic.", default=0.5
    )
    false_alarm: ErrorRate = sky.param(
        "Probability that all broadcasts that should have been heard were lost.", default=0.001
    )
    hold_s: sky.Number = sky.param(
        "Time in seconds for which a sender that appears so is not believed. A transmitter that was switched on in "
        "flight is believed after it.",
        default=60.0, ge=0, le=86_400,
    )  # fmt: skip
    known: Held = sky.state(Held)
    """By `Sender` without an address if it has an id: the finding and when it ends, or True."""

    @property
    def broadcasts(self) -> int:
        """How many broadcasts must be missing: miss to this power is the false-alarm probability."""
        return ceil(log(self.false_alarm) / log(self.miss))

    def judge(self, now: sky.Time, sender: Sender, claim: Claim | None) -> Sequence[sky.Verdict]:
        """Drop the broadcasts of a sender that appeared where it should have been heard before."""
        who = Sender(b"", sender.uas_id) if sender.uas_id else sender
        state = self.known.touch(who)
        if state is None:
            if claim is None:
                return ()
            new_finding = self._find(now, claim)
            state = True if new_finding is None else (new_finding, now + sky.from_seconds(self.hold_s))
            self.known.put(who, state)
        if not isinstance(state, tuple):
            return ()
        finding, until = state
        return self.refuse(now, sender, finding) if now < until else ()

    def _find(self, now: sky.Time, claim: Claim) -> Finding | None:
        missing = self.broadcasts
        if (
            self.own.since_ns < 0 or now - self.own.since_ns < missing * sky.NS_PER_S
        ):  # it has not listened for long enough
            return None
        if claim.place is None or claim.velocity is None or claim.grounded:
            return None
        if claim.height_m is not None and claim.height_m < TAKE_OFF_M:
            return None
        for second in range(1, missing + 1):  # each element is broadcast at least once a second (14 CFR 89.310)
            here = self.own.place_at(now - second * sky.NS_PER_S)
            x, y, z = (p - v * second for p, v in zip(claim.place, claim.velocity, strict=True))
            if here is None or not self._in_reach(here, (x, y, z)):
                return None
        away_m = elementary_python.distance(claim.place, self.own.place_at(now) or claim.place)
        return Finding(KIND, 1.0, (("away_m", away_m), ("missing", float(missing))))

    def _in_reach(self, here: tuple[float, float, float], claimed: tuple[float, float, float]) -> bool:
        if claimed[2] < TAKE_OFF_M:
            return False
        channel = channel_of(self)
        spread = math.sqrt(
            elementary_python.square(channel.shadowing_db(min(here[2], claimed[2])))
            + (channel.fading_db * channel.fading_db)
        )
        strength = self.power_dbm - free_space_loss_db(elementary_python.distance(here, claimed))
        return strength >= SENSITIVITY_DBM + MARGIN * spread and is_in_sight(self.city, here, claimed)
