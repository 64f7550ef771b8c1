"""Barometer injection: a false pressure at the port of the sensor shifts the measured height."""

from __future__ import annotations

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.sensor.injection import Injected, Signal, inject, need_one
from skyrange.contracts.params import Number


class Barometer(Injected):
    """The measured height has an error, constant or oscillating."""

    offset_m: Number = Field(
        default=0.0,
        ge=-1_000,
        le=1_000,
        description="Error of the measured height in metres; +1 m is 12 Pa less pressure at sea level.",
    )
    amplitude_m: Number = Field(
        default=0.0, ge=0, le=1_000, description="Amplitude of an oscillation of the measured height in metres."
    )
    frequency_hz: Number = Field(default=0.5, gt=0, le=5, description="Frequency of that oscillation in Hz.")

    @model_validator(mode="after")
    def _is_there(self) -> Barometer:
        need_one(self, "offset_m", "amplitude_m")
        return self


def make(params: Barometer, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    signal = Signal((params.offset_m, 0.0, 0.0), (params.amplitude_m, 0.0, 0.0), params.frequency_hz, params.rise_s)
    return inject(params, signal, "baro_up_m", context)


BAROMETER = AttackPlugin(
    Barometer,
    make,
    "Shifts the height that the barometer measures, by a false pressure at its port.",
    technique="EX-0014.03",
    counterfactual="mute",
    surface=("baro",),
    persists="acts",
    effect="the aircraft flies too low or too high by the error, with an estimate that shows nothing",
    threat=ThreatModel(
        knowledge="for a slow shift that passes the estimator's gate: EK3_HGT_I_GATE and EK3_ALT_M_NSE",
        position="at the sensor: a manipulated sensor board, a device on the airframe, or a strong sound beside it",
        equipment="a small pump or fan at the port, or a loudspeaker at the resonance of the port and tube",
        budget="12 Pa for each metre",
    ),
    controls=Controls(
        load="none, because a sensor signal takes no airtime of the range's links",
        content="the sham: the same act with unaltered readings",
        placement="the same error on another aircraft",
    ),
    realism={
        "measured height": "simulated: true pressure height, noise and drift, and the error",
        "size of the error": "assumed: sound displaces pressure sensors (Barua et al., A wolf in sheep's clothing, "
        "CCS 2022, in rooms); nothing was measured on an aircraft",
        "after the attack": "assumed: the true height is measured at once",
    },
)
