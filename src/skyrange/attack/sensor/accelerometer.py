"""Accelerometer injection: sound at the resonance of a MEMS accelerometer appears as acceleration."""

from __future__ import annotations

from typing import Annotated

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import SOUND_AT_AIRCRAFT, within

Accelerations = Annotated[sky.Enu, within(-160.0, 160.0, "m/s²")]
"""16 g, full scale of usual accelerometers."""


@sky.attack(
    "sensor.accelerometer",
    technique="EX-0014.03",
    surface=("accel",),
    effect="the estimated climb rate and tilt are wrong between fixes: the aircraft sinks, drifts or does not land",
    knowledge="the accelerometer's model, its resonance and its output rate",
    position="beside the aircraft: a loudspeaker at some centimetres, or one on the airframe",
    equipment="a loudspeaker and amplifier for the resonance",
    budget="sound of about 110 dB at the sensor, for as long as it acts",
    placement="the same sound on another axis or aircraft",
    realism={
        "measured acceleration": "simulated: the true one, noise, and the error",
        "resonance": "cited: 75 % of 20 models can be biased and 65 % controlled (Trippel et al., WALNUT, EuroS&P "
        "2017)",
        **SOUND_AT_AIRCRAFT,
    },
)
class Accelerometer(sky.AddsSignal):
    """Adds false acceleration to what the accelerometers measure, by sound at their resonance.

    The measured specific force has an error: constant (output biasing) or oscillating.
    """

    bias_mps2: Accelerations = sky.param(
        "Constant error along [forward, left, up] in m/s², each from -160 to 160.", default=(0.0, 0.0, 0.0)
    )
    amplitude_mps2: Accelerations = sky.param(
        "Amplitude of an oscillation along [forward, left, up] in m/s², each from -160 to 160.",
        default=(0.0, 0.0, 0.0),
    )
    frequency_hz: sky.Number = sky.param(
        "Frequency in Hz of the sampled oscillation: the alias of the sound at the sensor's output rate.",
        default=1.0, gt=0, le=200,
    )  # fmt: skip

    signal = sky.Signal("accel_mps2", constant="bias_mps2", amplitude="amplitude_mps2")
