"""Accelerometer injection: sound at the resonance of a MEMS accelerometer appears as acceleration."""

from __future__ import annotations

from typing import Annotated

from skyrange.attack.bases.sensors import AddsSignal, Signal, within
from skyrange.attack.declaration import attack
from skyrange.attack.presets import SOUND_AT_AIRCRAFT, sound, unaltered_readings
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.fields import param

Accelerations = Annotated[Enu, within(-160.0, 160.0, "m/s²")]
"""16 g, full scale of usual accelerometers."""


@attack(
    "sensor.accelerometer",
    technique="EX-0014.03",
    counterfactual="mute",
    surface=("accel",),
    persists="acts",
    effect="the estimated climb rate and tilt are wrong between fixes: the aircraft sinks, drifts or does not land",
    threat=sound(
        "the accelerometer's model, its resonance and its output rate",
        position="beside the aircraft: a loudspeaker at some centimetres, or one on the airframe",
        budget="sound of about 110 dB at the sensor, for as long as it acts",
    ),
    controls=unaltered_readings("the same sound on another axis or aircraft"),
    realism={
        "measured acceleration": "simulated: the true one, noise, and the error",
        "resonance": "cited: 75 % of 20 models can be biased and 65 % controlled (Trippel et al., WALNUT, EuroS&P "
        "2017)",
        **SOUND_AT_AIRCRAFT,
    },
)
class Accelerometer(AddsSignal):
    """Adds false acceleration to what the accelerometers measure, by sound at their resonance.

    The measured specific force has an error: constant (output biasing) or oscillating.
    """

    bias_mps2: Accelerations = param(
        "Constant error along [forward, left, up] in m/s², each from -160 to 160.", default=(0.0, 0.0, 0.0)
    )
    amplitude_mps2: Accelerations = param(
        "Amplitude of an oscillation along [forward, left, up] in m/s², each from -160 to 160.",
        default=(0.0, 0.0, 0.0),
    )
    frequency_hz: Number = param(
        "Frequency in Hz of the sampled oscillation: the alias of the sound at the sensor's output rate.",
        default=1.0, gt=0, le=200,
    )  # fmt: skip

    signal = Signal("accel_mps2", constant="bias_mps2", amplitude="amplitude_mps2")
