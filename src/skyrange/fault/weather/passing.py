"""Base of weather that comes and goes, and weakens the light of LiDARs."""

from __future__ import annotations

from typing import Any, ClassVar

import skyrange.plugin as sky
from skyrange.attack.bases.light import AltersLight
from skyrange.optics.extinction import Weather, find_extinction


class PassingWeather(AltersLight):
    """Adds to the extinction of the air between its start and its stop; `weather` says how much at its height."""

    needs: ClassVar[tuple[str, ...]] = ("weather",)

    vehicles: Any = sky.param(
        "Aircraft that it meets, such as ['blue/b1']. Default: all of the scenario.", default=None
    )
    ramp_s: sky.Number = sky.param(
        "Time in seconds in which it rises after the start, and falls before the stop; 0 is at once.",
        default=10.0, ge=0, le=3_600,
    )  # fmt: skip

    def assemble(self, context: sky.FaultContext) -> sky.FaultParts:
        """See `AltersLight`; takes all aircraft, if none are named."""
        self.vehicles = tuple(sorted(context.vehicles)) if self.vehicles is None else self.vehicles
        return super().assemble(context)

    def weather(self) -> Weather:
        """At its height."""
        raise NotImplementedError

    def on_scan(self, now: sky.Time, light: sky.ScanLight) -> bool:
        """Weaken the light."""
        ends_s = [(now - self.schedule.start_ns) / sky.NS_PER_S, (self.schedule.stop_ns - now) / sky.NS_PER_S]
        share = 1.0 if self.ramp_s == 0.0 else min(*ends_s, self.ramp_s) / self.ramp_s
        light.extinction_per_m += share * find_extinction(self.weather(), light.wavelength_um)
        return True
