"""Optics in a scenario: the LiDARs and depth cameras of aircraft, and what light meets and passes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, Strict, model_validator

from skyrange.contracts.params import Enu
from skyrange.core.errors import Problem, nearest
from skyrange.optics.extinction import RainLaw, Weather
from skyrange.optics.mounted_sensors import SensorModel
from skyrange.optics.reflectivity import MATERIALS
from skyrange.optics.returns import MAX_STEPS, make_detector
from skyrange.optics.scan_patterns import PixelGrid, RotatingPattern, ScatteredPattern, count_pulses
from skyrange.optics.sensor_models import D435, HAP, LIDAR_LITE_V3HP, MID_360, VLP_16, DepthCameraModel, LidarModel
from skyrange.scenario.model.base import Id, Model, Number, Whole, refuse, wrong

MODELS: Final[dict[str, SensorModel]] = {
    "vlp-16": VLP_16,
    "mid-360": MID_360,
    "hap": HAP,
    "lidar-lite-v3hp": LIDAR_LITE_V3HP,
    "d435": D435,
}
"""By the name that a scenario has for it."""
MAX_SENSORS: Final = 8
"""Sensors of one aircraft at most."""
MAX_RAYS: Final = 1_000_000
"""Pulses or pixels of a scan at most."""
Pair = tuple[Number, Number]


def _known_model(name: str) -> str:
    if name not in MODELS:
        raise wrong(name, f"a model of a sensor: {', '.join(MODELS)}", nearest(name, MODELS))
    return name


def _known_material(name: str) -> str:
    if name not in MATERIALS:
        raise wrong(name, f"a material: {', '.join(MATERIALS)}", nearest(name, MATERIALS))
    return name


Material = Annotated[str, AfterValidator(_known_material)]
Elevation = Annotated[Number, Field(ge=-90, le=90)]
_OF_LIDARS: Final = ("drop_out", "false_alarm", "divergence_mrad", "noise_m")
_OF_PATTERNS: Final = {
    "beams_deg": (RotatingPattern, "a rotating LiDAR, such as vlp-16"),
    "azimuths": (RotatingPattern, "a rotating LiDAR, such as vlp-16"),
    "pulses": (ScatteredPattern, "a solid-state LiDAR, such as mid-360"),
    "azimuth_deg": (ScatteredPattern, "a solid-state LiDAR, such as mid-360"),
    "elevation_deg": (ScatteredPattern, "a solid-state LiDAR, such as mid-360"),
    "pixels": (PixelGrid, "a depth camera, such as d435"),
    "field_deg": (PixelGrid, "a depth camera, such as d435"),
}
"""By key: the pattern of the sensors that have it."""


class OpticalSensor(Model):
    """A LiDAR or a depth camera of an aircraft. Keys that are left out are those of the model's data sheet."""

    id: Id = Field(
        default="",
        description="Name, unique on the aircraft; default: the model's, with a number from the second on.",
        json_schema_extra={"default": None},
    )
    model: Annotated[str, AfterValidator(_known_model)] = Field(
        description="Model: vlp-16 (rotating LiDAR), mid-360 and hap (solid-state LiDARs), lidar-lite-v3hp "
        "(single beam), or d435 (depth camera)."
    )
    place_m: Enu | None = Field(
        default=None,
        description="Place on the body, [forward, left, up] in metres from the bottom of the gear, outside the "
        "cylinder that encloses the aircraft; default: on top, or in front if it looks down.",
    )
    yaw_deg: Number = Field(
        default=0.0, ge=-360, le=360, description="Direction to which it points, in degrees clockwise from the nose."
    )
    pitch_deg: Number = Field(
        default=0.0, ge=-90, le=90, description="And above the horizon of the body; -90 looks down."
    )
    stabilised: Annotated[bool, Strict()] = Field(
        default=False, description="Whether a gimbal keeps it level. It then follows the heading of the aircraft alone."
    )
    to_autopilot: Literal["distance", "obstacles"] | None = Field(
        default=None,
        description="What the companion sends the autopilot of its scans, ten times a second at most. distance: "
        "DISTANCE_SENSOR, of a single beam that looks down, up or level; obstacles: OBSTACLE_DISTANCE, the nearest "
        "returns around, of another sensor; default: nothing.",
    )
    rate_hz: Number | None = Field(
        default=None,
        gt=0,
        le=400,
        description="Scans or images per second; the time between two is a multiple of 2.5 ms.",
    )
    range_m: Number | None = Field(
        default=None, gt=0, le=1000, description="Greatest distance or depth that it reports, in metres."
    )
    noise_m: Number | None = Field(
        default=None,
        ge=0,
        le=10,
        description="Of a LiDAR: standard deviation of the distance to a near surface, in metres.",
    )
    drop_out: Number | None = Field(
        default=None, ge=0, le=1, description="Of a LiDAR: probability that a pulse is lost, whatever it meets."
    )
    false_alarm: Number | None = Field(
        default=None, gt=0, lt=0.5, description="Of a LiDAR: probability that a pulse returns noise as a distance."
    )
    divergence_mrad: tuple[Annotated[Number, Field(gt=0, le=100)], Annotated[Number, Field(gt=0, le=100)]] | None = (
        Field(default=None, description="Of a LiDAR: width of the beam, [across, up] in milliradians.")
    )
    beams_deg: tuple[Elevation, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=256,
        description="Of a rotating LiDAR: elevations of its beams in degrees, in the order in which they fire.",
    )
    azimuths: Whole | None = Field(
        default=None, ge=1, le=100_000, description="Of a rotating LiDAR: how often each beam fires in a turn."
    )
    pulses: Whole | None = Field(
        default=None, ge=1, le=MAX_RAYS, description="Of a solid-state LiDAR: pulses of a scan."
    )
    azimuth_deg: tuple[Annotated[Number, Field(ge=-180, le=180)], Annotated[Number, Field(ge=-180, le=180)]] | None = (
        Field(default=None, description="Of a solid-state LiDAR: field across, [from, to] in degrees.")
    )
    elevation_deg: tuple[Elevation, Elevation] | None = Field(
        default=None, description="Of a solid-state LiDAR: field up, [from, to] in degrees."
    )
    pixels: tuple[Annotated[Whole, Field(ge=1, le=4096)], Annotated[Whole, Field(ge=1, le=4096)]] | None = Field(
        default=None, description="Of a depth camera: [width, height]."
    )
    field_deg: tuple[Annotated[Number, Field(gt=0, lt=180)], Annotated[Number, Field(gt=0, lt=180)]] | None = Field(
        default=None, description="Of a depth camera: field of view, [horizontal, vertical] in degrees."
    )

    @model_validator(mode="after")
    def _of_its_kind(self) -> OpticalSensor:
        model = MODELS[self.model]
        given = {
            key: repr(getattr(self, key)) for key in (*_OF_LIDARS, *_OF_PATTERNS) if getattr(self, key) is not None
        }
        problems = [
            Problem(key, given[key], f"a LiDAR; {self.model} is a depth camera")
            for key in _OF_LIDARS
            if key in given and not isinstance(model, LidarModel)
        ]
        problems += [
            Problem(key, given[key], f"{what}; {self.model} is none")
            for key, (pattern, what) in _OF_PATTERNS.items()
            if key in given and not isinstance(model.pattern, pattern)
        ]
        for key in ("azimuth_deg", "elevation_deg"):
            span = getattr(self, key)
            if span is not None and not span[0] < span[1]:
                problems.append(Problem(key, repr(list(span)), "[from, to], the lesser angle first"))
        if problems:
            raise refuse(*problems)
        if self.rate_hz is not None and not math.isclose(400.0 / self.rate_hz, round(400.0 / self.rate_hz)):
            near = 400.0 / round(400.0 / self.rate_hz)
            hint = f"Set {near:.6g}, which is the nearest such rate."
            raise wrong(f"{self.rate_hz:g}", "a rate whose period is a multiple of 2.5 ms", hint, where="rate_hz")
        made = self.make()
        if count_pulses(made.pattern) > MAX_RAYS:
            raise wrong(
                f"{count_pulses(made.pattern):,} pulses a scan", f"at most {MAX_RAYS:,}", "Reduce beams or azimuths."
            )
        if made.near_m >= made.reach_m:
            raise wrong(f"{made.reach_m:g}", f"more than {made.near_m:g} m, what it sees nearest", where="range_m")
        if made.reach_m > MAX_STEPS * made.resolution_m:
            most = MAX_STEPS * made.resolution_m
            raise wrong(f"{made.reach_m:g}", f"at most {most:g} m, what its 16 bits hold", where="range_m")
        if isinstance(made, LidarModel):
            make_detector(made)
        return self

    def make(self) -> SensorModel:
        """The model of the data sheet with the keys that are set."""
        model = MODELS[self.model]
        common: dict[str, Any] = {} if self.range_m is None else {"reach_m": self.range_m}
        if isinstance(model, DepthCameraModel):
            grid = model.pattern
            width, height = self.pixels or (grid.width, grid.height)
            pattern = PixelGrid(width, height, self.field_deg or grid.field_deg, self.rate_hz or grid.rate_hz)
            return replace(model, pattern=pattern, **common)
        for key in ("noise_m", "drop_out", "false_alarm"):
            if getattr(self, key) is not None:
                common[key] = getattr(self, key)
        if self.divergence_mrad is not None:
            across, up = self.divergence_mrad
            common["divergence_rad"] = (across * 1e-3, up * 1e-3)
        return replace(model, pattern=self._make_pattern(model), **common)

    def _make_pattern(self, model: LidarModel) -> Any:
        pattern: Any = model.pattern
        rate_hz = self.rate_hz or pattern.rate_hz
        if isinstance(pattern, RotatingPattern):
            beams = self.beams_deg or pattern.elevation_deg
            sequence_s = pattern.sequence_s if self.azimuths is None else 1.0 / (rate_hz * self.azimuths)
            return RotatingPattern(beams, sequence_s, min(pattern.firing_s, sequence_s / len(beams)), rate_hz)
        if isinstance(pattern, ScatteredPattern):
            return ScatteredPattern(
                self.pulses or pattern.rays,
                self.azimuth_deg or pattern.azimuth_deg,
                self.elevation_deg or pattern.elevation_deg,
                rate_hz,
            )
        return replace(pattern, rate_hz=rate_hz)


class Optics(Model):
    """What the light of sensors meets and passes."""

    rain_mmph: Number = Field(default=0.0, ge=0, le=300, description="Rain rate in mm/h.")
    rain_law: RainLaw = Field(
        default="p1814",
        description="Extinction by rain. p1814: ITU-R P.1814-1; goodin: Goodin et al. 2019, about thirty times as "
        "much.",
    )
    visibility_m: Number | None = Field(
        default=None, gt=0, le=1e6, description="Visibility in fog or haze, in metres; default: clear air."
    )
    ground: Material = Field(default="asphalt", description="Material of the ground.")
    walls: Material = Field(default="concrete", description="Material of all buildings.")
    aircraft: Material = Field(default="aircraft", description="Material of all aircraft.")
    shape: Literal["body", "outline"] = Field(
        default="body",
        description="Aircraft as light meets them. body: the box from which the drag is computed, without arms, "
        "propellers and gear; outline: the cylinder of collisions, most of which is air. The truth is between the two.",
    )

    @property
    def weather(self) -> Weather:
        """The weather in the form that optics use."""
        visibility_m = math.inf if self.visibility_m is None else self.visibility_m
        return Weather(self.rain_mmph, visibility_m, self.rain_law)


def name_sensors(sensors: tuple[OpticalSensor, ...]) -> tuple[OpticalSensor, ...]:
    """The sensors of an aircraft with every id filled in."""
    taken = {sensor.id for sensor in sensors}
    named = []
    for sensor in sensors:
        if not sensor.id:
            name, number = sensor.model, 1
            while name in taken:
                number += 1
                name = f"{sensor.model}-{number}"
            taken.add(name)
            sensor = sensor.model_copy(update={"id": name})
        named.append(sensor)
    return tuple(named)
