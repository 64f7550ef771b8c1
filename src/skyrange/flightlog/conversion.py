"""A scenario of a flight, and what in it is taken from the log, estimated, assumed, or ignored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tomli_w

from skyrange.codec.mission import Mission, format_waypoints
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.flightlog.flights import Flight
from skyrange.flightlog.flown_path import simplify_path
from skyrange.flightlog.model import check_start
from skyrange.flightlog.wind import ATTITUDE_DEG, WindEstimate, estimate_wind
from skyrange.vehicle.builtin.parameters.renames import canonical_name, to_canonical
from skyrange.vehicle.builtin.parameters.table import INDEX, PARAMETERS
from skyrange.world.airframes import AIRFRAMES

SCENARIO: Final = "scenario.toml"
MISSION: Final = "mission.waypoints"
_AIRFRAME: Final = "iris"
_MARGIN_S: Final = 45.0
_MARGIN: Final = 0.5
"""After the flight of the log the scenario goes on for this share of it, at least for `_MARGIN_S`: the simulated flight
may take longer, and nothing is lost by an end that is late.
"""
_MULTIROTORS: Final = frozenset({"QUADROTOR", "HEXAROTOR", "OCTOROTOR", "TRICOPTER", "DODECAROTOR", "COAXIAL", ""})
_TAKEN_PREFIXES: Final = (
    "WPNAV_", "WP_", "RTL_", "LAND_", "LOIT_", "PILOT_", "CIRCLE_", "ANGLE_MAX", "DISARM_DELAY", "WP_YAW_BEHAVIOR",
    "FS_EKF", "FS_GCS", "FS_OPTIONS", "FS_VIBE", "FS_DR", "MIS_", "TKOFF_",
)  # fmt: skip
"""Parameters of navigation and failsafes. Others are of the airframe, its battery, its sensors or its pilot's radio."""

Kind = Literal["taken", "estimated", "assumed", "ignored"]


@dataclass(frozen=True, slots=True)
class Fact:
    """One thing about a flight, and what became of it."""

    kind: Kind
    subject: str
    value: str
    reason: str
    """Where it is from, or why it is not used."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """A scenario of a flight, as the contents of its files."""

    flight: Flight
    scenario: Mapping[str, Any]
    mission: Mission | None
    facts: tuple[Fact, ...]
    wind: WindEstimate | None

    def write(self, folder: Path) -> Path:
        """Write the scenario and its mission into a folder, which is made; the path of the scenario."""
        folder.mkdir(parents=True, exist_ok=True)
        if self.mission is not None:
            with atomic_write(folder / MISSION) as file:
                file.write(format_waypoints(self.mission).encode())
        path = folder / SCENARIO
        flight = self.flight
        head = f"# Flight {flight.number} of {flight.log.path.name!a}, armed at {flight.armed_s:.1f} s of the log.\n"
        with atomic_write(path) as file:
            file.write(head.encode() + tomli_w.dumps(dict(self.scenario)).encode())
        return path


@dataclass(frozen=True, slots=True)
class Estimates:
    """What is estimated of a flight: the wind, or why there is no estimate of it, and the frames of its link."""

    wind: WindEstimate | str
    received: int
    lost: int
    source: str = ""
    """Which other flights they are of; empty if they are of the flight itself."""


def estimate_flight(flight: Flight) -> Estimates:
    """The estimates of a flight from its own rows."""
    rows = flight.rows("link", flight.armed_s, flight.disarmed_s)
    return Estimates(estimate_wind(flight), int(rows["received"].sum()), int(rows["lost"].sum()))


def convert_flight(flight: Flight, name: str, estimates: Estimates | None = None) -> Conversion:
    """The scenario of a flight, with estimates from elsewhere or from itself.

    Raises `InputError` for a vehicle that is no multirotor.
    """
    log = flight.log
    estimates = estimate_flight(flight) if estimates is None else estimates
    if log.vehicle_type not in _MULTIROTORS:
        who = str(log.path)
        raise InputError.one(
            who, "vehicle", log.vehicle_type, "a multirotor", "skyrange has no model of other aircraft."
        )
    facts: list[Fact] = []
    vehicle: dict[str, Any] = {"id": "v1", "airframe": _AIRFRAME, "start": {"east_m": 0.0, "north_m": 0.0}}
    vehicle["start"]["heading_deg"] = _heading_deg(flight, facts)
    vehicle["plan"], mission = _plan(flight, facts)
    vehicle["depart_s"] = 0.0
    if params := _params(log.params, facts):
        vehicle["params"] = params
    lat_deg, lon_deg, alt_m = flight.home
    facts.append(Fact("taken", "home", f"{lat_deg:.7f}°, {lon_deg:.7f}°, {alt_m:.1f} m", flight.home_source))
    armed_s = flight.disarmed_s - flight.armed_s
    scenario: dict[str, Any] = {
        "name": name,
        "seed": 1,
        "duration_s": float(math.ceil(armed_s + max(_MARGIN * armed_s, _MARGIN_S))),
        "start_utc": _start(flight, facts),
        "origin": {"lat": round(lat_deg, 7), "lon": round(lon_deg, 7), "alt_msl_m": round(alt_m, 2)},
    }
    wind, table = _wind(estimates, facts)
    if table:
        scenario["wind"] = table
    scenario["operators"] = [{"id": "pilot", "vehicles": [vehicle]}]
    if channel := _channel(flight, estimates, facts):
        scenario["links"] = [channel]
    _list_assumptions(flight, facts)
    facts += [Fact("ignored", remark.subject, "", remark.text) for remark in log.remarks]
    order = ("taken", "estimated", "assumed", "ignored")
    return Conversion(flight, scenario, mission, tuple(sorted(facts, key=lambda fact: order.index(fact.kind))), wind)


def _heading_deg(flight: Flight, facts: list[Fact]) -> float:
    rows = flight.rows("attitude", flight.armed_s, flight.take_off_s)
    if not len(rows):
        facts.append(Fact("assumed", "heading at the start", "0°", "the log has no attitude before take-off"))
        return 0.0
    heading_deg = round(math.degrees(float(rows["yaw_rad"][-1])) % 360.0, 1)
    facts.append(Fact("taken", "heading at the start", f"{heading_deg:g}°", "the attitude at take-off"))
    return heading_deg


def _plan(flight: Flight, facts: list[Fact]) -> tuple[dict[str, Any], Mission | None]:
    if flight.mission is not None:
        mission = Mission(flight.mission.items, flight.home, source=flight.mission.source)
        reason = "the last mission that was sent as a whole before its end"
        facts.append(Fact("taken", "mission", f"{len(mission.items)} items", reason))
        others = [mode for mode in flight.modes if mode not in ("AUTO", "MISSION")]
        if others:
            text = "the pilot also flew in these modes; the scenario flies the mission alone"
            facts.append(Fact("ignored", "flight modes", ", ".join(dict.fromkeys(others)), text))
        return {"file": MISSION, "anchor": "file"}, mission
    points, speed_mps, off_m = simplify_path(flight)
    reason = "the log has no mission for this flight, or the flight was not in the mode of missions"
    shown = f"{len(points)} waypoints, at most {off_m:.1f} m from the track"
    facts.append(Fact("estimated", "flown path as waypoints", shown, reason))
    facts.append(Fact("estimated", "speed", f"{speed_mps:.1f} m/s", "the median speed over ground of the flight"))
    return {"path": {"points": points}, "end": "land", "speed_mps": speed_mps}, None


def _params(params: Mapping[str, float], facts: list[Fact]) -> dict[str, float]:
    """The parameters of navigation and failsafes that the builtin autopilot has, where it has another value."""
    taken, same, outside, others = {}, 0, [], []
    if not params:
        facts.append(Fact("assumed", "parameters", "the builtin autopilot's defaults", "the log has no parameters"))
    for name, value in sorted(params.items()):
        known = canonical_name(name)
        if known not in INDEX or not known.startswith(_TAKEN_PREFIXES):
            others.append(name)
            continue
        parameter = PARAMETERS[INDEX[known]]
        canonical = to_canonical(name, value)
        if not parameter.low <= canonical <= parameter.high:
            outside.append(f"{name} = {value:g}")
        elif math.isclose(canonical, parameter.default, rel_tol=1e-6, abs_tol=1e-9):
            same += 1
        else:
            taken[name] = round(value, 6)
    if taken:
        shown = ", ".join(f"{name} = {value:g}" for name, value in taken.items())
        facts.append(Fact("taken", "parameters", shown, "of navigation and failsafes, with values of their own"))
    if same:
        facts.append(Fact("taken", "parameters", f"{same}", "have the value that the builtin autopilot has anyway"))
    if outside:
        facts.append(Fact("ignored", "parameters", ", ".join(outside), "outside the builtin autopilot's range"))
    if others:
        reason = "of the real airframe, its battery, sensors, radio or pilot, or unknown to the builtin autopilot"
        facts.append(Fact("ignored", "parameters", f"{len(others)}: {', '.join(others)}", reason))
    return taken


def _start(flight: Flight, facts: list[Fact]) -> datetime:
    started_s = check_start(flight.log.start_unix_s)
    if started_s is None:
        facts.append(Fact("assumed", "start", "2026-01-01 12:00:00 UTC", "the log has no time of day"))
        return datetime(2026, 1, 1, 12, tzinfo=UTC)
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=round(started_s + flight.armed_s))
    source = "the ground station's clock" if flight.log.format in ("tlog", "run") else "GPS time"
    facts.append(Fact("taken", "start", f"{start:%Y-%m-%d %H:%M:%S} UTC", f"arming, by {source}"))
    return start


def _wind(estimates: Estimates, facts: list[Fact]) -> tuple[WindEstimate | None, dict[str, float]]:
    wind = estimates.wind
    if isinstance(wind, str):
        facts.append(Fact("assumed", "wind", "none", wind))
        return None, {}
    shown = f"{wind.speed_mps:.1f} m/s from {wind.from_deg:.0f}°, ± {wind.sd_mps:.1f} m/s (one standard deviation)"
    reason = (
        f"from lean and velocity of {wind.used_s:.0f} s of {estimates.source or 'flight'}, with a drag of "
        f"{wind.drag_per_s:.2f} /s; an error of the attitude of {ATTITUDE_DEG:g}° is assumed"
    )
    facts.append(Fact("estimated", "wind", shown, reason))
    return wind, {"speed_mps": round(wind.speed_mps, 2), "from_deg": round(wind.from_deg, 1)}


def _channel(flight: Flight, estimates: Estimates, facts: list[Fact]) -> dict[str, Any]:
    """The loss of the link to the ground station, from the gaps of sequence numbers while the vehicle flew."""
    received, lost = estimates.received, estimates.lost
    if not received:
        facts.append(Fact("assumed", "link", "no loss", "the log was written on board"))
        return {}
    loss = lost / (received + lost)
    shown = f"{loss:.2%} of {received + lost:,} frames"
    source = f" in {estimates.source}" if estimates.source else ""
    facts.append(Fact("estimated", "loss of telemetry", shown, f"gaps of the frames' sequence numbers{source}"))
    facts.append(Fact("assumed", "loss of commands", f"{loss:.2%}", "a log shows one direction: the other is as good"))
    facts.append(Fact("assumed", "losses", "independent", "each frame has this probability; real ones come in bursts"))
    facts.append(Fact("assumed", "delay of the link", "that of skyrange's default", "a log does not show it"))
    radio = flight.rows("radio", flight.armed_s, flight.disarmed_s)
    if len(radio):
        shown = ", ".join(
            f"{name} {np.median(radio[name]):.0f}" for name in ("rssi", "remote_rssi", "noise", "remote_noise")
        )
        facts.append(
            Fact(
                "ignored",
                "telemetry radio",
                shown,
                'medians of RADIO_STATUS; the scenario has losses alone, where channel = "sik" has such a radio',
            )
        )
    return {"match": "gcs:pilot/*", "mode": "datagram", "loss": round(loss, 5)} if lost else {}


def _list_assumptions(flight: Flight, facts: list[Fact]) -> None:
    log = flight.log
    kind = log.vehicle_type.lower() or "an unknown vehicle"
    facts.append(
        Fact(
            "assumed",
            "airframe",
            f"{_AIRFRAME}, {AIRFRAMES[_AIRFRAME].mass_kg:g} kg",
            f"the log is of {kind}, and has neither its mass nor its size",
        )
    )
    facts.append(Fact("assumed", "autopilot", "builtin", f"the log is of {log.firmware or 'an unknown firmware'}"))
    facts.append(
        Fact("assumed", "turbulence", "none", "the residuals of the wind's estimate are not separated into it")
    )
    battery = flight.rows("battery", flight.armed_s, flight.disarmed_s)
    if len(battery):
        volts = battery["voltage_v"]
        amps = battery["current_a"][np.isfinite(battery["current_a"])]
        shown = f"{volts[0]:.2f} V to {volts[-1]:.2f} V" + (f", {amps.mean():.1f} A on average" if len(amps) else "")
        facts.append(Fact("ignored", "battery", shown, "the scenario has the battery of its airframe, full"))
    else:
        facts.append(Fact("assumed", "battery", "full, of the airframe", "the log has no battery"))
