"""Base of sensor checks of GNSS fixes: an alarm about an implausible fix, which can take fixes away for some time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, cast

from skyrange.attack.bases.gnss.emitter import FIX_3D, FIX_NONE
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time, from_seconds
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.placement import Alarm, Protection

if TYPE_CHECKING:
    from skyrange.contracts.components import SensorHook

LEAST_INTERVAL_NS: Final = 100 * NS_PER_MS
"""Fixes that are closer than this are not judged; a sensor without errors has one in every tick."""
_EPOCH: Final = -(1 << 62)


@dataclass(slots=True)
class FixGuard:
    """Alarms about some aircraft, and which of them get no fix."""

    vehicles: Sequence[str]
    rejects: bool
    recover_ns: Time
    _alarms: list[Alarm] = field(init=False)
    _closed: list[bool] = field(init=False)
    _latched: list[bool] = field(init=False)
    _bad_ns: list[Time] = field(init=False)
    _told: list[bool] = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.vehicles)
        self._alarms = [Alarm(vehicle, 5 * NS_PER_S) for vehicle in self.vehicles]
        self._closed, self._latched, self._told = [False] * count, [False] * count, [False] * count
        self._bad_ns = [_EPOCH] * count

    def find(self, row: int, now: Time, kind: str, score: float, *, latch: bool = False, **data: float) -> list[Alert]:
        """Raise an alarm about an aircraft, and reject its fixes; with `latch` until `release`, however they look."""
        self._closed[row], self._bad_ns[row] = True, now
        self._latched[row] = self._latched[row] or latch
        return self._alarms[row].raise_at(now, kind, min(score, 1e6), **data)

    def tell(self, row: int, now: Time, kind: str, score: float, **data: float) -> list[Alert]:
        """Raise an alarm, and reject nothing."""
        return self._alarms[row].raise_at(now, kind, min(score, 1e6), **data)

    def clear(self, row: int, now: Time) -> None:
        """A fix was plausible: accept fixes again if they have been for long enough."""
        if self._closed[row] and not self._latched[row] and now >= self._bad_ns[row] + self.recover_ns:
            self._closed[row] = False

    def release(self, row: int) -> None:
        """Accept fixes again."""
        self._closed[row] = self._latched[row] = False

    def closed(self, row: int) -> bool:
        """Whether an alarm about the aircraft lasts."""
        return self._closed[row]

    def apply(self, sensors: Sensors) -> list[SensorAct]:
        """Take away the fixes that are rejected. Returns an act for each aircraft whose rejection begins."""
        acts: list[SensorAct] = []
        if not self.rejects:
            return acts
        for row, closed in enumerate(self._closed):
            if closed and sensors.gnss_fix[row] > FIX_NONE:
                sensors.gnss_fix[row] = FIX_NONE
                if not self._told[row]:
                    acts.append(SensorAct(self.vehicles[row], "gnss"))
            self._told[row] = closed
        return acts


def name_fixes(vehicles: Sequence[str]) -> list[str]:
    """What defences call the fixes of some aircraft that they take or need."""
    return [f"GNSS fixes of {vehicle}" for vehicle in vehicles]


@dataclass(slots=True)
class NewFixes:
    """Finds which aircraft have a new fix that is to be judged."""

    count: int
    _seen: list[Time] = field(init=False)

    def __post_init__(self) -> None:
        self._seen = [_EPOCH] * self.count

    def rows(self, sensors: Sensors) -> list[int]:
        """Rows with a new fix in three dimensions, all of whose numbers are finite."""
        new_rows = []
        for row, time in enumerate(sensors.gnss_time_ns.tolist()):
            if abs(time - self._seen[row]) < LEAST_INTERVAL_NS or sensors.gnss_fix[row] < FIX_3D:
                continue
            self._seen[row] = time
            numbers = (*sensors.gnss_enu_m[row].tolist(), *sensors.gnss_vel_enu_mps[row].tolist())
            if all(abs(number) < 1e9 for number in numbers):
                new_rows.append(row)
        return new_rows


FIXES_PER_H: Final = 5 * 3600
"""ArduPilot asks its receivers for 5 Hz (GPS_RATE_MS 200)."""


class FixCheck(Protection):
    """A sensor check that judges the fixes of its aircraft, whose rows are those of `vehicles`, in this order."""

    needs: ClassVar[tuple[str, ...]] = ("on_sensors",)
    needs_fixes: ClassVar[bool] = False
    """Whether it judges that there are fixes, so that no check before it may take them away."""

    action: Literal["reject", "alarm"] = param(
        "alarm: it raises alarms only; reject: it also makes fixes unusable (no fix), so that the autopilot fails "
        "safe.",
        default="alarm",
    )
    recover_s: Number = param(
        "Time in seconds for which fixes have to be plausible again until they are passed on; 10 as EKF3 wants before "
        "it uses a receiver (calcGpsGoodToAlign).",
        default=10.0, ge=0, le=3_600,
    )  # fmt: skip
    false_alarm_h: Number = param(
        "Mean time in hours of flight between false alarms by the noise of the sensors; it sets the gates.",
        default=1_000.0, ge=1, le=1e6,
    )  # fmt: skip
    name: str
    """The actor of its acts."""
    guard: FixGuard

    def assemble(self, context: DefenceContext) -> Any:
        """See `Acting`. Raises `InputError` for aircraft that are not in the scenario."""
        self.vehicles = tuple(self.find_protected(context))
        self.name = f"{context.id}.gnss"
        self.guard = FixGuard(self.vehicles, self.action == "reject", from_seconds(self.recover_s))
        return super().assemble(context)

    def build(self, context: DefenceContext) -> Defence:
        """Itself, as a check. With `reject` it takes fixes away from those after it."""
        fixes, check = name_fixes(self.vehicles), cast("SensorHook", self)
        return Defence(
            checks=[check], takes=fixes if self.action == "reject" else [], needs=fixes if self.needs_fixes else []
        )

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct | Alert]:
        """Judge the readings of a tick, and write into them."""
        raise NotImplementedError

    def chance(self, tests: int) -> float:
        """Chance of a false alarm that each of so many tests may have at each fix."""
        return 1.0 / (self.false_alarm_h * FIXES_PER_H * tests)
