"""Spoofed returns: pulses that are relayed with a delay, or predicted, make a LiDAR see an object that is not there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.light import LIGHT_M_PER_NS, even_choice
from skyrange.attack.bases.pulses import SendsPulses
from skyrange.optics.ray_casting import AIRCRAFT, Rays, cast_rays
from skyrange.optics.ray_index import RayIndex, build_ray_index
from skyrange.optics.targets import place_targets


@lru_cache(maxsize=1)
def _open_sky() -> RayIndex:
    return build_ray_index()


@sky.attack(
    "lidar.relay",
    surface=("lidar",),
    places=("at", "object_m"),
    effect="the LiDAR sees an object that is not there, and a companion that believes it avoids it",
    technique="EX-0014.03",
    knowledge="the scan pattern and the times of the pulses of the LiDAR's model, and where the aircraft is",
    equipment="a photodiode, a delay or a copy of the pulse train, a laser of the LiDAR's wavelength, and a mount that "
    "tracks the aircraft",
    budget="a pulse for each point",
    realism={
        "returns": "simulated: the echoes of an upright cylinder for the pulses of the scan, with the sensor's noise",
        "principle": "cited: relay with a delay (Petit et al., Black Hat Europe 2015, on an IBEO LUX 3); points nearer "
        "than the attacker (Shin et al., Illusion and Dazzle, CHES 2017, on a VLP-16)",
        "number of points": "assumed: reported, papers not read: about 60 (Cao et al., CCS 2019), 200 (Sun et al., "
        "USENIX Security 2020), far more with later equipment (Sato et al., NDSS 2024); assumed: `reach_deg`",
        "generations": "assumed: reported, paper not read: random times of pulses and fingerprints hinder chosen "
        "points (Sato et al., NDSS 2024); assumed: span of the times and share that is accepted",
        "strength": "assumed: stronger than any true echo within `range_m`",
        "aim at an aircraft": "assumed: beam, aiming error and delay of the tracking; not shown on aircraft: all cited "
        "experiments are with cars or in rooms",
    },
)  # fmt: skip
class Relay(SendsPulses):
    """Makes a LiDAR see an object that is not there, by pulses that are relayed with a delay or sent at known times."""

    vehicles: sky.Victims = sky.param("Aircraft whose LiDARs are lied to, such as ['blue/b1'].")
    object_m: sky.Enu = sky.param(
        "Place of the false object at the start of the attack: centre of its bottom, [east_m, north_m, up_m] in metres "
        "from the origin or the attack's anchor."
    )
    velocity_mps: sky.Enu = sky.param(
        "Velocity of the false object, [east, north, up] in m/s.", default=(0.0, 0.0, 0.0)
    )
    radius_m: sky.Number = sky.param("Radius of the false object in metres.", default=0.3, gt=0, le=100)
    height_m: sky.Number = sky.param("Height of the false object in metres.", default=0.3, gt=0, le=100)
    points: sky.Whole = sky.param("Points that it can place in a scan at most.", default=200, ge=1, le=1_000_000)
    delay_ns: sky.Number | None = sky.param(
        "Least delay in nanoseconds of a relay that answers the pulses it receives: its points are only in the "
        "direction to itself, and farther than itself. Default: pulses at predicted times, anywhere within "
        "`reach_deg`.",
        default=None, ge=0, le=1e6,
    )  # fmt: skip
    seen_deg: sky.Number = sky.param(
        "Of a relay that answers pulses: width in degrees of the cone in which it receives them.",
        default=1.0, gt=0, le=180,
    )  # fmt: skip

    def shine(self, now: sky.Time, light: sky.ScanLight, pulses: NDArray[np.int64]) -> None:
        """Place the points."""
        if self.delay_ns is not None:
            seen = self.find_lit(light, min(self.seen_deg, self.reach_deg))
            pulses = pulses[seen[pulses]]
        distance = self._meet(now, light, pulses)
        if self.delay_ns is not None:
            least = self.distance_from(light, pulses) + 0.5 * LIGHT_M_PER_NS * self.delay_ns
            distance = np.where(distance >= least, distance, np.inf)
        met = even_choice(np.flatnonzero(np.isfinite(distance)), self.points)
        taken = self.time_pulses(now, light, pulses[met], distance[met], predicted=self.delay_ns is None)
        told = np.isfinite(taken)
        light.false_echo_m[pulses[met][told]] = taken[told]

    def _meet(self, now: sky.Time, light: sky.ScanLight, pulses: NDArray[np.int64]) -> sky.Floats:
        """(n,): the distances at which pulses would meet the false object; infinite for those that would not."""
        since_s = (now - self.schedule.start_ns) / sky.NS_PER_S
        velocity = np.array([self.velocity_mps])
        place = np.array([self.object_m]) + since_s * velocity
        target = place_targets(_open_sky(), place, velocity, np.array([self.radius_m]), np.array([self.height_m]))
        rays = Rays(
            light.origin[pulses], light.direction[pulses], light.delay_s[pulses], np.full(len(pulses), -1, np.int32)
        )
        hits = cast_rays(_open_sky(), rays, light.reach_m, target)
        return np.where(hits.kind == AIRCRAFT, hits.distance_m, np.inf)  # else the ground
