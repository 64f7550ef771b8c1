"""GNSS multipath: among buildings, satellites are hidden or received by reflections, and fixes have errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi
from typing import Final

import numpy as np
from pydantic import Field

from skyrange.attack.gnss.emitter import FIX_2D, FIX_NONE
from skyrange.attack.gnss.jam import CHIP_M
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.city.city import City
from skyrange.contracts.components import Floats, Ints, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.core.time import Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin
from skyrange.fault.sky_view import Seen, even_sky, see, solve

STREAM: Final = "fault.gnss_multipath"
WAVE_M: Final = 0.190293673
"""Wavelength of GPS L1, 1575.42 MHz (IS-GPS-200)."""
NOTICEABLE_M: Final = 0.5
"""A fix with a smaller error, and with all satellites, is left as it is."""
LEAST_SATELLITES: Final = 4
_ALL: Final = 255
UNHARMED, DEGRADED, LOST = range(3)
"""Phases of a receiver."""


class Multipath(Params):
    """Whose receivers are affected, and how they treat reflected signals."""

    vehicles: Victims = Field(description="Aircraft whose GNSS fixes are affected, such as ['blue/b1'].")
    reflection: Number = Field(
        default=0.5, gt=0, le=1, description="Amplitude of a reflected signal, as a share of the direct one's."
    )
    spacing_chips: Number = Field(
        default=0.1,
        gt=0,
        le=1,
        description="Spacing of the receiver's correlators in C/A chips: 1 is wide, 0.1 narrow.",
    )
    radius_m: Number = Field(
        default=150.0, ge=10, le=1_000, description="Distance in metres up to which buildings count."
    )


@dataclass(slots=True)
class ReflectedFixes:
    """A sensor fault that gives each new fix the error of reflected signals at the place where it was measured."""

    name: str
    vehicles: Sequence[str]
    city: City
    params: Multipath
    chance: Chance
    schedule: Schedule
    slow: bool = True
    _seen: list[int] = field(init=False)
    _phase: Ints = field(init=False)
    _fix: Ints = field(init=False)
    _satellites: Ints = field(init=False)
    _offset: Floats = field(init=False)
    _scale: Floats = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.vehicles)
        self._seen = [-1] * count
        self._phase = np.zeros(count, dtype=np.int64)
        self._fix = np.full(count, _ALL, dtype=np.int64)
        self._satellites = np.full(count, _ALL, dtype=np.int64)
        self._offset = np.zeros((count, 3))
        self._scale = np.ones((count, 2))

    def on_sensors(self, now: Time, sensors: Sensors) -> list[SensorAct]:
        """Alter the fixes. Returns an act for each receiver that begins to be degraded, or loses its fix."""
        start = self.schedule.start_ns
        if now < start:
            return []
        acts = []
        for row, time in enumerate(sensors.gnss_time_ns.tolist()):
            if time == self._seen[row] or time < start:
                continue
            self._seen[row] = time
            before = int(self._phase[row])
            self._receive(row, sensors)
            if self._phase[row] not in (UNHARMED, before):
                acts.append(SensorAct(self.vehicles[row], "gnss"))
        np.minimum(sensors.gnss_fix, self._fix, out=sensors.gnss_fix)
        np.minimum(sensors.gnss_satellites, self._satellites, out=sensors.gnss_satellites)
        sensors.gnss_enu_m += self._offset
        sensors.gnss_accuracy[:, :2] *= self._scale
        return acts

    def _receive(self, row: int, sensors: Sensors) -> None:
        """Decide what a receiver makes of a new fix."""
        self._phase[row], self._fix[row], self._satellites[row] = UNHARMED, _ALL, _ALL
        self._offset[row], self._scale[row] = 0.0, 1.0
        count = int(sensors.gnss_satellites[row])
        if sensors.gnss_fix[row] < FIX_2D or count < LEAST_SATELLITES:
            return
        east, north, up = sensors.gnss_enu_m[row].tolist()
        sky = even_sky(count, 2.0 * pi * self.chance.uniform4(STREAM, hash64(self.name), 0)[0])
        seen = see(self.city, (east, north, up), sky, self.params.radius_m)
        errors_m = pseudorange_errors(seen, self.params.reflection, self.params.spacing_chips)
        strength = np.where(seen.hidden > 0.0, self.params.reflection, 1.0)
        solved, open_sky = solve(sky, errors_m, strength), solve(sky, np.zeros(count), np.ones(count))
        received = int(np.isfinite(errors_m).sum())
        if solved is None or open_sky is None:
            self._phase[row], self._fix[row], self._satellites[row] = LOST, FIX_NONE, received
            return
        offset_m, dilution = solved
        if received == count and float(np.linalg.norm(offset_m)) < NOTICEABLE_M:
            return
        self._phase[row], self._satellites[row], self._offset[row] = DEGRADED, received, offset_m
        flat = float(np.hypot(*dilution[:2]) / np.hypot(*open_sky[1][:2]))
        self._scale[row] = flat, float(dilution[2] / open_sky[1][2])


def pseudorange_errors(seen: Seen, reflection: float, spacing_chips: float) -> Floats:
    """Errors (n,) in metres of the pseudoranges; NaN for a satellite that is hidden and not reflected.

    A hidden satellite has the whole detour of its reflection. One in sight has the error of a reflection that a delay
    lock loop does not resolve: ±(α·detour) for a short one, and at most α·spacing·chip/2, 7 m for half the amplitude
    and a tenth of a chip (Van Dierendonck, Fenton and Ford, Theory and performance of narrow correlator spacing in a
    GPS receiver, Navigation 39:3, 1992). Its sign and size follow the phase of the detour. Reflections that are longer
    than a chip and a half do no harm.
    """
    detour = seen.detour_m
    most_m = reflection * spacing_chips * CHIP_M / 2.0
    mixed = np.minimum(reflection * detour, most_m) * np.cos(2.0 * pi * detour / WAVE_M)
    mixed = np.where(np.isnan(detour) | (detour > 1.5 * CHIP_M), 0.0, mixed)
    return np.asarray(np.where(seen.hidden > 0.0, detour, mixed), dtype=np.float64)


def make(params: Multipath, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario, and for one without buildings."""
    check_vehicles(context, params.vehicles)
    if context.city is None:
        hint = "Add [city], such as city = { grid = {} }."
        raise InputError.one(context.id, "vehicles", "no buildings", "a scenario with a city", hint)
    fault = ReflectedFixes(
        f"{context.id}.gnss", params.vehicles, context.city, params, context.chance, context.schedule
    )
    return FaultParts(faults=[fault])


GNSS_MULTIPATH = FaultPlugin(
    Multipath,
    make,
    "Gives GNSS fixes among buildings the errors of hidden and reflected satellites.",
    surface=("gnss",),
    effect="fixes near walls are metres to tens of metres off, and jump from fix to fix",
    cause="walls that hide satellites and reflect their signals",
    not_modelled="reflections by several walls or by the ground, motion of the satellites, errors of the velocity, and "
    "the receiver's filter and its tests for outliers",
    realism={
        "satellites in sight": "simulated: buildings of the city against an even sky above 10 degrees, assumed",
        "detour of reflections": "cited: 2·d·cos(elevation) by a vertical wall (Hsu, GPS Solutions 22:7, 2018)",
        "errors of satellites in sight": "cited: the envelope of a narrow correlator (Van Dierendonck, Fenton and "
        "Ford, Navigation 39:3, 1992)",
        "position": "simulated: least squares weighted by signal strength and elevation",
        "claimed accuracy": "simulated: grows with the dilution of precision; errors of reflections are not claimed",
    },
)
