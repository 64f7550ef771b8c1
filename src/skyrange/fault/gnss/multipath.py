"""GNSS multipath: among buildings, satellites are hidden or received by reflections, and fixes have errors."""

from __future__ import annotations

from math import pi
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.fixes import FIX_2D, UNALTERED
from skyrange.attack.gnss.emitter import FIX_NONE
from skyrange.attack.gnss.receiver_noise import LEAST_SATELLITES
from skyrange.fault.gnss.reflection_errors import ReflectionModel
from skyrange.fault.sky_view import even_sky

STREAM: Final = "fault.gnss_multipath"
NOTICEABLE_M: Final = 0.5
"""A fix with a smaller error, and with all satellites, is left as it is."""
DEGRADED, LOST = range(2)
"""Phases of a receiver."""


@sky.fault(
    "gnss.multipath",
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
class Multipath(sky.OnReceivers):
    """Gives GNSS fixes among buildings the errors of hidden and reflected satellites."""

    vehicles: sky.Victims = sky.param("Aircraft whose GNSS fixes are affected, such as ['blue/b1'].")
    reflection: sky.Number = sky.param(
        "Amplitude of a reflected signal, as a share of the direct one's.", default=0.5, gt=0, le=1
    )
    spacing_chips: sky.Number = sky.param(
        "Spacing of the receiver's correlators in C/A chips: 1 is wide, 0.1 narrow.", default=0.1, gt=0, le=1
    )
    radius_m: sky.Number = sky.param("Distance in metres up to which buildings count.", default=150.0, ge=10, le=1_000)
    model: ReflectionModel
    chance: sky.Chance

    def prepare(self, context: sky.FaultContext) -> None:
        """Look for the city. Raises `InputError` without one."""
        if context.city is None:
            hint = "Add [city], such as city = { grid = {} }."
            raise sky.InputError.one(context.id, "vehicles", "no buildings", "a scenario with a city", hint)
        self.model = ReflectionModel(context.city, self.reflection, self.spacing_chips, self.radius_m)
        self.chance = context.chance

    def receive(self, rows: sky.Ints, sensors: sky.Sensors) -> None:
        """Give each new fix the error of reflected signals at the place where it was measured."""
        for row in rows.tolist():
            self.restore(row)
            self.phases[row] = self._degrade(row, sensors)

    def _degrade(self, row: int, sensors: sky.Sensors) -> int:
        """What a receiver makes of its satellites; returns its phase."""
        count = int(sensors.gnss_satellites[row])
        if sensors.gnss_fix[row] < FIX_2D or count < LEAST_SATELLITES:
            return UNALTERED
        hemisphere = even_sky(count, 2.0 * pi * self.chance.uniform4(STREAM, sky.hash64(self.name), 0)[0])
        east, north, up = sensors.gnss_enu_m[row].tolist()
        received, fix = self.model.degrade((east, north, up), hemisphere)
        if fix is None:
            self.fix[row], self.satellites[row] = FIX_NONE, received
            return LOST
        offset_m, dilution = fix
        if received == count and float(np.linalg.norm(offset_m)) < NOTICEABLE_M:
            return UNALTERED
        self.satellites[row], self.offset[row], self.scale[row, :2] = received, offset_m, dilution
        return DEGRADED
