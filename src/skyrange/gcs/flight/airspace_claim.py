"""Claim of airspace of one flight: requests to its approval, alternatives, and conformance to its volumes.

An approval that tracks intents is told when the flight is activated, when the aircraft has left its volumes for longer
than F3548 allows, when it is back, when it will not come back, and when the flight has ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from skyrange.city.city import City
from skyrange.contracts.alerts import Scalar
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import hash64, operator_of
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Epoch, Time, from_seconds, to_seconds
from skyrange.core.volumes import Volume4D, contains
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan.checks import check
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import FlightPlan, altered
from skyrange.gcs.plan.rerouting import rest_legs
from skyrange.gcs.plan.routes import enu_points, return_legs
from skyrange.gcs.plan.volumes import MARGINS, Margins, around, leg_volumes, volumes
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.intent_states import EXCURSION_NS, RECOVERY_NS, IntentState
from skyrange.utm.messages import AlternativeMessage, DecisionBody, Request, encode, encode_request

ANSWER_TIMEOUT_NS = 1_500 * NS_PER_MS
MAX_RETRIES = 5
"""Both equal the defaults of the MAVLink mission protocol, so that all retries of the station follow one rule."""


@dataclass(slots=True)
class IntentSubmission:
    """One version of an intent that awaits its decision; `due` is when it is sent (again).

    Every repetition has the same bytes, so the approval recognises it as one request.
    """

    intent: OperationalIntent
    payload: bytes
    version: int
    due: Time
    tries: int = 0
    error: str = ""
    """The error that the approval has answered last, instead of a decision."""

    @classmethod
    def of(cls, intent: OperationalIntent, version: int, due: Time, epoch: Epoch) -> IntentSubmission:
        """The submission of an intent, or of its end."""
        ends = intent.state is IntentState.ENDED
        payload = encode(Request.end(intent)) if ends else encode_request(intent, epoch, version)
        return cls(intent, payload, version, due)

    def count_attempt(self, now: Time) -> bool:
        """Count an attempt and return whether to send it now; false once all retries are used up."""
        if self.tries > MAX_RETRIES:
            return False
        self.tries += 1
        self.due = now + ANSWER_TIMEOUT_NS
        return True

    def describe_failure(self) -> str:
        """Why there is no decision, once all retries are used up."""
        if self.error:
            return f"approval: no decision after {self.tries} requests; it answers {self.error}"
        return f"approval: no answer after {self.tries} requests"

    def is_answered_by(self, decision: DecisionBody) -> bool:
        """Whether a decision is about this request."""
        if self.intent.state is IntentState.ENDED or decision.decision == "Ended":
            return self.intent.state is IntentState.ENDED and decision.decision == "Ended"
        return not decision.overruled and (decision.version or 0) == self.version

    def summary(self) -> dict[str, Scalar]:
        """The details that are recorded: intent id, number of volumes, and the time that they span."""
        claimed = self.intent.volumes
        return {
            "intent": self.intent.id,
            "volumes": len(claimed),
            "from_s": to_seconds(claimed[0].start_ns),
            "until_s": to_seconds(claimed[-1].end_ns),
        }


ROUNDS: Final = 128
"""Most requests of a flight for one approval."""
FREE_ROUNDS: Final = 64
"""From this round on the plan is only delayed: what a delayed plan claims is known exactly, so that this comes to an
end even while others claim airspace too."""
PAUSE_NS: Final = 100 * NS_PER_MS
MAX_PAUSE_NS: Final = 2 * NS_PER_S
"""Before a further request passes a part of so long a time for each earlier one, at most of the second, by chance: many
flights that are rejected at once would be rejected together again."""
_STREAM: Final = "gcs.claim.pause"
CLEARANCE_M: Final = 3.0
"""Least distance of an altered plan from walls."""
LATE_NS: Final = 5 * NS_PER_S
"""A flight that will depart later than it has claimed claims anew."""
REPORT_PAUSE_NS: Final = 10 * NS_PER_S
"""Before a state that the approval did not take is reported again."""
AWAY_M: Final = 50.0
AWAY_UP_M: Final = 20.0
"""What an aircraft outside its volumes claims around itself."""


@dataclass(slots=True)
class AirspaceClaim:
    """The operational intent of one flight, as its operator knows it."""

    epoch: Epoch
    chance: Chance
    margins: Margins = MARGINS
    city: City | None = None
    tracked: bool = False
    """Whether the approval wants to be told of further states."""
    state: IntentState | None = None
    """The state that the approval has accepted last."""
    flown: tuple[Volume4D, ...] = ()
    """The volumes in which the flight is to stay."""
    depart_ns: Time = 0
    """When it departs by them."""
    next_flown: tuple[Volume4D, ...] = ()
    """Those of another way, until the approval has accepted it."""
    version: int = 0
    rounds: int = 0
    wanted: Flight | None = None
    """The flight before it was altered, while the approval is asked for an alternative to it."""
    left_ns: Time = NEVER
    """Since when the aircraft is outside; `NEVER` while it is inside."""
    report_after_ns: Time = 0
    """When a state may be reported again after the approval has not taken one."""
    seen: tuple[float, float, float] | None = None
    """The position that the aircraft reported last: degrees, metres above the ellipsoid."""

    def request(self, flight: Flight, now: Time, state: IntentState = IntentState.ACCEPTED) -> IntentSubmission:
        """The request for `flight`, which departs at its time, or at `now` if that is later."""
        self.depart_ns = max(now, from_seconds(flight.depart_s))
        self.flown = volumes(flight.plan, self.depart_ns, self.margins)
        self.rounds += 1
        return self._submit(flight, now, state, self.flown, self._pause_ns(flight, now))

    def _pause_ns(self, flight: Flight, now: Time) -> Time:
        if self.rounds <= 2:
            return 0
        share = self.chance.uniform4(_STREAM, hash64(flight.vehicle), now, self.rounds)[0]
        return int(share * min(PAUSE_NS * self.rounds, MAX_PAUSE_NS))

    def activate(self, flight: Flight, now: Time) -> IntentSubmission:
        """The request to activate `flight`, with the volumes that were accepted unless it departs too late for them."""
        if now > self.depart_ns + LATE_NS:
            return self.request(flight, now, IntentState.ACTIVATED)
        return self._submit(flight, now, IntentState.ACTIVATED, self.flown)

    def reroute(self, flight: Flight, now: Time) -> IntentSubmission:
        """The request for the rest of a flight, a guided plan, from where the aircraft is."""
        self.next_flown = leg_volumes(
            flight.plan.origin, rest_legs(flight.plan, self.position(flight.plan)), now, self.margins
        )
        return self._submit(flight, now, IntentState.ACTIVATED, self.next_flown)

    def position(self, plan: FlightPlan) -> Point:
        """Where the aircraft is by its last report, at home if there is none."""
        if self.seen is None:
            return plan.home_enu_m
        lat, lon, above_m = self.seen
        east_m, north_m = plan.origin.enu_of(lat, lon)
        up_m = max(above_m - plan.origin.ellipsoid_of(plan.origin.alt_msl_m), 0.0)
        return Point(float(east_m), float(north_m), up_m)

    def _submit(
        self, flight: Flight, now: Time, state: IntentState, claimed: Sequence[Volume4D], pause_ns: Time = 0
    ) -> IntentSubmission:
        vehicle = flight.vehicle
        intent = OperationalIntent(intent_id(vehicle), operator_of(vehicle), vehicle, tuple(claimed), 0, state)
        submission = IntentSubmission.of(intent, self.version, now + pause_ns, self.epoch)
        self.version += 1
        return submission

    def accept(self, submission: IntentSubmission, *, tracked: bool) -> None:
        """The approval has accepted a request."""
        self.state, self.tracked = submission.intent.state, tracked
        self.rounds, self.wanted = 0, None
        if self.next_flown:
            self.flown, self.next_flown, self.left_ns = self.next_flown, (), NEVER

    # --- alternatives --------------------------------------------------------------------------------------

    def choose(self, flight: Flight, offered: Sequence[AlternativeMessage]) -> tuple[Flight, AlternativeMessage] | None:
        """The flight altered by the first alternative that can be flown, and this; `None` if there is none, or if too
        many were tried.

        The approval offers the cheapest first. If somebody else was quicker to claim an alternative, the wanted flight
        comes back, without a change: alternatives to an alternative lead farther and farther away.
        """
        if self.rounds >= ROUNDS:
            return None
        if self.wanted is not None:
            wanted, self.wanted = self.wanted, None
            return wanted, AlternativeMessage()
        for alternative in offered:
            moved = alternative.climb_m != 0.0 or alternative.east_m != 0.0 or alternative.north_m != 0.0
            if moved and self.rounds >= FREE_ROUNDS:
                continue
            plan = (
                altered(flight.plan, alternative.climb_m, alternative.east_m, alternative.north_m)
                if moved
                else flight.plan
            )
            if moved and not self._can_fly(plan):
                continue
            depart_s = to_seconds(self.depart_ns) + alternative.delay_s
            self.wanted = flight
            return replace(flight, plan=plan, depart_s=depart_s), alternative
        return None

    def _can_fly(self, plan: FlightPlan) -> bool:
        if check(plan, "alternative"):
            return False
        return self.city is None or self.city.is_clear(enu_points(plan), CLEARANCE_M)

    # --- conformance ---------------------------------------------------------------------------------------

    def observe(self, now: Time, lat: float, lon: float, up_m: float) -> IntentState | None:
        """The state that the intent is to have now that the aircraft reports this position (degrees, ellipsoid metres).

        `None` if it is the present one, or may not be reported yet.
        """
        self.seen = lat, lon, up_m
        if self.state not in (IntentState.ACTIVATED, IntentState.NONCONFORMING):
            return None
        if contains(self.flown, now, lat, lon, up_m):
            self.left_ns = NEVER
            is_back = self.state is IntentState.NONCONFORMING and now >= self.report_after_ns
            return IntentState.ACTIVATED if is_back else None
        self.left_ns = min(self.left_ns, now)
        away_ns = now - self.left_ns
        if now < self.report_after_ns:
            return None
        if self.state is IntentState.ACTIVATED:
            return IntentState.NONCONFORMING if away_ns > EXCURSION_NS else None
        return IntentState.CONTINGENT if away_ns > EXCURSION_NS + RECOVERY_NS else None

    def report(self, flight: Flight, now: Time, state: IntentState) -> IntentSubmission:
        """The report that the intent has another state; `ENDED` ends it."""
        if state is IntentState.ENDED:
            return self._submit(flight, now, state, ())
        rest = tuple(volume for volume in self.flown if volume.end_ns > now)
        origin, here = flight.plan.origin, self.position(flight.plan)
        if state is IntentState.ACTIVATED:
            return self._submit(flight, now, state, rest or (self._near(origin, here, now),))
        near = self._near(origin, here, now)
        if state is IntentState.NONCONFORMING:
            return self._submit(flight, now, state, (near, *rest))
        wide = replace(
            self.margins, horizontal_m=2.0 * self.margins.horizontal_m, vertical_m=2.0 * self.margins.vertical_m
        )
        back = leg_volumes(origin, return_legs(flight.plan, here), now, wide)
        return self._submit(flight, now, state, (near, *back))

    def _near(self, origin: Origin, here: Point, now: Time) -> Volume4D:
        return around(origin, here, AWAY_M, AWAY_UP_M, now, now + RECOVERY_NS)
