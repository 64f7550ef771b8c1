"""Accelerometer injection: sound at the resonance of a MEMS accelerometer appears as acceleration."""

from __future__ import annotations

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.sensor.injection import Accelerations, Injected, Signal, inject, need_one
from skyrange.contracts.params import Number


class Accelerometer(Injected):
    """The measured specific force has an error: constant (output biasing) or oscillating."""

    bias_mps2: Accelerations = Field(
        default=(0.0, 0.0, 0.0),
        description="Constant error along [forward, left, up] in m/s², each from -160 to 160.",
    )
    amplitude_mps2: Accelerations = Field(
        default=(0.0, 0.0, 0.0),
        description="Amplitude of an oscillation along [forward, left, up] in m/s², each from -160 to 160.",
    )
    frequency_hz: Number = Field(
        default=1.0,
        gt=0,
        le=200,
        description="Frequency in Hz of the sampled oscillation: the alias of the sound at the sensor's output rate.",
    )

    @model_validator(mode="after")
    def _is_there(self) -> Accelerometer:
        need_one(self, "bias_mps2", "amplitude_mps2")
        return self


def make(params: Accelerometer, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    signal = Signal(params.bias_mps2, params.amplitude_mps2, params.frequency_hz, params.rise_s)
    return inject(params, signal, "accel_mps2", context)


ACCELEROMETER = AttackPlugin(
    Accelerometer,
    make,
    "Adds false acceleration to what the accelerometers measure, by sound at their resonance.",
    technique="EX-0014.03",
    counterfactual="mute",
    surface=("accel",),
    persists="acts",
    effect="the estimated climb rate and tilt are wrong between fixes: the aircraft sinks, drifts or does not land",
    threat=ThreatModel(
        knowledge="the accelerometer's model, its resonance and its output rate",
        position="beside the aircraft: a loudspeaker at some centimetres, or one on the airframe",
        equipment="a loudspeaker and amplifier for the resonance",
        budget="sound of about 110 dB at the sensor, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a sensor signal takes no airtime of the range's links",
        content="the sham: the same act with unaltered readings",
        placement="the same sound on another axis or aircraft",
    ),
    realism={
        "measured acceleration": "simulated: the true one, noise, and the error",
        "resonance": "cited: 75 % of 20 models can be biased and 65 % controlled (Trippel et al., WALNUT, EuroS&P "
        "2017)",
        "amplitude at the aircraft": "assumed: a parameter, because it depends on sensor, distance and housing",
    },
)
