"""World file for Gazebo 11 and Gazebo Sim, made from a scenario's aircraft, city, place and wind, with its view.

The view of its window: light, colours, and a camera that looks at the fleet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal
from xml.etree.ElementTree import Element, ElementTree, indent

from skyrange.city.city import City
from skyrange.core.geodesy import Origin
from skyrange.vehicle.gazebo.aircraft_model import PlacedAircraft, make_aircraft_model
from skyrange.vehicle.gazebo.building_models import HARD_MU, make_city_models
from skyrange.vehicle.gazebo.sdf_elements import (
    GROUND,
    VERSION,
    WORLD,
    Colour,
    Point,
    add,
    add_friction,
    add_material,
    add_plane,
    add_pose,
    format_numbers,
    visual_name,
)
from skyrange.world.airframes import GRAVITY_MPS2

_SKY: Final = (0.70, 0.80, 0.92, 1.0)
_AMBIENT: Final = (0.55, 0.55, 0.55, 1.0)
_PITCH: Final = math.radians(40.0)
"""Of the camera, downwards: steep enough to see into a street."""
_YAW: Final = math.radians(60.0)
"""Of the camera: it stands in the south-south-west and looks to the north-north-east."""
_NEAREST_M: Final = 4.0
_SIM_WINDOW: Final = (
    ("GzSceneManager", "Scene manager"),
    ("InteractiveViewControl", "View control"),
    ("CameraTracking", "Camera tracking"),
    ("EntityContextMenuPlugin", "Entity context menu"),
    ("SelectEntities", "Select entities"),
    ("WorldStats", "World stats"),
    ("EntityTree", "Entity tree"),
)
"""Plugins of Gazebo Sim's window beside the one that draws. There is no button to pause: skyrange steps the world."""


def add_view(world: Element, aircraft: Sequence[PlacedAircraft], *, sim: bool) -> None:
    """Add light, scene and window to a world; the window of Gazebo Sim if `sim`, otherwise that of Gazebo 11."""
    scene = add(world, "scene")
    add(scene, "ambient", *_AMBIENT)
    add(scene, "background", *_SKY)
    add(scene, "shadows", "false")
    add(scene, "grid", "false")
    sun = add(world, "light", name="sun", type="directional")
    add_pose(sun, (0.0, 0.0, 100.0))
    add(sun, "cast_shadows", "false")
    add(sun, "diffuse", 0.85, 0.85, 0.82, 1.0)
    add(sun, "specular", 0.2, 0.2, 0.2, 1.0)
    add(sun, "direction", -0.4, 0.5, -0.8)
    place = camera_place(aircraft)
    gui = add(world, "gui")
    if not sim:
        camera = add(gui, "camera", name="camera")
        add_pose(camera, place, pitch=_PITCH, yaw=_YAW)
        return
    view = add(gui, "plugin", filename="MinimalScene", name="3D View")
    window = add(view, "gz-gui")
    add(window, "title", "3D View")
    add(window, "property", "false", type="bool", key="showTitleBar")
    add(window, "property", "docked", type="string", key="state")
    add(view, "engine", "ogre2")
    add(view, "scene", "scene")
    add(view, "ambient_light", *_AMBIENT[:3])
    add(view, "background_color", *_SKY[:3])
    add(view, "camera_pose", format_numbers(*place, 0.0, _PITCH, _YAW))
    for file, name in _SIM_WINDOW:
        add(gui, "plugin", filename=file, name=name)


def camera_place(aircraft: Sequence[PlacedAircraft]) -> Point:
    """A place from which a camera at `_PITCH` and `_YAW` has all aircraft within 30 degrees of its axis."""
    places = [(placed.east_m, placed.north_m, placed.up_m) for placed in aircraft] or [(0.0, 0.0, 0.0)]
    spans = [(min(axis), max(axis)) for axis in zip(*places, strict=True)]
    middle = [0.5 * (low + high) for low, high in spans]
    radius_m = 0.5 * math.hypot(*(high - low for low, high in spans))
    away_m = max(_NEAREST_M, 2.0 * radius_m)
    return (
        middle[0] - away_m * math.cos(_PITCH) * math.cos(_YAW),
        middle[1] - away_m * math.cos(_PITCH) * math.sin(_YAW),
        middle[2] + away_m * math.sin(_PITCH),
    )


Flavour = Literal["sim", "classic"]
"""Gazebo Sim (Harmonic and newer), or Gazebo 11."""

FILE: Final = "world.sdf"
"""Name of the world's file in its folder."""
PLUGINS: Final[dict[Flavour, str]] = {"sim": "skyrange::gazebo::Aircraft", "classic": "skyrange"}
"""Name of our plugin in the world."""
_SIM_SYSTEMS: Final = (
    ("gz-sim-physics-system", "gz::sim::systems::Physics"),
    ("gz-sim-user-commands-system", "gz::sim::systems::UserCommands"),
    ("gz-sim-scene-broadcaster-system", "gz::sim::systems::SceneBroadcaster"),
)
_MARGIN_M: Final = 200.0
"""By which the ground that is drawn extends beyond everything else."""
_COLOURS: Final[tuple[Colour, ...]] = (
    (0.0, 0.447, 0.698),
    (0.0, 0.620, 0.451),
    (0.835, 0.369, 0.0),
    (0.8, 0.475, 0.655),
    (0.337, 0.706, 0.914),
    (0.902, 0.624, 0.0),
    (0.941, 0.894, 0.259),
)
"""Okabe and Ito's palette, as in reports: the operators in their order."""


def write_world(
    folder: Path,
    aircraft: Sequence[PlacedAircraft],
    mirrored: Sequence[PlacedAircraft],
    *,
    city: City | None,
    origin: Origin,
    wind_enu_mps: tuple[float, float, float],
    step_s: float,
    flavour: Flavour,
    plugin: Path | None,
) -> Path:
    """Write the world's file and the meshes of its buildings into `folder`, and return the file's path.

    Gazebo moves `aircraft`; it only shows `mirrored` ones. `wind_enu_mps` is for information: the plugin applies the
    drag. The same arguments give the same bytes. Raises `ValueError` if two aircraft have one name or a number is not
    finite, `KeyError` for an unknown airframe, and what `make_city_models` raises.
    """
    everyone = [*aircraft, *mirrored]
    if len({placed.vehicle for placed in everyone}) < len(everyone):
        raise ValueError("each aircraft needs an id of its own")
    folder.mkdir(parents=True, exist_ok=True)
    sdf = Element("sdf", version=VERSION)
    if flavour == "sim":
        sdf.set("xmlns:gz", "http://gazebosim.org/schema")
    world = add(sdf, "world", name=WORLD)
    _add_physics(world, step_s, flavour)
    _add_place(world, origin, wind_enu_mps)
    _add_plugins(world, flavour, plugin)
    add_view(world, everyone, sim=flavour == "sim")
    world.append(_make_ground(everyone, city))
    if city is not None:
        world.extend(make_city_models(city, folder))
    operators = list(dict.fromkeys(placed.operator for placed in everyone))
    for row, placed in enumerate(everyone):
        colour = _COLOURS[operators.index(placed.operator) % len(_COLOURS)]
        world.append(make_aircraft_model(placed, colour, mirrored=row >= len(aircraft)))
    indent(sdf)
    file = folder / FILE
    ElementTree(sdf).write(file, encoding="utf-8", xml_declaration=True)
    return file


def _add_physics(world: Element, step_s: float, flavour: Flavour) -> None:
    """Steps of one length, as fast as possible: skyrange says when to step."""
    physics = add(world, "physics", name="default", type="ode" if flavour == "classic" else "dart")
    add(physics, "max_step_size", step_s)
    add(physics, "real_time_factor", 0.0)
    add(physics, "real_time_update_rate", 0.0)
    if flavour == "classic":
        ode = add(physics, "ode")
        solver = add(ode, "solver")
        add(solver, "type", "quick")
        add(solver, "iters", "50")
        add(solver, "friction_model", "cone_model")  # along the direction of sliding, as in the range
        constraints = add(ode, "constraints")
        add(constraints, "cfm", 0.0)
        add(constraints, "erp", 0.2)
        add(constraints, "contact_max_correcting_vel", 100.0)
        add(constraints, "contact_surface_layer", 0.0)


def _add_place(world: Element, origin: Origin, wind_enu_mps: tuple[float, float, float]) -> None:
    add(world, "gravity", 0.0, 0.0, -GRAVITY_MPS2)
    add(add(world, "wind"), "linear_velocity", *wind_enu_mps)
    add(world, "atmosphere", type="adiabatic")  # its values by default are those of sea level
    place = add(world, "spherical_coordinates")
    add(place, "surface_model", "EARTH_WGS84")
    add(place, "world_frame_orientation", "ENU")
    add(place, "latitude_deg", origin.lat_deg)
    add(place, "longitude_deg", origin.lon_deg)
    add(place, "elevation", origin.ellipsoid_of(origin.alt_msl_m))
    add(place, "heading_deg", 0.0)


def _add_plugins(world: Element, flavour: Flavour, plugin: Path | None) -> None:
    if flavour == "sim":
        add(add(world, "gz:policies"), "include_server_config_plugins", "false")  # the user's own would be added
        for file, name in _SIM_SYSTEMS:
            add(world, "plugin", filename=file, name=name)
    if plugin is not None:
        add(world, "plugin", filename=str(plugin), name=PLUGINS[flavour])


def _make_ground(aircraft: Sequence[PlacedAircraft], city: City | None) -> Element:
    """The static `<model>` of the ground; what is drawn of it reaches beyond city and aircraft."""
    corners = [(placed.east_m, placed.north_m) for placed in aircraft]
    if city is not None:
        corners += [city.bounds[:2], city.bounds[2:]]
    reach_m = _MARGIN_M + max((abs(part) for corner in corners for part in corner), default=0.0)
    model = Element("model", name=GROUND)
    add(model, "static", "true")
    link = add(model, "link", name=GROUND)
    collision = add(link, "collision", name=GROUND)
    add_plane(collision, 2.0 * reach_m, 2.0 * reach_m)
    add_friction(collision, HARD_MU)
    visual = add(link, "visual", name=visual_name(GROUND))
    add_pose(visual, (0.0, 0.0, 0.0))
    add_plane(visual, 2.0 * reach_m, 2.0 * reach_m)
    add_material(visual, (0.42, 0.47, 0.40))
    return model
