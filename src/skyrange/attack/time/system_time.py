"""False time in telemetry: UTC in SYSTEM_TIME, and the autopilot's clock in its answers to TIMESYNC."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "time.system_time",
    technique="EX-0014.01",
    surface=("rid_data", "log", "gcs", "autopilot"),
    effect="Remote ID broadcasts have wrong time stamps, and logs of a ground station a wrong time",
    knowledge="the messages with the time",
    realism={"time of signed frames": "simulated: it comes from each end's own clock and does not shift"},
)
class FalseTime(sky.AlteredTelemetry):
    """Shifts the time in SYSTEM_TIME and TIMESYNC of an autopilot.

    The reported time is ahead of the true one, or behind it. The time since boot in other messages stays true.
    """

    offset_s: sky.Number = sky.param("Offset of the time at the start, in seconds.", default=0.0, ge=-1e9, le=1e9)
    drift_s_per_s: sky.Number = sky.param("Growth of the offset, in seconds per second.", default=0.0, ge=-100, le=100)
    sees = ("SYSTEM_TIME", "TIMESYNC")

    def find_problems(self) -> sky.Problems:
        if not (self.offset_s or self.drift_s_per_s):
            yield sky.Problem("offset_s", "0", "an offset or a drift other than 0")

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        shift_ns = round((self.offset_s + self.drift_s_per_s * since_ns / sky.NS_PER_S) * sky.NS_PER_S)
        name, shift = ("time_unix_usec", shift_ns // sky.NS_PER_US) if message == "SYSTEM_TIME" else ("tc1", shift_ns)
        if fields[name] == 0:  # UTC is not known, or the message is a request
            return False
        sky.put(fields, name, int(fields[name]) + shift)
        return True
