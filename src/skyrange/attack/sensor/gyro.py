"""Gyroscope injection: sound at the resonance of a MEMS gyroscope appears as rotation."""

from __future__ import annotations

from math import radians

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import SOUND_AT_AIRCRAFT, AddsSound, Rates


@sky.attack(
    "sensor.gyro",
    surface=("gyro",),
    effect="the rate controllers answer false rotation: the aircraft rocks, and an error near full scale crashes it",
    knowledge="the gyroscope's model and so its resonance, 7.9 to 8.3 kHz of an L3G4200D, 26 to 29 kHz of InvenSense "
    "models; for a constant error its output rate as well",
    position="beside the aircraft: a loudspeaker of 113 dB at 10 cm; about 40 m with 140 dB at 1 m, computed",
    budget="sound, for as long as it acts",
    content="the sham: the same act with unaltered readings; or an oscillation beyond the controllers' filters",
    placement="the same sound on another axis or aircraft",
    realism={
        "measured rates": "simulated: the true ones, noise, and the error",
        "resonance": "cited: 7 of 15 models resonate, the standard deviation of their output is dozens of times the "
        "usual one, one of two aircraft crashed in all 20 trials (Son et al., Rocking drones, USENIX Security 2015); "
        "neither of them was an ArduCopter",
        "sampled frequency": "assumed: a parameter; what is faster than the airframe answers moves it little",
        "what an ArduCopter does about it": "cited: nothing in flight; it compares gyroscopes before it is armed "
        "(AP_Arming::ins_gyros_consistent: more than 5 deg/s apart for 10 s), and counts clipping of accelerometers "
        "alone (AP_InertialSensor::get_accel_clip_count); EKF3 estimates a constant error as a bias",
        "constant error": "cited: phase pacing and side-swing (Tu et al., Injected and delivered, USENIX Security "
        "2018)",
        **SOUND_AT_AIRCRAFT,
    },
)
class Gyro(AddsSound):
    """Adds false rotation to what the gyroscopes measure, by sound at their resonance."""

    amplitude_dps: Rates = sky.param(
        "Amplitude of an oscillation [forward, left, up] in deg/s, each from -2000 to 2000.", default=(0.0, 0.0, 0.0)
    )
    frequency_hz: sky.Number = sky.param(
        "Sampled frequency in Hz: the alias of the sound at the sensor's output rate.", default=10.0, gt=0, le=200
    )
    bias_dps: Rates = sky.param(
        "Constant error [forward, left, up] in deg/s, each from -2000 to 2000, by sound in step with the sampling.",
        default=(0.0, 0.0, 0.0),
    )

    signal = sky.Signal("gyro_radps", constant="bias_dps", amplitude="amplitude_dps", unit=radians)
