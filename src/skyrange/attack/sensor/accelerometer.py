"""Accelerometer injection: sound at the resonance of a MEMS accelerometer appears as acceleration."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import SOUND_AT_AIRCRAFT, Accelerations, AddsSound


@sky.attack(
    "sensor.accelerometer",
    surface=("accel",),
    effect="the estimated climb rate and tilt are wrong between fixes: the aircraft sinks, drifts or does not land",
    knowledge="the accelerometer's model, its resonance and its output rate",
    position="beside the aircraft: a loudspeaker at some centimetres, or one on the airframe",
    budget="sound of about 110 dB at the sensor, for as long as it acts",
    placement="the same sound on another axis or aircraft",
    realism={
        "measured acceleration": "simulated: the true one, noise, and the error",
        "resonance": "cited: 75 % of 20 models can be biased and 65 % controlled (Trippel et al., WALNUT, EuroS&P "
        "2017)",
        **SOUND_AT_AIRCRAFT,
    },
)
class Accelerometer(AddsSound):
    """Adds false acceleration to what the accelerometers measure, by sound at their resonance."""

    bias_mps2: Accelerations = sky.param(
        "Constant error (output biasing) [forward, left, up] in m/s², each from -160 to 160.", default=(0.0, 0.0, 0.0)
    )
    amplitude_mps2: Accelerations = sky.param(
        "Amplitude of an oscillation [forward, left, up] in m/s², each from -160 to 160.", default=(0.0, 0.0, 0.0)
    )
    frequency_hz: sky.Number = sky.param(
        "Sampled frequency in Hz: the alias of the sound at the sensor's output rate.", default=1.0, gt=0, le=200
    )

    signal = sky.Signal("accel_mps2", constant="bias_mps2", amplitude="amplitude_mps2")
