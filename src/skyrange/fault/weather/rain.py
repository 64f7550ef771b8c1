"""A shower of rain, which weakens the echoes of LiDARs while it lasts."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.fault.weather.passing import PassingWeather
from skyrange.optics.extinction import RainLaw, Weather


@sky.fault(
    "weather.rain",
    surface=("lidar",),
    effect="LiDARs see less far while it rains",
    cause="a shower that passes over",
    not_modelled="returns of drops, drops on the window, wet surfaces, depth cameras, and what rain does to radio and "
    "to aircraft",
    realism={
        "extinction": "cited: ITU-R P.1814-1, or Goodin et al., Electronics 8(1), 2019, which is thirty times as much",
        "rise and fall": "assumed: straight",
        "weakened echoes": "simulated: a weaker echo is returned more seldom, and with more noise",
    },
)
class Rain(PassingWeather):
    """Lets it rain between the start and the stop, on top of the scenario's weather."""

    vehicles: sky.Victims | None = sky.param(
        "Aircraft that it meets, such as ['blue/b1']. Default: all of the scenario.", default=None
    )
    rain_mmph: sky.Number = sky.param("Rain rate in mm/h.", default=25.0, gt=0, le=300)
    rain_law: RainLaw = sky.param(
        "Extinction by rain. p1814: ITU-R P.1814-1; goodin: Goodin et al. 2019, about thirty times as much.",
        default="p1814",
    )

    def weather(self) -> Weather:
        """Rain alone."""
        return Weather(rain_mmph=self.rain_mmph, rain_law=self.rain_law)
