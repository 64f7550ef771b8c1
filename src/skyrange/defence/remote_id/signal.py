"""Signal strength check: drops the broadcasts of a sender whose signal does not come from where it says it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final

from pydantic import AfterValidator, BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.core import elementary_python
from skyrange.core.elementary import hypot, log
from skyrange.defence.bases.signal_strengths import WAVELENGTH_M, SignalJudge, StrengthTest, channel_of
from skyrange.defence.receptions import UNKNOWN_M, Claim, Finding, Held, Place, Sender

KIND: Final = "remote_id.signal"


def _in_order(limits: tuple[float, ...]) -> tuple[float, ...]:
    if len(limits) != 2 or not limits[0] <= limits[1]:
        raise sky.refuse(sky.Problem("", repr(list(limits)), "the least and the greatest power, such as [0, 20]"))
    return limits


PowerLimits = Annotated[
    tuple[sky.Number, ...],
    BeforeValidator(sky.items, json_schema_input_type=list[float]),
    AfterValidator(_in_order),
]
ErrorRate = Annotated[sky.Number, Field(gt=0, lt=1)]


@sky.defence(
    "remote_id.signal",
    surface=("rid_down",),
    place="the companion's ends of rid_down and rid_data; knows broadcasts with signal strength, its own aircraft's "
    "position, and a map of the buildings",
    effect="drops all broadcasts of a rejected sender, so that avoidance sees no track of it",
    alerts=(KIND,),
    against=("remote_id.spoof", "remote_id.replay", "remote_id.signed_ghost"),
    evasion="transmits from near the claimed place, or far away on the line through it with the power that fits",
    cost="a test of about 600 hypotheses for each broadcast received; no frame and no delay is added",
    realism={
        "signal strength": "simulated",
        "antennas": "assumed: isotropic, which strengths at low elevation come near to",
        "building map": "assumed: the receiver has the range's own, unless map_shift_m or map_missing say otherwise",
    },
)
class SignalCheck(SignalJudge):
    """Drops Remote ID of senders whose signal strength does not fit the position that they claim.

    There is a strength test for every sender that an aircraft hears.
    """

    decides: ClassVar = "signal strength test"

    legal_dbm: PowerLimits = sky.param(
        "Least and greatest power (EIRP) of honest aircraft in dBm. 36 is the limit in the USA (47 CFR 15.247(b), 1 W "
        "and 6 dBi), 20 in Europe (EN 300 328); the least is assumed.",
        default=(0.0, 36.0),
    )
    false_alarm: ErrorRate = sky.param(
        "Largest probability that an honest sender in sight is ever rejected by one receiver.", default=0.001
    )
    held: Held = sky.state(Held)

    def judge(self, now: sky.Time, sender: Sender, claim: Claim | None) -> Sequence[sky.Verdict]:
        """Add the strength to the sender's test, and drop the broadcast while the claim is rejected."""
        test = self.held.touch(sender)
        if not isinstance(test, StrengthTest):
            test = StrengthTest((self.legal_dbm[0], self.legal_dbm[1]), channel_of(self))
            self.held.put(sender, test)
        if claim is not None:
            self._add(test, self.own.place_at(now), claim)
        score = test.log_evidence / -log(self.false_alarm)
        if score < 1.0:
            return ()
        data: list[tuple[str, str | float]] = [("power_dbm", test.power_dbm), ("cells", float(test.cells))]
        place = test.likely_place
        if place is not None:
            data += [("east_m", place[0]), ("north_m", place[1])]
        return self.refuse(now, sender, Finding(KIND, score, tuple(data)))

    def _add(self, test: StrengthTest, here: Place | None, claim: Claim) -> None:
        claimed_place, heard_dbm = claim.place, claim.rssi_dbm
        if here is None or claimed_place is None or heard_dbm is None:
            return
        # the line between two positions is off by no more than they are; the own one is taken to be as good
        if is_usable(self.city, here, claimed_place, doubt_m(claim)):
            test.add(self.vehicle, here, claimed_place, heard_dbm)


def is_usable(city: sky.City | None, a: Place, b: Place, off_m: float) -> bool:
    """Whether the model of signals in sight holds between two places: in sight, and below 45° of elevation.

    In sight no building comes within 0.6 of the radius √(λ·d)/2 of the first Fresnel zone: then there is no loss by
    diffraction (ITU-R P.526-15, 4.1). `off_m` is how far the line may be off, because positions have errors. Towards
    above and below, antennas of aircraft have nulls: a half-wave dipole has 4 dB less at 45° than horizontally
    (Balanis, 4-84).
    """
    return abs(a[2] - b[2]) <= hypot(a[0] - b[0], a[1] - b[1]) and is_in_sight(city, a, b, off_m)


def is_in_sight(city: sky.City | None, a: Place, b: Place, off_m: float = 0.0) -> bool:
    """Whether no building is in the way, nor within 0.6 of the first Fresnel zone and `off_m` on top."""
    clear_m = 0.3 * math.sqrt(WAVELENGTH_M * elementary_python.distance(a, b))
    return city is None or city.is_clear([a, b], clear_m + off_m)


def doubt_m(claim: Claim) -> float:
    """A distance that the error of a claimed position hardly exceeds: twice its 95 % radius.

    For normal errors in the plane it is exceeded with a probability of 0.05⁴.
    """
    return 2.0 * (UNKNOWN_M if claim.horizontal_m is None else claim.horizontal_m)
