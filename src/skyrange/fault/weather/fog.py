"""A bank of fog, which weakens the echoes of LiDARs while it lasts."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.fault.weather.passing import PassingWeather
from skyrange.optics.extinction import Weather


@sky.fault(
    "weather.fog",
    surface=("lidar",),
    effect="LiDARs lose what is far while the fog lasts",
    cause="a bank of fog or a low cloud that drifts over",
    not_modelled="light that fog scatters back, depth cameras, and the edge of the bank: it is the same everywhere",
    realism={
        "extinction": "cited: by visibility, ITU-R P.1814-1, as in a scenario's `[optics]`",
        "rise and fall": "assumed: the extinction rises and falls straight",
        "weakened echoes": "simulated: a weaker echo is returned more seldom, and with more noise",
    },
)
class Fog(PassingWeather):
    """Lets fog drift over between the start and the stop, on top of the scenario's weather."""

    vehicles: sky.Victims | None = sky.param(
        "Aircraft that it meets, such as ['blue/b1']. Default: all of the scenario.", default=None
    )
    visibility_m: sky.Number = sky.param("Visibility in metres at its densest.", default=100.0, gt=1, le=100_000)

    def weather(self) -> Weather:
        """Fog alone."""
        return Weather(visibility_m=self.visibility_m)
