"""Model of an aircraft for Gazebo: one rigid body, with its collisions and what is drawn of it.

The model's origin is the bottom of the landing gear. The body's axes are forward, left and up (REP 103). There are no
joints: the plugin applies the thrust and drag of rotors to the body.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element

from skyrange.vehicle.gazebo.sdf_elements import (
    BODY,
    FRAME,
    Colour,
    Point,
    add,
    add_box,
    add_cylinder,
    add_friction,
    add_material,
    add_pose,
    bar_between,
    model_name,
    rotor_name,
    visual_name,
)
from skyrange.world.airframes import AIRFRAMES, Airframe

ROTOR_M: Final = 0.02
"""Thickness of a rotor's disc."""
_MAX_VEL_MPS: Final = 0.1
"""Speed at which Gazebo 11 pushes apart what overlaps; a crash is stopped by the contact itself."""
_MIN_DEPTH_M: Final = 1e-5
"""Overlap that Gazebo 11 leaves alone: what stands on the ground keeps its contacts, and does not sink in visibly."""
_DARK: Final[Colour] = (0.12, 0.12, 0.13)
_FRONT: Final[Colour] = (0.95, 0.95, 0.95)


class PlacedAircraft(NamedTuple):
    """An aircraft and the place of its gear at the start; `heading_deg` is clockwise from north."""

    vehicle: str
    operator: str
    airframe: str
    east_m: float
    north_m: float
    up_m: float
    heading_deg: float


def make_aircraft_model(aircraft: PlacedAircraft, colour: Colour, *, mirrored: bool = False) -> Element:
    """The `<model>` of an aircraft in the colour of its operator.

    A `mirrored` one only shows where another simulator moves it: static, without collisions. Raises `KeyError` for an
    unknown airframe.
    """
    airframe = AIRFRAMES[aircraft.airframe]
    model = Element("model", name=model_name(aircraft.vehicle))
    yaw = math.radians(90.0 - aircraft.heading_deg)
    add_pose(model, (aircraft.east_m, aircraft.north_m, aircraft.up_m), yaw=math.remainder(yaw, math.tau))
    add(model, "static", mirrored)
    add(model, "self_collide", "false")
    add(model, "allow_auto_disable", "false")  # a body at rest is stepped like any other
    link = add(model, "link", name=BODY)
    if not mirrored:
        _add_inertial(link, airframe)
        _add_collisions(link, airframe)
    _add_visuals(link, airframe, colour)
    return model


def _add_inertial(link: Element, airframe: Airframe) -> None:
    inertial = add(link, "inertial")
    add_pose(inertial, (0.0, 0.0, airframe.cg_height_m))
    add(inertial, "mass", airframe.mass_kg)
    inertia = add(inertial, "inertia")
    for tag, moment in zip(("ixx", "iyy", "izz"), airframe.inertia_kgm2, strict=True):
        add(inertia, tag, moment)
    for tag in ("ixy", "ixz", "iyz"):
        add(inertia, tag, 0.0)


def _add_collisions(link: Element, airframe: Airframe) -> None:
    """The frame, a box as wide as the gear up to the rotors, and the discs of the rotors at the top."""
    side_m, high_m = 2.0 * airframe.gear_half_track_m, airframe.height_m - ROTOR_M
    frame = add(link, "collision", name=FRAME)
    add_pose(frame, (0.0, 0.0, 0.5 * high_m))
    add_box(frame, (side_m, side_m, high_m))
    _add_surface(frame, airframe)
    for rotor, place in enumerate(_rotor_places(airframe)):
        disc = add(link, "collision", name=rotor_name(rotor))
        add_pose(disc, place)
        add_cylinder(disc, airframe.propeller_m, ROTOR_M)
        _add_surface(disc, airframe)


def _add_surface(collision: Element, airframe: Airframe) -> None:
    surface = add_friction(collision, airframe.friction)
    bounce = add(surface, "bounce")
    add(bounce, "restitution_coefficient", 0.0)
    ode = add(add(surface, "contact"), "ode")
    add(ode, "max_vel", _MAX_VEL_MPS)
    add(ode, "min_depth", _MIN_DEPTH_M)


def _rotor_places(airframe: Airframe) -> list[Point]:
    """Centres of the rotors' discs, in motor order."""
    up_m = airframe.height_m - 0.5 * ROTOR_M
    return [(rotor.forward_m, rotor.left_m, up_m) for rotor in airframe.rotors]


def _add_visuals(link: Element, airframe: Airframe, colour: Colour) -> None:
    """A hull, arms, legs and rotors; those in front are white."""
    arm_m, deck_m = airframe.arm_m, airframe.height_m - 2.0 * ROTOR_M
    hull_m = min(0.35 * airframe.height_m, 0.08)
    hull = add(link, "visual", name="hull")
    add_pose(hull, (0.0, 0.0, deck_m - 0.5 * hull_m))
    add_box(hull, (0.8 * arm_m, 0.5 * arm_m, hull_m))
    add_material(hull, colour)
    for rotor, place in enumerate(_rotor_places(airframe)):
        ahead = airframe.rotors[rotor].forward_m > 0.0
        disc = add(link, "visual", name=visual_name(rotor_name(rotor)))
        add_pose(disc, place)
        add_cylinder(disc, airframe.propeller_m, 0.25 * ROTOR_M)
        add(disc, "transparency", 0.35)
        add_material(disc, _FRONT if ahead else colour)
        end = (place[0], place[1], deck_m)
        _add_bar(link, f"arm_{rotor}", (0.0, 0.0, deck_m - 0.5 * hull_m), end, 0.05 * arm_m, _FRONT if ahead else _DARK)
    track_m = airframe.gear_half_track_m
    for side, left_m in (("left", track_m), ("right", -track_m)):
        skid_m = 0.06 * arm_m
        for leg, forward_m in (("front", 0.25 * arm_m), ("rear", -0.25 * arm_m)):
            top = (forward_m, math.copysign(min(0.2 * arm_m, track_m), left_m), deck_m - 0.5 * hull_m)
            _add_bar(link, f"leg_{leg}_{side}", (forward_m, left_m, skid_m), top, 0.6 * skid_m, _DARK)
        ends = ((-0.6 * track_m, left_m, skid_m), (0.6 * track_m, left_m, skid_m))
        _add_bar(link, f"skid_{side}", *ends, skid_m, _DARK)


def _add_bar(link: Element, name: str, start: Point, end: Point, radius_m: float, colour: Colour) -> None:
    centre, length_m, pitch, yaw = bar_between(start, end)
    bar = add(link, "visual", name=name)
    add_pose(bar, centre, pitch=pitch, yaw=yaw)
    add_cylinder(bar, radius_m, length_m)
    add_material(bar, colour)
