"""Gyroscope injection: sound at the resonance of a MEMS gyroscope appears as rotation."""

from __future__ import annotations

from math import radians

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.sensor.injection import Injected, Rates, Signal, inject, need_one
from skyrange.contracts.params import Number


class Gyro(Injected):
    """The measured rates have an error: an oscillation, or a constant one by sound in step with the sampling."""

    amplitude_dps: Rates = Field(
        default=(0.0, 0.0, 0.0),
        description="Amplitude of the oscillation about [forward, left, up] in deg/s, each from -2000 to 2000.",
    )
    frequency_hz: Number = Field(
        default=10.0,
        gt=0,
        le=200,
        description="Frequency in Hz of the sampled oscillation: the alias of the sound at the sensor's output rate.",
    )
    bias_dps: Rates = Field(
        default=(0.0, 0.0, 0.0),
        description="Constant error about [forward, left, up] in deg/s, each from -2000 to 2000.",
    )

    @model_validator(mode="after")
    def _is_there(self) -> Gyro:
        need_one(self, "amplitude_dps", "bias_dps")
        return self


def make(params: Gyro, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    forward, left, up = (radians(rate) for rate in params.bias_dps)
    roll, pitch, yaw = (radians(rate) for rate in params.amplitude_dps)
    signal = Signal((forward, left, up), (roll, pitch, yaw), params.frequency_hz, params.rise_s)
    return inject(params, signal, "gyro_radps", context)


GYRO = AttackPlugin(
    Gyro,
    make,
    "Adds false rotation to what the gyroscopes measure, by sound at their resonance.",
    technique="EX-0014.03",
    counterfactual="mute",
    surface=("gyro",),
    persists="acts",
    effect="the rate controllers answer false rotation: the aircraft rocks, tilts or crashes",
    threat=ThreatModel(
        knowledge="the gyroscope's model and so its resonance, 7.9 to 8.3 kHz of an L3G4200D, 26 to 29 kHz of "
        "InvenSense models; for a constant error its output rate as well",
        position="beside the aircraft: a loudspeaker of 113 dB at 10 cm; about 40 m with 140 dB at 1 m, computed",
        equipment="a loudspeaker and amplifier for the resonance",
        budget="sound, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a sensor signal takes no airtime of the range's links",
        content="the sham: the same act with unaltered readings; or an oscillation beyond the controllers' filters",
        placement="the same sound on another axis or aircraft",
    ),
    realism={
        "measured rates": "simulated: the true ones, noise, and the error",
        "resonance": "cited: 7 of 15 models resonate, output deviates dozens of times more than usual, one of two "
        "aircraft crashed in all 20 trials (Son et al., Rocking drones, USENIX Security 2015)",
        "constant error": "cited: phase pacing and side-swing (Tu et al., Injected and delivered, USENIX Security "
        "2018)",
        "amplitude at the aircraft": "assumed: a parameter, because it depends on sensor, distance and housing",
    },
)
