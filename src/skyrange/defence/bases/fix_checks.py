"""Base of sensor checks of GNSS fixes: an alarm about an implausible fix, which can take fixes away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, cast

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.core.time import Time, from_seconds
from skyrange.defence.bases.protection import Protection
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.fix_guard import FixGuard, name_fixes

if TYPE_CHECKING:
    from skyrange.contracts.components import SensorHook

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
