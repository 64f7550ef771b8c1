"""Compass injection: a magnetic field beside the sensor turns the measured heading."""

from __future__ import annotations

from typing import Annotated

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import within

Fields = Annotated[sky.Enu, within(-10.0, 10.0, "gauss")]


@sky.attack(
    "sensor.compass",
    surface=("compass",),
    effect="the heading is wrong, so that corrections go the wrong way and the aircraft circles away",
    knowledge="for a field that passes the estimator's gate: the strength of the Earth's field",
    position="at the sensor: a magnet or coil on the airframe; a coil of 1 m radius at some metres",
    equipment="a permanent magnet or an electromagnet",
    budget="a field that falls with the third power of the distance",
    placement="the same field on another aircraft",
    realism={
        "measured field": "simulated: the Earth's field in the body, noise, and the added field",
        "saturation of the sensor": "assumed: none up to 10 gauss",
        "compass of ArduPilot": "simulated: by ArduPilot, from the true attitude, which this attack does not reach",
        "field at the sensor": "assumed: constant in the body, as of a magnet on the airframe",
    },
)
class Compass(sky.AddsSignal):
    """Adds a magnetic field to the one that the compass measures."""

    field_gauss: Fields = sky.param(
        "Added field [forward, left, up] in gauss, each -10 to 10; the Earth's is 0.2 to 0.7.", default=(0.0, 0.0, 0.0)
    )
    amplitude_gauss: Fields = sky.param(
        "Amplitude of an oscillating field [forward, left, up] in gauss, each -10 to 10.", default=(0.0, 0.0, 0.0)
    )
    frequency_hz: sky.Number = sky.param("Frequency of the oscillating field in Hz.", default=0.2, gt=0, le=5)

    signal = sky.Signal("compass_gauss", constant="field_gauss", amplitude="amplitude_gauss")
