"""Altered light: what hooks have made of the light of a scan, applied to what its rays meet.

A false echo is many times as strong as the reference's (assumed), so a receiver that returns the strongest echo
returns it, with the noise, the drop-outs and the limits of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.scan_light import SCANNER_KINDS, ScanLight
from skyrange.core import elementwise
from skyrange.core.arrays import Floats
from skyrange.optics.extinction import Weather, find_extinction
from skyrange.optics.mounted_sensors import MountedSensor, turn_mount
from skyrange.optics.ray_casting import GROUND, NONE, Hits, Rays, cast_rays
from skyrange.optics.ray_index import RayIndex
from skyrange.optics.reflectivity import Surfaces
from skyrange.optics.scan_patterns import Firing
from skyrange.optics.sensor_models import LidarModel
from skyrange.optics.sensor_poses import SensorPose

FALSE_STRENGTH: Final = 1_000.0
"""Power of a false echo over that of the reference (assumed: an echo has the power of the part of a beam that a
surface reflects and a small aperture receives, a laser that is aimed at the aperture has much more)."""
CLEAR: Final = 0.5
"""Share of the light below which a pixel of a camera has no depth (assumed)."""
_MOST_LOSS: Final = 300.0
"""Nepers of extinction from which on no light is left, not even that of a false echo."""
_TOUCH_M: Final = 0.01
"""How far from a surface a place on it counts as outside."""
GREEN_UM: Final = 0.55
"""For a camera (assumed)."""
Mask = NDArray[np.bool_]


def shine(index: RayIndex, sensor: MountedSensor, firing: Firing, pose: SensorPose, rays: Rays) -> ScanLight:
    """The light of a scan of `rays` before anything alters it. `firing` is in the frame of the sensor's base."""
    model, count = sensor.model, len(rays.delay_s)
    axis = turn_mount(sensor.yaw_deg, sensor.pitch_deg)[:, 0].tolist()
    return ScanLight(
        vehicle=sensor.vehicle,
        sensor=sensor.id,
        kind=SCANNER_KINDS[sensor.kind],
        near_m=model.near_m,
        reach_m=model.reach_m,
        wavelength_um=model.wavelength_um if isinstance(model, LidarModel) else GREEN_UM,
        velocity=pose.velocity,
        origin=rays.origin,
        direction=rays.direction,
        in_base=firing.direction,
        ahead=sum_up(firing.direction, axis),
        delay_s=rays.delay_s,
        is_in_sight=partial(_is_in_sight, index, rays.origin[count // 2]),
        transmission=np.ones(count),
        false_echo_m=np.full(count, np.nan),
        is_blind=np.zeros(count, dtype=np.bool_),
    )


def sum_up(vectors: Floats, other: Sequence[float]) -> Floats:
    """(n,) scalar products of n vectors with another one, in an order that is the same everywhere."""
    return np.asarray(vectors[:, 0] * other[0] + vectors[:, 1] * other[1] + vectors[:, 2] * other[2])


def _is_in_sight(index: RayIndex, eye: Floats, place: tuple[float, float, float]) -> bool:
    """Whether no building and no ground is between two places. Aircraft in between are passed over."""
    way = np.array(place) - eye
    distance = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    if distance <= _TOUCH_M:
        return True
    ray = Rays(eye[None, :].copy(), (way / distance)[None, :], np.zeros(1), np.full(1, -1, np.int32))
    return int(cast_rays(index, ray, distance - _TOUCH_M).kind[0]) == NONE


def alter_hits(
    hits: Hits, light: ScanLight, pulses: NDArray[np.int64], model: LidarModel, surfaces: Surfaces, weather: Weather
) -> Hits:
    """What the rays of a LiDAR meet in altered light. `hits` has the same number of rays for each of `pulses`."""
    samples = len(hits.kind) // max(len(pulses), 1)
    of = np.repeat(pulses, samples)
    distance, kind, row = hits.distance_m.copy(), hits.kind.copy(), hits.row.copy()
    cosine = hits.cosine * light.transmission[of]
    if light.extinction_per_m > 0.0:
        met = kind != NONE
        cosine[met] *= elementwise.exp(-2.0 * light.extinction_per_m * distance[met])
    forged = ~np.isnan(light.false_echo_m[of])
    if forged.any():
        false_m = light.false_echo_m[of][forged]
        loss = np.minimum(2.0 * find_extinction(weather, model.wavelength_um) * false_m, _MOST_LOSS)
        reference = model.reference_reflectivity / (model.reference_m * model.reference_m)
        strength = FALSE_STRENGTH * reference / surfaces.ground
        distance[forged], kind[forged], row[forged] = false_m, GROUND, -1
        cosine[forged] = strength * false_m * false_m * elementwise.exp(loss)
    blind = light.is_blind[of]
    distance[blind], kind[blind], row[blind], cosine[blind] = np.inf, NONE, -1, 0.0
    return Hits(distance, kind, row, cosine)


def alter_pixels(hits: Hits, light: ScanLight) -> Hits:
    """What the pixels of a depth camera show in altered light: one ray for each."""
    forged = ~np.isnan(light.false_echo_m)
    distance = np.where(forged, light.false_echo_m, hits.distance_m)
    kind = np.where(forged, np.uint8(GROUND), hits.kind)
    kind[light.is_blind | (light.transmission < CLEAR)] = NONE
    return Hits(distance, kind, hits.row, hits.cosine)


def find_forged(steps: NDArray[np.uint16], light: ScanLight) -> Mask:
    """(n,): which returns are those of false echoes, unless noise has replaced one."""
    return np.asarray((steps > 0) & ~np.isnan(light.false_echo_m) & ~light.is_blind)
