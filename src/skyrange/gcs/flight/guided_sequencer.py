"""Sequencing of guided targets: each target is sent until the aircraft is near enough, then the next.

SET_POSITION_TARGET_GLOBAL_INT is not acknowledged, so the aircraft's motion shows whether it arrived: while the
aircraft comes no nearer, the target is sent again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time, from_seconds
from skyrange.gcs.plan.plans import FlightPlan

RESEND_NS = 2 * NS_PER_S
"""The target is sent again if the aircraft has come no nearer for this long."""
PROGRESS_M = 0.5
"""Smallest decrease of the distance that counts as coming nearer."""
POSITION_ONLY = 0xDF8
"""type_mask that ignores velocity, acceleration, yaw and yaw rate."""
TAKEOFF_SHARE = 0.9
"""A take-off is complete at this share of its height, or within the acceptance radius of that height."""
AIRBORNE_M = 1.0
"""An aircraft has left the ground above this height or half the take-off height, whichever is lower."""


class Target(NamedTuple):
    """A target position as MAVLink encodes it: 1e-7 degrees, and metres above home."""

    lat_e7: int
    lon_e7: int
    above_home_m: float


@dataclass(slots=True)
class GuidedSequencer:
    """The targets of one guided plan and the index `at` of the current one, -1 during take-off."""

    targets: tuple[Target, ...]
    acceptance_m: float
    north_m_per_e7: float
    east_m_per_e7: float
    hold_ns: Time = 0
    """How long the aircraft stays at the first target."""
    at: int = -1
    began_ns: Time = 0
    """When the current target was selected."""
    judged_ns: Time = 0
    nearest_m: float = math.inf

    @classmethod
    def for_plan(cls, plan: FlightPlan) -> GuidedSequencer:
        """The sequencer of a guided plan, before take-off."""
        home, origin = plan.home_enu_m, plan.origin
        lat, lon = origin.geodetic_of(home.east_m, home.north_m)
        lat2, lon2 = origin.geodetic_of(home.east_m + 1000.0, home.north_m + 1000.0)
        targets = []
        for point in plan.targets_enu_m:
            where = origin.geodetic_of(point.east_m, point.north_m)
            targets.append(Target(round(where[0] * 1e7), round(where[1] * 1e7), point.up_m - home.up_m))
        return cls(
            tuple(targets), plan.acceptance_m, 1e-4 / (lat2 - lat), 1e-4 / (lon2 - lon), from_seconds(plan.hold_s)
        )

    @property
    def takeoff_m(self) -> float:
        """Take-off height above home in metres: that of the first target."""
        return self.targets[0].above_home_m

    def distance_m(self, lat_e7: int, lon_e7: int, above_home_mm: int) -> float:
        """Distance in metres from a reported position to the target; during take-off, the height still missing."""
        above_m = above_home_mm * 1e-3
        if self.at < 0:
            return max(self.takeoff_m - above_m, 0.0)
        target = self.targets[self.at]
        north_m = (lat_e7 - target.lat_e7) * self.north_m_per_e7
        east_m = (lon_e7 - target.lon_e7) * self.east_m_per_e7
        up_m = above_m - target.above_home_m
        return math.sqrt(north_m * north_m + east_m * east_m + up_m * up_m)

    def has_left(self, above_home_mm: int) -> bool:
        """Whether a reported height shows that the aircraft has left the ground."""
        return above_home_mm * 1e-3 >= min(AIRBORNE_M, 0.5 * self.takeoff_m)

    def is_reached(self, now: Time, distance_m: float) -> bool:
        """Whether the target, or the take-off height, counts as reached at that distance."""
        if self.at == 0 and now < self.began_ns + self.hold_ns:
            return False
        near_m = max(self.acceptance_m, (1.0 - TAKEOFF_SHARE) * self.takeoff_m) if self.at < 0 else self.acceptance_m
        return distance_m <= near_m

    def advance(self, now: Time) -> bool:
        """Select the next target; returns false after the last."""
        self.at += 1
        self.began_ns = self.judged_ns = now
        self.nearest_m = math.inf
        return self.at < len(self.targets)

    def is_stuck(self, now: Time, distance_m: float) -> bool:
        """Whether the target should be sent again, because the aircraft came no nearer for `RESEND_NS`."""
        if distance_m < self.nearest_m - PROGRESS_M:
            self.nearest_m, self.judged_ns = distance_m, now
            return False
        if self.at < 0 or now - self.judged_ns < RESEND_NS:
            return False
        self.judged_ns = now
        return True

    def message(self, now: Time, system: int, component: int) -> Message:
        """The current target as SET_POSITION_TARGET_GLOBAL_INT, altitude relative to home."""
        target = self.targets[self.at]
        return mav.MAVLink_set_position_target_global_int_message(
            now // NS_PER_MS & 0xFFFFFFFF, system, component, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, POSITION_ONLY,
            target.lat_e7, target.lon_e7, target.above_home_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
