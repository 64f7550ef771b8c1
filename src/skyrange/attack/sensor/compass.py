"""Compass injection: a magnetic field beside the sensor turns the measured heading."""

from __future__ import annotations

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.sensor.injection import Fields, Injected, Signal, inject, need_one
from skyrange.contracts.params import Number


class Compass(Injected):
    """The measured field has an added one, fixed to the body, constant or oscillating."""

    field_gauss: Fields = Field(
        default=(0.0, 0.0, 0.0),
        description="Added field in the body, [forward, left, up] in gauss, each from -10 to 10; the Earth's is 0.2 to "
        "0.7.",
    )
    amplitude_gauss: Fields = Field(
        default=(0.0, 0.0, 0.0),
        description="Amplitude of an oscillating field in the body, [forward, left, up] in gauss, each from -10 to 10.",
    )
    frequency_hz: Number = Field(default=0.2, gt=0, le=5, description="Frequency of the oscillating field in Hz.")

    @model_validator(mode="after")
    def _is_there(self) -> Compass:
        need_one(self, "field_gauss", "amplitude_gauss")
        return self


def make(params: Compass, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    signal = Signal(params.field_gauss, params.amplitude_gauss, params.frequency_hz, params.rise_s)
    return inject(params, signal, "compass_gauss", context)


COMPASS = AttackPlugin(
    Compass,
    make,
    "Adds a magnetic field to the one that the compass measures.",
    technique="EX-0014.03",
    counterfactual="mute",
    surface=("compass",),
    persists="acts",
    effect="the heading is wrong, so that corrections go the wrong way and the aircraft circles away",
    threat=ThreatModel(
        knowledge="for a field that passes the estimator's gate: the strength of the Earth's field",
        position="at the sensor: a magnet or coil on the airframe; a coil of 1 m radius at some metres",
        equipment="a permanent magnet or an electromagnet",
        budget="a field that falls with the third power of the distance",
    ),
    controls=Controls(
        load="none, because a sensor signal takes no airtime of the range's links",
        content="the sham: the same act with unaltered readings",
        placement="the same field on another aircraft",
    ),
    realism={
        "measured field": "simulated: the Earth's field in the body, noise, and the added field",
        "saturation of the sensor": "assumed: none up to 10 gauss",
        "compass of ArduPilot": "simulated: by ArduPilot, from the true attitude, which this attack does not reach",
        "field at the sensor": "assumed: constant in the body, as of a magnet on the airframe",
    },
)
