"""View of Gazebo's window: light, colours, and a camera that looks at the fleet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final
from xml.etree.ElementTree import Element

from skyrange.vehicle.gazebo.aircraft_model import PlacedAircraft
from skyrange.vehicle.gazebo.sdf_elements import Point, add, add_pose, format_numbers

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


def add_view(world: Element, aircraft: Sequence[PlacedAircraft], sim: bool) -> None:
    """Add light, scene and window to a world; the window of Gazebo Sim if `sim`, otherwise that of Gazebo 11."""
    scene = add(world, "scene")
    add(scene, "ambient", *_AMBIENT)
    add(scene, "background", *_SKY)
    add(scene, "shadows", False)
    add(scene, "grid", False)
    sun = add(world, "light", name="sun", type="directional")
    add_pose(sun, (0.0, 0.0, 100.0))
    add(sun, "cast_shadows", False)
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
    add(window, "property", False, type="bool", key="showTitleBar")
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
    places = [(one.east_m, one.north_m, one.up_m) for one in aircraft] or [(0.0, 0.0, 0.0)]
    spans = [(min(axis), max(axis)) for axis in zip(*places, strict=True)]
    middle = [0.5 * (low + high) for low, high in spans]
    radius_m = 0.5 * math.hypot(*(high - low for low, high in spans))
    away_m = max(_NEAREST_M, 2.0 * radius_m)
    return (
        middle[0] - away_m * math.cos(_PITCH) * math.cos(_YAW),
        middle[1] - away_m * math.cos(_PITCH) * math.sin(_YAW),
        middle[2] + away_m * math.sin(_PITCH),
    )
