"""Emergency landings of the aircraft of one companion agent that have rules for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.range_scans import RangeScan
from skyrange.core.arrays import Floats
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.remoteid.autopilot_belief import is_fresh
from skyrange.remoteid.broadcaster import HEARTBEAT_TIMEOUT_NS, POSITION_TIMEOUT_NS
from skyrange.vehicle.landing.emergency import EmergencyLanding, LandingRules, Order, OwnState


class EmergencyLandings:
    """By row of the agent's beliefs. Deep copies continue alike."""

    def __init__(self, rules: Mapping[int, LandingRules]) -> None:
        self._landings = {row: EmergencyLanding(one) for row, one in rules.items()}

    def __bool__(self) -> bool:
        return bool(self._landings)

    def see(self, now: Time, row: int, scan: RangeScan, motion: tuple[Floats, Floats], cause: FrameId) -> None:
        """Take in a scan of an aircraft with a place and a velocity (`motion`), (3,) each."""
        landing = self._landings.get(row)
        if landing is not None:
            landing.see(now, scan, *motion, cause)

    def check(
        self, now: Time, beliefs: Any, places: Floats, velocities: Floats
    ) -> Iterator[tuple[int, Order, tuple[FrameId, ...]]]:
        """What has to be done now, for each aircraft for which something has, and the frames that caused it.

        `beliefs` is `autopilot_belief.Beliefs.table`; `places` and `velocities` are (n, 3). An aircraft that has not
        reported its position or a heartbeat lately is left alone.
        """
        rows = np.array(sorted(self._landings), dtype=np.int64)
        known = is_fresh(beliefs["position_ns"][rows], now, POSITION_TIMEOUT_NS) & is_fresh(
            beliefs["heartbeat_ns"][rows], now, HEARTBEAT_TIMEOUT_NS
        )
        for row in rows[known].tolist():
            belief = beliefs[row]
            own = OwnState(
                int(belief["mode"]),
                int(belief["heartbeat_ns"]),
                bool(belief["armed"] == 1 and belief["state"] >= mav.MAV_STATE_ACTIVE),
                float(belief["above_home_m"]),
                places[row].copy(),
                velocities[row].copy(),
            )
            landing = self._landings[row]
            order = landing.check(now, own)
            if order is not None:
                yield row, order, landing.causes
