"""Scanner: the agent that makes the scans of all sensors of a run from the truth, and sends them to the companions.

A scan begins at a multiple of the sensor's period. It is made of the poses that the aircraft then have, with their
velocities and rates during the scan, and sent when the scan ends. Aircraft that are not present are not seen.

A LiDAR's pulse is one ray, unless an aircraft is close to its beam: then it is sampled by several, because an aircraft
fills a part of a beam.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.range_scans import RangeScan, pack_scan
from skyrange.contracts.components import World
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.scan_light import SCANNER_KINDS, LightSource, ScanLight
from skyrange.core import elementary, elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.ids import Port, hash64, link_name
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.altered_light import alter_hits, alter_pixels, find_forged, shine
from skyrange.optics.depth_images import make_depth_image
from skyrange.optics.extinction import Weather
from skyrange.optics.mounted_sensors import MountedSensor, list_pulses
from skyrange.optics.ray_casting import AIRCRAFT, NONE, Rays, cast_rays
from skyrange.optics.ray_index import RayIndex
from skyrange.optics.reflectivity import Surfaces
from skyrange.optics.returns import Address, Returns, find_returns
from skyrange.optics.scan_patterns import Firing, choose_rays
from skyrange.optics.sensor_models import DepthCameraModel, LidarModel
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays, sample_footprint
from skyrange.optics.targets import Targets, place_targets

NAME: Final = "optics"
ENDPOINT: Final = "oracle"
"""The endpoint of the environment oracle, which sends what comes from the world."""
ATTITUDE_STREAM: Final = "optics.attitude"
TILT_RAD: Final = math.radians(0.3)
HEADING_RAD: Final = math.radians(1.0)
"""Standard deviations of the errors of a sensor's own inertial unit, constant during a run (assumed)."""
SAMPLES: Final = 5
"""Rays across and up in a pulse that passes close to an aircraft."""


class Shape(NamedTuple):
    """An aircraft as light meets it: an upright cylinder."""

    radius_m: float
    height_m: float
    bottom_m: float
    """Above the bottom of the gear."""


class Scene(NamedTuple):
    """What light meets, besides aircraft, and what weakens it."""

    city: RayIndex
    surfaces: Surfaces
    weather: Weather


class ScanTruth(NamedTuple):
    """What is true of one scan and of its n pulses or pixels."""

    sent_ns: Time
    start_ns: Time
    vehicle: str
    sensor: str
    scan: int
    pose: SensorPose
    """At the start; the attitude and the rates are those of the sensor's base."""
    estimate: tuple[float, float, float, float]
    """The attitude that is sent."""
    resolution_m: float
    steps: NDArray[np.uint16]
    """(n,): as sent."""
    kind: NDArray[np.uint8]
    """(n,): as `ray_casting.Hits.kind`."""
    row: NDArray[np.int32]
    """(n,): building, or aircraft in the order of `aircraft`; -1 for others."""
    is_false: NDArray[np.bool_]
    """(n,): whether the distance is noise."""
    is_forged: NDArray[np.bool_]
    """(n,): whether the distance is that of a false echo of an attack or a fault; what is met is then unknown."""
    aircraft: tuple[str, ...]
    """Those that the scan met, in the order of the world."""


@dataclass(slots=True)
class _Waiting:
    """A scan that was made and has not ended yet."""

    due: Time
    place: int
    payload: bytes
    truth: ScanTruth | None


@dataclass(frozen=True, slots=True)
class _Fleet:
    """All present aircraft at the start of a scan."""

    targets: Targets
    names: tuple[str, ...]
    """(targets,): name of each."""
    target_of: NDArray[np.int32]
    """(aircraft,): its row in the targets; -1 for one that is not present."""


class Scanner:
    """The agent (contract: `contracts.components.TruthSubscriber`). Deep copies continue alike."""

    name = NAME

    def __init__(
        self,
        sensors: Sequence[MountedSensor],
        shapes: Mapping[str, Shape],
        scene: Scene,
        chance: Chance,
        period_ns: Time,
    ) -> None:
        """`shapes` are those of all aircraft of the world, by name; scans begin at multiples of `period_ns`."""
        self.sensors = tuple(sensors)
        vehicles = list(dict.fromkeys(sensor.vehicle for sensor in sensors))
        self.ports: Sequence[Port] = [Port(ENDPOINT, link_name("scan", vehicle)) for vehicle in vehicles]
        self._places = [vehicles.index(sensor.vehicle) for sensor in sensors]
        self.service_ns: Time = period_ns
        self.observe_period_ns: Time = self.service_ns
        self._shape_of = dict(shapes)
        self._scene = scene
        self._chance = chance
        self._errors = [_find_attitude_error(chance, sensor.name) for sensor in sensors]
        self._waiting: list[_Waiting] = []
        self._stepped: Time = 0
        self._rows: list[int] | None = None
        self._shapes = np.empty((0, 3))
        self._recording = False
        self._truths: list[ScanTruth] = []
        self._light: LightSource | None = None

    # --- the contract --------------------------------------------------------------------------------

    def observe(self, now: Time, world: World) -> None:
        """Make the scans that begin now."""
        if now < 0:
            return
        due = [number for number, sensor in enumerate(self.sensors) if now % sensor.period_ns == 0]
        if not due:
            return
        if self._rows is None:
            self._rows = [world.vehicles.index(sensor.vehicle) for sensor in self.sensors]
            self._shapes = np.array([self._shape_of[vehicle] for vehicle in world.vehicles])
        position, velocity = world.motion()
        truth = world.truth()
        fleet = self._place_fleet(position, velocity, world, max(self.sensors[k].duration_ns for k in due))
        for number in due:
            row = self._rows[number]
            if fleet.target_of[row] < 0:
                continue
            sensor = self.sensors[number]
            attitude = np.array([float(truth[name][row]) for name in ("qw", "qx", "qy", "qz")])
            rates = np.array([float(truth[f"rate_{axis}_radps"][row]) for axis in "xyz"])
            if sensor.is_stabilised:
                attitude, rates = _level(attitude), np.array([0.0, 0.0, rates[2]])
            pose = SensorPose(
                np.array(position[row]), np.array(velocity[row]), attitude, rates, np.array(sensor.place_m)
            )
            self._scan(now, number, pose, fleet, own=int(fleet.target_of[row]))

    def next_wakeup(self) -> Time | None:
        """The next time at which a scan may end."""
        return self._stepped + self.service_ns

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Send the scans that have ended."""
        self._stepped = now
        out = Outbox()
        for waiting in self._waiting:
            if waiting.due <= now:
                out.send(self.ports[waiting.place], waiting.payload)
                if waiting.truth is not None:
                    self._truths.append(waiting.truth)
        self._waiting = [waiting for waiting in self._waiting if waiting.due > now]
        return out

    def attach_light(self, light: LightSource) -> None:
        """See `contracts.scan_light.ScanMaker`."""
        self._light = light

    def start_recording(self) -> None:
        """Keep the truth of scans from now on, until it is drained."""
        self._recording = True

    def drain_truths(self) -> Sequence[ScanTruth]:
        """The truth of the scans that were sent since the last call, once it records."""
        truths, self._truths = self._truths, []
        return truths

    # --- one scan ------------------------------------------------------------------------------------

    def _place_fleet(self, position: Floats, velocity: Floats, world: World, duration_ns: Time) -> _Fleet:
        present = world.present
        rows = np.arange(len(position)) if present is None else np.flatnonzero(present)
        target_of = np.full(len(position), -1, dtype=np.int32)
        target_of[rows] = np.arange(len(rows))
        place = np.array(position[rows])
        radius, height, bottom = self._shapes[rows].T
        place[:, 2] += bottom
        targets = place_targets(
            self._scene.city,
            place,
            np.array(velocity[rows]),
            radius,
            height,
            during_s=duration_ns / NS_PER_S,
        )
        return _Fleet(targets, tuple(world.vehicles[row] for row in rows.tolist()), target_of)

    def _scan(self, now: Time, number: int, pose: SensorPose, fleet: _Fleet, *, own: int) -> None:
        """Make a scan; `own` is the row of its aircraft in the targets."""
        sensor = self.sensors[number]
        scan = now // sensor.period_ns
        address = Address(self._chance, hash64(sensor.name), now)
        firing = sensor.list_rays(scan)
        model = sensor.model
        rays = make_pulse_rays(firing, pose, own=own)
        light = self._alter_light(now, sensor, firing, pose, rays)
        if isinstance(model, LidarModel):
            returns = self._find_returns(model, firing, pose, rays, fleet.targets, address, light=light)
            steps, kind, met, is_false = returns.steps, returns.kind, returns.row, returns.is_false
        else:
            steps, kind, met = self._find_depths(model, rays, fleet.targets, address, light)
            is_false = np.zeros(len(steps), dtype=np.bool_)
        estimate = _multiply(self._errors[number], pose.attitude)
        said = RangeScan(sensor.kind, sensor.number, scan, model.resolution_m, now, estimate, steps)
        due = now + max(sensor.duration_ns, self.service_ns)
        truth = None
        if self._recording:
            is_aircraft = kind == AIRCRAFT
            seen, place = np.unique(met[is_aircraft], return_inverse=True)
            met = met.copy()
            met[is_aircraft] = place
            names = tuple(fleet.names[target] for target in seen.tolist())
            is_forged = np.zeros(len(steps), np.bool_) if light is None else find_forged(steps, light) & ~is_false
            kind, met = np.where(is_forged, np.uint8(NONE), kind), np.where(is_forged, np.int32(-1), met)
            truth = ScanTruth(
                due, now, sensor.vehicle, sensor.id, scan, pose, estimate, model.resolution_m, steps, kind, met,
                is_false, is_forged, names,
            )  # fmt: skip
        self._waiting.append(_Waiting(due, self._places[number], pack_scan(said), truth))

    def _alter_light(
        self, now: Time, sensor: MountedSensor, firing: Firing, pose: SensorPose, rays: Rays
    ) -> ScanLight | None:
        """The light of a scan as attacks and faults have altered it; None where none ever does."""
        hooks, kind = self._light, SCANNER_KINDS[sensor.kind]
        if hooks is None or not hooks.has_hooks(sensor.vehicle, kind):
            return None
        light = shine(self._scene.city, sensor, firing, pose, rays)
        hooks.alter(now, light)
        return light

    def _find_returns(
        self,
        model: LidarModel,
        firing: Firing,
        pose: SensorPose,
        rays: Rays,
        targets: Targets,
        address: Address,
        *,
        light: ScanLight | None,
    ) -> Returns:
        index, surfaces, weather = self._scene
        own = int(rays.own[0])
        near = _pass_aircraft(rays, targets, own, model)
        met = cast_rays(index, rays, model.reach_m, targets)
        if light is not None:
            met = alter_hits(met, light, np.arange(len(near)), model, surfaces, weather)
        returns = find_returns(model, firing, met, surfaces, weather, address)
        if near.any():
            some = choose_rays(firing, near)
            beam = sample_footprint(model, SAMPLES, SAMPLES)
            hits = cast_rays(index, make_pulse_rays(some, pose, beam, own), model.reach_m, targets)
            if light is not None:
                hits = alter_hits(hits, light, np.flatnonzero(near), model, surfaces, weather)
            sampled = find_returns(model, some, hits, surfaces, weather, address)
            returns.steps[near], returns.signal[near] = sampled.steps, sampled.signal
            returns.kind[near], returns.row[near] = sampled.kind, sampled.row
            returns.is_false[near] = sampled.is_false
        return returns

    def _find_depths(
        self, model: DepthCameraModel, rays: Rays, targets: Targets, address: Address, light: ScanLight | None
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint8], NDArray[np.int32]]:
        # a pixel at the edge of the image is farther away than its depth along the axis
        hits = cast_rays(self._scene.city, rays, 2.0 * model.reach_m, targets)
        if light is not None:
            hits = alter_pixels(hits, light)
        image = make_depth_image(model, list_pulses(model.pattern, 0), hits, address)
        return image.steps.reshape(-1), image.kind.reshape(-1), image.row.reshape(-1)


def _pass_aircraft(rays: Rays, targets: Targets, own: int, model: LidarModel) -> NDArray[np.bool_]:
    """(n,): whether the beam of each pulse passes close to an aircraft that it may reach."""
    near = np.zeros(len(rays.delay_s), dtype=np.bool_)
    wide = max(model.divergence_rad)
    origin = rays.origin[0]
    for k in range(len(targets.radius)):
        if k == own:
            continue
        half = 0.5 * float(targets.height[k])
        radius = elementary_python.hypot(float(targets.radius[k]), half)
        start = targets.position[k] + np.array([0.0, 0.0, half])
        speed = targets.velocity[k]
        way = elementary_python.hypot3(*speed.tolist()) * float(rays.delay_s[-1])
        away = elementary_python.distance(start.tolist(), origin.tolist())
        if away > model.reach_m + radius + 2.0 * way:
            continue
        _mark_near(rays, start, speed, radius, wide, near)
    return near


@compiled
def _mark_near(rays: Rays, start: Floats, speed: Floats, radius: float, wide: float, near: NDArray[np.bool_]) -> None:
    """Mark the beams that pass a moving sphere nearer than their own width."""
    for i in range(rays.delay_s.shape[0]):
        along = away2 = 0.0
        for axis in range(3):
            part = start[axis] + rays.delay_s[i] * speed[axis] - rays.origin[i, axis]
            along += part * rays.direction[i, axis]
            away2 += part * part
        reach = radius + wide * max(along, 0.0)
        if along > -radius and away2 - along * along <= reach * reach:
            near[i] = True


def _level(attitude: Floats) -> Floats:
    """The attitude of a gimbal: the heading of a body, without its pitch and roll."""
    w, x, y, z = attitude.tolist()
    yaw = elementary_python.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.array([elementary_python.cos(0.5 * yaw), 0.0, 0.0, elementary_python.sin(0.5 * yaw)])


def _find_attitude_error(chance: Chance, name: str) -> Floats:
    """The constant error of a sensor's inertial unit as a quaternion, in local axes."""
    u0, u1, u2, u3 = chance.uniform4(ATTITUDE_STREAM, hash64(name), 0)
    size = math.sqrt(-2.0 * elementary.log(1.0 - u0)) * TILT_RAD
    heading = math.sqrt(-2.0 * elementary.log(1.0 - u2)) * elementary_python.cos(2.0 * math.pi * u3) * HEADING_RAD
    half = (
        np.array(
            [
                size * elementary_python.cos(2.0 * math.pi * u1),
                size * elementary_python.sin(2.0 * math.pi * u1),
                heading,
            ]
        )
        * 0.5
    )
    w = math.sqrt(1.0 - float(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]))
    return np.array([w, *half.tolist()])


def _multiply(a: Floats, b: Floats) -> tuple[float, float, float, float]:
    aw, ax, ay, az = a.tolist()
    bw, bx, by, bz = b.tolist()
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
