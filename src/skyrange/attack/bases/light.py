"""Bases of kinds that alter the light of LiDARs and depth cameras: anything, and lasers and projectors at a place.

A laser at a place reaches a sensor where no building is between them, where the sensor is within its range, and where
the spot of its beam covers the sensor's window although the aim is wrong: by a Gaussian error of the mount's angle, new
for each scan, and by what the aircraft flies across the line of sight within the delay of the tracking.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, radians, sqrt
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.declaration import Acting, Facts
from skyrange.attack.params import Victims, check_vehicles, place_param
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.form import param
from skyrange.contracts.scan_light import ScanLight, ScannerKind
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.core.time import Time
from skyrange.optics.altered_light import sum_up

LIGHT_M_PER_NS: Final = 0.299792458
"""Way of light in a nanosecond."""
Mask = NDArray[np.bool_]


class AltersLight(Acting):
    """Alters the light of the sensors that its parameters `vehicles` and `sensor` name.

    One instance is the scan hook of the whole act. `on_scan` writes into the light of a scan.
    """

    needs: ClassVar[tuple[str, ...]] = ("on_scan",)
    kinds: ClassVar[Sequence[ScannerKind]] = ("lidar",)

    vehicles: Victims = param("Aircraft whose sensors are altered, such as ['blue/b1'].")
    sensor: str | None = param(
        "Id of the sensor on each of these aircraft. Default: all of the kind that it acts on.", default=None
    )
    name: str
    """The actor in labels."""
    chance: Chance

    def assemble(self, context: AttackContext) -> Attack:
        """See `Acting`. Raises `InputError` for aircraft that the scenario does not have."""
        check_vehicles(context, self.vehicles)
        self.chance = context.chance
        made: Attack = super().assemble(context)
        return made

    def build(self, context: AttackContext) -> Attack:
        """Itself as a scan hook."""
        self.name = f"{self.id}.light"
        return Attack(scan_hooks=[self], shown=self.list_places())

    def list_places(self) -> dict[str, Place]:
        """Places to mark on a map, by label."""
        return {}

    def on_scan(self, now: Time, light: ScanLight) -> bool:
        """See `contracts.scan_light.ScanHook`."""
        raise NotImplementedError

    def draw(self, stream: str, light: ScanLight, now: Time, pulses: NDArray[np.int64]) -> Floats:
        """(n, 4) uniforms in [0, 1) for some pulses of a scan."""
        count = len(pulses)
        who = np.full(count, hash64(f"{self.name}|{light.vehicle}.{light.sensor}"), dtype=np.uint64)
        return self.chance.uniforms(stream, who, np.full(count, now, np.int64), pulses.astype(np.uint64))


class LightsSensor(AltersLight):
    """Light from a place in the field of view of a sensor: `shine` writes what it does to the pulses that it reaches.

    The sham lights the same sensors at the same times, below what they notice.
    """

    attack_facts: ClassVar[Facts] = {
        "counterfactual": "mute",
        "persists": "acts",
        "load": "none, because light takes no airtime of the range's links",
        "content": "the sham: the same act with light that is too weak to be noticed",
        "placement": "the same light from a place that a building hides",
        "position": "a place in the field of view of the sensor, with a free line of sight, in the range of its light",
    }
    needs: ClassVar[tuple[str, ...]] = ("shine",)
    source: ClassVar[str] = "laser"
    """What a map shows at the place."""

    at: Enu = place_param("Place of the light")
    range_m: Number = param(
        "Distance in metres up to which its light is strong enough.", default=100.0, gt=0, le=10_000
    )
    reach_deg: Number = param(
        "Angular reach: width in degrees of the cone around the direction to the light, in which "
        "the sensor's pulses are affected.",
        default=10.0, gt=0, le=180,
    )  # fmt: skip
    aperture_m: Number = param("Width in metres of the beam where it leaves the source.", default=0.01, gt=0, le=1)
    beam_mrad: Number = param("Divergence of the beam in milliradians, full angle.", default=5.0, ge=0, le=3_000)
    aim_mrad: Number = param(
        "Aiming error in milliradians, one standard deviation on each of two axes, new for each scan.",
        default=1.0, ge=0, le=1_000,
    )  # fmt: skip
    lag_s: Number = param(
        "Delay of the tracking in seconds: the aim is behind by what the aircraft flies across the line of sight.",
        default=0.01, ge=0, le=10,
    )  # fmt: skip

    def list_places(self) -> dict[str, Place]:
        """Where the light is."""
        return {self.source: self.at}

    def prepare(self, context: AttackContext) -> None:
        """Check the place. Raises `InputError` for one that is below the ground or inside a building."""
        if self.at[2] < 0.0:
            raise InputError.one(context.id, "at", str(list(self.at)), "a place on the ground (0) or above")
        building = context.city.inside(*self.at) if context.city is not None else None
        if building is not None:
            expected = f"a place outside buildings; this is in {building.name or building.id}"
            raise InputError.one(context.id, "at", str(list(self.at)), expected, "Put it on the roof.")

    def shine(self, now: Time, light: ScanLight, pulses: NDArray[np.int64]) -> None:
        """Write into the light of the pulses (numbers in ascending order) that it reaches."""
        raise NotImplementedError

    def on_scan(self, now: Time, light: ScanLight) -> bool:
        """Light the sensor, if it can."""
        if not self.hits_window(now, light):
            return False
        pulses = np.flatnonzero(self.find_lit(light, self.reach_deg))
        if not len(pulses):
            return False
        if not self.sham:
            self.shine(now, light, pulses)
        return True

    def find_lit(self, light: ScanLight, reach_deg: float) -> Mask:
        """(n,): which pulses look at the light, within half of `reach_deg`."""
        way = np.array(self.at) - light.origin
        along = (
            light.direction[:, 0] * way[:, 0] + light.direction[:, 1] * way[:, 1] + light.direction[:, 2] * way[:, 2]
        )
        return np.asarray(along >= elementary.cos(0.5 * radians(reach_deg)) * elementwise.length(way))

    def hits_window(self, now: Time, light: ScanLight) -> bool:
        """Whether its beam meets the sensor in a scan."""
        middle = len(light.origin) // 2
        way = [a - b for a, b in zip(self.at, light.origin[middle].tolist(), strict=True)]
        distance = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
        if distance > self.range_m or not light.is_in_sight(self.at):
            return False
        if distance == 0.0:
            return True
        sight = [part / distance for part in way]
        speed = light.velocity.tolist()
        closing = sum_up(np.array([speed]), sight)[0]
        across2 = max(speed[0] * speed[0] + speed[1] * speed[1] + speed[2] * speed[2] - closing * closing, 0.0)
        who = hash64(f"{self.name}|{light.vehicle}.{light.sensor}")
        u0, u1, _, _ = self.chance.uniform4("attack.light.aim", who, now)
        size = sqrt(-2.0 * elementary.log(1.0 - u0)) * self.aim_mrad * 1e-3 * distance
        behind = sqrt(across2) * self.lag_s
        along = behind + size * elementary_python.cos(2.0 * pi * u1)
        beside = size * elementary_python.sin(2.0 * pi * u1)
        off2 = along * along + beside * beside
        spot = self.aperture_m + self.beam_mrad * 1e-3 * distance
        return bool(off2 <= 0.25 * spot * spot)

    def distance_from(self, light: ScanLight, pulses: NDArray[np.int64]) -> Floats:
        """(n,): from the sensor to the light at some pulses, in metres."""
        return elementwise.length(np.array(self.at) - light.origin[pulses])


def even_choice(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of some rows, evenly spread over them."""
    if len(rows) <= most:
        return rows
    chosen = np.floor(np.arange(most) * (len(rows) / most)).astype(np.int64)
    return np.asarray(rows[chosen])
