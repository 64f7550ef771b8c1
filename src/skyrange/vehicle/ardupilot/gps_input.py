"""GNSS fixes for ArduPilot: GPS_INPUT on a private port, from the receiver's readings, true or false.

AP_GPS_MAV.cpp (`handle_msg`, `GPS1_TYPE` 14) takes position, velocity, accuracies and the receiver's time; nothing
else in ArduPilot receives them. SIM_GPS1_GLTCH_* would leave the velocity unchanged, and moving the simulated aircraft
would move its barometer too. A second port with MAV2_OPTIONS 2 is private (MAVLink_routing.cpp, `is_private`), so no
byte of it appears on the link `autopilot`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import Message, dialect
from skyrange.contracts.components import Sensors
from skyrange.core.geodesy import Origin
from skyrange.core.time import GPS_LEAP_S, NS_PER_MS, NS_PER_S, Epoch, Time

GPS_EPOCH_S: Final = 315_964_800
"""1980-01-06T00:00:00Z in Unix time."""
_WEEK_S: Final = 604_800
PERIOD_NS: Final[Time] = 200 * NS_PER_MS
"""Interval of the fixes: 5 Hz, the lowest rate that ArduPilot counts as healthy (AP_GPS::is_healthy)."""
_HDOP, _VDOP = 0.8, 1.2
"""Typical of ten satellites under an open sky, which claim at most `_ACCURACY_M`."""
_ACCURACY_M = (1.5, 2.5)
_MAX_DOP = 99.99


class GnssReceivers:
    """The receivers of some aircraft: detects new fixes and encodes them. Deep-copyable."""

    def __init__(self, count: int, origin: Origin, epoch: Epoch) -> None:
        self._origin = origin
        self._epoch = epoch
        self._told: NDArray[np.int64] = np.full(count, np.iinfo(np.int64).min // 2, dtype=np.int64)
        self._seen: tuple[bytes, bytes] | None = None

    def fresh(self, sensors: Sensors) -> list[int]:
        """The aircraft that have a new fix."""
        state = sensors.gnss_time_ns.tobytes(), sensors.gnss_fix.tobytes()
        if state == self._seen:  # as in most ticks
            return []
        self._seen = state
        since = sensors.gnss_time_ns - self._told
        rows = np.flatnonzero((since >= PERIOD_NS) & (sensors.gnss_fix > 0))
        self._told[rows] = sensors.gnss_time_ns[rows]
        return [int(row) for row in rows]

    def message(self, sensors: Sensors, row: int) -> Message:
        """GPS_INPUT of one aircraft's fix."""
        east_m, north_m, up_m = sensors.gnss_enu_m[row].tolist()
        east_mps, north_mps, up_mps = sensors.gnss_vel_enu_mps[row].tolist()
        horizontal_m, vertical_m, speed_mps = sensors.gnss_accuracy[row].tolist()
        lat_deg, lon_deg = self._origin.geodetic_of(east_m, north_m)
        shown_ns = int(sensors.gnss_time_ns[row]) + int(sensors.gnss_utc_error_ns[row])
        gps_ns = max(self._epoch.unix_ns + shown_ns + (GPS_LEAP_S - GPS_EPOCH_S) * NS_PER_S, 0)
        week, within_ns = divmod(gps_ns, _WEEK_S * NS_PER_S)
        return dialect.MAVLink_gps_input_message(
            time_usec=0, gps_id=0, ignore_flags=0, time_week_ms=within_ns // NS_PER_MS, time_week=week,
            fix_type=int(sensors.gnss_fix[row]), lat=round(lat_deg * 1e7), lon=round(lon_deg * 1e7),
            alt=self._origin.alt_msl_m + up_m, hdop=_dop(_HDOP, horizontal_m, _ACCURACY_M[0]),
            vdop=_dop(_VDOP, vertical_m, _ACCURACY_M[1]), vn=north_mps, ve=east_mps, vd=-up_mps,
            speed_accuracy=speed_mps, horiz_accuracy=horizontal_m, vert_accuracy=vertical_m,
            satellites_visible=int(sensors.gnss_satellites[row]), yaw=0,
        )  # fmt: skip


def _dop(usual: float, claimed_m: float, usual_m: float) -> float:
    """The dilution of precision, larger than `usual` as far as the claimed accuracy is worse than the usual one."""
    return min(usual * max(claimed_m / usual_m, 1.0), _MAX_DOP) if claimed_m == claimed_m else _MAX_DOP
