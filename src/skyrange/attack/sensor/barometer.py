"""Barometer injection: a false pressure at the port of the sensor shifts the measured height."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "sensor.barometer",
    surface=("baro",),
    effect="the aircraft flies too low or too high by the error, with an estimate that shows nothing",
    knowledge="for a slow shift that passes the estimator's gate: EK3_HGT_I_GATE and EK3_ALT_M_NSE",
    position="at the sensor: a manipulated sensor board, a device on the airframe, or a strong sound beside it",
    equipment="a small pump or fan at the port, or a loudspeaker at the resonance of the port and tube",
    budget="12 Pa for each metre",
    placement="the same error on another aircraft",
    realism={
        "measured height": "simulated: true pressure height, noise and drift, and the error",
        "size of the error": "assumed: sound displaces pressure sensors (Barua et al., A wolf in sheep's clothing, "
        "CCS 2022, in rooms); nothing was measured on an aircraft",
        "after the attack": "assumed: the true height is measured at once",
    },
)
class Barometer(sky.AddsSignal):
    """Shifts the height that the barometer measures, by a false pressure at its port."""

    offset_m: sky.Number = sky.param(
        "Constant error in metres; +1 m is 12 Pa less pressure at sea level.", default=0.0, ge=-1_000, le=1_000
    )
    amplitude_m: sky.Number = sky.param("Amplitude of an oscillation in metres.", default=0.0, ge=0, le=1_000)
    frequency_hz: sky.Number = sky.param("Frequency of that oscillation in Hz.", default=0.5, gt=0, le=5)

    signal = sky.Signal("baro_up_m", constant="offset_m", amplitude="amplitude_m")
