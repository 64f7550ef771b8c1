"""What sight says of a claim: honest aircraft are seen, ghosts are not, and nothing is said without a look."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.wall_index import build_wall_index
from skyrange.codec.f3411 import Location, Status, encode
from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.range_scans import LIDAR, RangeScan
from skyrange.codec.remote_id.link_payload import RidHeader, Transport, pack, unpack_rows
from skyrange.contracts.frames import Payloads
from skyrange.core.arrays import Floats
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.optics.extinction import Weather
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.ray_casting import cast_rays
from skyrange.optics.ray_index import RayIndex, build_ray_index
from skyrange.optics.reflectivity import make_surfaces
from skyrange.optics.returns import Address, find_returns
from skyrange.optics.scan_patterns import ScatteredPattern
from skyrange.optics.sensor_models import HAP, VLP_16
from skyrange.optics.sensor_poses import SensorPose, make_pulse_rays, sample_footprint
from skyrange.optics.targets import place_targets
from skyrange.remoteid.tracks import ReceivedBroadcasts, TrackSnapshot, TrackTable
from skyrange.vehicle.sight.air import CLEAR, EXTINCTIONS
from skyrange.vehicle.sight.detections import SightTracks
from skyrange.vehicle.sight.evidence import Verdict
from skyrange.vehicle.sight.fusion import SEEN_ADDRESS
from skyrange.vehicle.sight.witness import Sight, Witness

HERE = np.array([0.0, 0.0, 30.0])
LEVEL = (1.0, 0.0, 0.0, 0.0)
EMPTY = build_ray_index()
NARROW = replace(
    HAP, pattern=ScatteredPattern(rays=7_500, azimuth_deg=(-10.0, 10.0), elevation_deg=(-12.5, 12.5), rate_hz=10.0)
)
"""A sixth of the HAP's field, as dense as the whole."""
FORWARD = MountedSensor("blue/b1", "hap", 0, NARROW, (0.0, 0.0, 0.2))
SCAN_NS = 100 * NS_PER_MS
CLEAR_AIR = Weather()


@cache
def wall(away_m: float) -> RayIndex:
    """A wall across the view, 40 m high."""
    footprint = shapely.box(away_m, -60.0, away_m + 10.0, 60.0)
    return build_ray_index(build_wall_index([Building("w", 40.0, footprint)]))


def scan(
    number: int, seed: int, place: Floats | None, city: RayIndex = EMPTY, weather: Weather = CLEAR_AIR
) -> RangeScan:
    """What the sensor says of an aircraft whose body is at `place`, or of nothing."""
    bodies = np.empty((0, 3)) if place is None else np.array([place - np.array([0.0, 0.0, 0.055])])
    one = np.ones(len(bodies))
    targets = place_targets(city, bodies, 0.0 * bodies, 0.235 * one, 0.11 * one, during_s=0.1)
    firing = FORWARD.list_rays(number)
    pose = SensorPose(HERE, np.zeros(3), np.array(LEVEL), np.zeros(3), np.array(FORWARD.place_m))
    rays = make_pulse_rays(firing, pose, sample_footprint(NARROW, 3, 3))
    address = Address(Chance(seed), 9, number * SCAN_NS)
    returns = find_returns(
        NARROW, firing, cast_rays(city, rays, NARROW.reach_m, targets), make_surfaces(), weather, address
    )
    return RangeScan(LIDAR, 0, number, NARROW.resolution_m, number * SCAN_NS, LEVEL, returns.steps)


def claim(place: Floats) -> TrackSnapshot:
    return TrackSnapshot(
        np.zeros(1, dtype=np.int64), np.array([b"GHOST"], dtype="S20"), np.array([7]), np.array([place]),
        np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


def look(
    claimed: Floats,
    real: Floats | None,
    scans: int,
    seed: int,
    city: RayIndex = EMPTY,
    weather: Weather = CLEAR_AIR,
    extinctions: Sequence[float] = EXTINCTIONS,
) -> tuple[Verdict, int]:
    """The first verdict other than *could not look*, and after how many scans."""
    witness = Witness(Sight([FORWARD], sigma_m=2.0, extinctions=extinctions), city)
    for number in range(scans):
        beams = witness.place_beams(scan(number, seed, real, city, weather), HERE, np.zeros(3), number * SCAN_NS)
        for change in witness.look(number * SCAN_NS, 0, beams, claim(claimed)):
            return change.verdict, number + 1
    return Verdict.COULD_NOT_LOOK, scans


def error(seed: int) -> Floats:
    """Of a position: three independent normal deviates of 2 m."""
    u = [Chance(seed).uniform4("test", axis, 0) for axis in range(3)]
    normal = [math.sqrt(-2.0 * math.log(1.0 - a)) * math.cos(2.0 * math.pi * b) for a, b, _, _ in u]
    return 2.0 * np.array(normal)


@pytest.mark.parametrize("away_m", [45.0, 60.0])
def test_honest_aircraft_are_seen_and_ghosts_are_not(away_m: float) -> None:
    """Of 24 each, with errors of the position as assumed; each rate of error is 1 % by the assumptions."""
    claimed = np.array([away_m, 0.0, 30.2])
    honest = [look(claimed, claimed + error(seed), 60, seed)[0] for seed in range(24)]
    ghosts = [look(claimed, None, 60, seed)[0] for seed in range(24)]
    assert honest.count(Verdict.NOT_SEEN) <= 1
    assert honest.count(Verdict.SEEN) >= 22
    assert ghosts.count(Verdict.SEEN) <= 1
    assert ghosts.count(Verdict.NOT_SEEN) >= 22


FOGS = [Weather(visibility_m=100.0), Weather(visibility_m=500.0), Weather(10.0, rain_law="goodin"), Weather(25.0)]


@pytest.mark.parametrize("weather", FOGS)
def test_weather_hides_aircraft_and_makes_none_of_them_a_ghost(weather: Weather) -> None:
    """By the ground the companion knows how far light comes."""
    claimed = np.array([60.0, 0.0, 30.2])
    honest = [look(claimed, claimed + error(seed), 40, seed, weather=weather)[0] for seed in range(12)]
    assert honest.count(Verdict.NOT_SEEN) == 0


def test_who_takes_the_air_to_be_clear_calls_aircraft_in_fog_ghosts() -> None:
    claimed = np.array([60.0, 0.0, 30.2])
    fog = Weather(visibility_m=200.0)
    assert look(claimed, claimed, 60, 1, weather=fog, extinctions=CLEAR)[0] is Verdict.NOT_SEEN
    assert look(claimed, claimed, 60, 1, weather=fog)[0] is Verdict.COULD_NOT_LOOK


def test_near_enough_a_ghost_is_found_out_in_fog_too() -> None:
    """A wall at 60 m returns light through a fog in which an aircraft at 40 m would."""
    claimed = np.array([40.0, 0.0, 30.2])
    fog = Weather(visibility_m=1_000.0)
    assert look(claimed, None, 60, 1, wall(60.0), fog)[0] is Verdict.NOT_SEEN
    assert look(claimed, claimed, 60, 1, wall(60.0), fog)[0] is Verdict.SEEN


def test_farther_away_it_takes_longer() -> None:
    near, far = (look(np.array([away, 0.0, 30.2]), None, 200, 1, extinctions=CLEAR) for away in (45.0, 90.0))
    assert near[0] is far[0] is Verdict.NOT_SEEN
    assert near[1] < far[1]


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ([400.0, 0.0, 30.0], "out of range"),
        ([-45.0, 0.0, 30.0], "behind"),
        ([12.0, 0.0, 30.0], "near: the field does not cover the gate"),
        ([45.0, 0.0, 40.0], "at the edge of the field"),
    ],
)
def test_where_no_beam_goes_nothing_is_said(place: list[float], why: str) -> None:
    assert look(np.array(place), None, 40, 1)[0] is Verdict.COULD_NOT_LOOK, why


def test_behind_a_wall_and_in_front_of_one_nothing_is_said() -> None:
    assert look(np.array([60.0, 0.0, 30.0]), None, 40, 1, wall(40.0))[0] is Verdict.COULD_NOT_LOOK
    assert look(np.array([60.0, 0.0, 30.0]), None, 40, 1, wall(62.0))[0] is Verdict.COULD_NOT_LOOK
    clear = look(np.array([60.0, 0.0, 30.0]), None, 60, 1, wall(100.0), extinctions=CLEAR)
    assert clear[0] is Verdict.NOT_SEEN


def test_what_is_nearer_and_not_on_the_map_hides_the_claim() -> None:
    """The companion's map lacks the wall."""
    witness = Witness(Sight([FORWARD], sigma_m=2.0), EMPTY)
    for number in range(40):
        beams = witness.place_beams(scan(number, 1, None, wall(30.0)), HERE, np.zeros(3), number * SCAN_NS)
        assert witness.look(number * SCAN_NS, 0, beams, claim(np.array([60.0, 0.0, 30.2]))) == []


def test_a_verdict_lasts_ten_seconds_after_the_last_look_that_reached_it() -> None:
    witness = Witness(Sight([FORWARD], sigma_m=2.0), EMPTY)
    verdicts = []
    for number in range(260):  # it comes nearer until the field no longer covers the gate
        place = np.array([max(60.0 - 2.0 * number, 8.0), 0.0, 30.2])
        beams = witness.place_beams(scan(number, 1, None), HERE, np.zeros(3), number * SCAN_NS)
        verdicts += [(number, c.verdict) for c in witness.look(number * SCAN_NS, 0, beams, claim(place))]
    assert [verdict for _, verdict in verdicts] == [Verdict.NOT_SEEN, Verdict.COULD_NOT_LOOK]
    assert 100 < verdicts[1][0] < 130
    copy = deepcopy(witness)
    copy.forget(1_000 * SCAN_NS)
    assert copy.verdict((7, b"GHOST")) is Verdict.COULD_NOT_LOOK


def test_sight_follows_an_aircraft_that_no_radio_tells_of_and_no_noise() -> None:
    tracks, witness = SightTracks(), Witness(Sight([FORWARD]), wall(90.0))
    found = []
    for number in range(40):
        place = np.array([40.0 - 0.5 * number, 1.0, 30.2])
        beams = witness.place_beams(scan(number, 3, place, wall(90.0)), HERE, np.zeros(3), number * SCAN_NS)
        found += [(place, t) for t in tracks.update(number * SCAN_NS, beams, wall(90.0), np.empty((0, 3)), 7.0)]
    assert len(found) > 20
    assert {track.number for _, track in found} == {found[0][1].number}
    place, last = found[-1]
    assert last.velocity == pytest.approx([-5.0, 0.0, 0.0], abs=1.5)
    none = SightTracks()
    for number in range(40):
        beams = witness.place_beams(scan(number, 4, None, wall(90.0)), HERE, np.zeros(3), number * SCAN_NS)
        assert none.update(number * SCAN_NS, beams, wall(90.0), np.empty((0, 3)), 7.0) == []


def test_a_pattern_that_repeats_counts_less_than_one_that_does_not() -> None:
    rotating = MountedSensor("blue/b1", "vlp", 0, VLP_16, (0.0, 0.0, 0.2))
    views = [Witness(Sight([sensor]), EMPTY)._views[0] for sensor in (FORWARD, rotating)]
    assert [view.sensor.period_ns / view.apart_ns for view in views] == [1.0, pytest.approx(0.2)]


def test_no_flood_of_broadcasts_displaces_what_sight_has_seen() -> None:
    table = TrackTable(1, Origin(40.0, -73.0), max_tracks=4)
    table.place(0, SEEN_ADDRESS, NS_PER_S, np.array([1.0, 2.0, 30.0]), np.zeros(3))
    message = Location(Status.AIRBORNE, lat_deg=40.0, lon_deg=-73.0, alt_geo_m=30.0)
    for sender in range(20):
        header = RidHeader(Transport.WIFI_BEACON, address=sender.to_bytes(6, "big"), rssi_cdbm=-2000)
        rid = unpack_rows(Payloads.of([pack(header, encode(message))]))
        one = np.zeros(1, dtype=np.int64)
        table.update(ReceivedBroadcasts(one, one + NS_PER_S, rid, decode_locations(rid.bodies), one, one))
    assert table.counts[0].tolist()[:2] == [17, 0]
    assert SEEN_ADDRESS in table.snapshot(0, NS_PER_S).address.tolist()
