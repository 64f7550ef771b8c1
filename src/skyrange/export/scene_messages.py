"""Messages that draw a run: its buildings, and a shape with a name for each aircraft.

An aircraft's shape is locked to its frame, so it moves with the poses and is sent once. A reader that jumps to
another time takes up the last message of each topic alone: each message therefore has all that its topic draws.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import shapely

from skyrange.core.errors import InputError
from skyrange.core.time import Time
from skyrange.export.foxglove_schemas import SCENE_UPDATE
from skyrange.export.timed_message import TimedMessage, color_json, time_json
from skyrange.figures.palette import ThemeColour
from skyrange.radio_map.city_mesh import Corner, prism_triangles

ROOT_FRAME: Final = "enu"
"""The frame of all positions: x east, y north, z up of the origin, in metres."""
BUILDINGS_TOPIC: Final = "/scene/buildings"
AIRCRAFT_TOPIC: Final = "/scene/aircraft"
TOPIC_BUILDINGS: Final = 5_000
"""Number of buildings in one message; those of a larger city are in several topics."""

UNKNOWN_COLOUR: Final = ThemeColour("#6b7480", "#8a93a0")
"""Of an aircraft that the manifest does not declare, as in the honest arm."""
_BUILDING_COLOUR: Final = "#9aa3af"
_FORWARD: Final = '{"position":{"x":0,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}}'
_ABOVE: Final = '{"position":{"x":0,"y":0,"z":1.5},"orientation":{"x":0,"y":0,"z":0,"w":1}}'
_FOREVER: Final = '{"sec":0,"nsec":0}'


def building_messages(city: Sequence[Mapping[str, Any]], start_ns: int, who: str) -> Iterator[TimedMessage]:
    """The buildings (`RunRecord.city`) at time 0; none without buildings.

    Raises `InputError` in the name of `who` for a building whose shape cannot be drawn, and if shapely is too old.
    """
    if city and not hasattr(shapely, "constrained_delaunay_triangles"):
        hint = "Install it with: pip install 'shapely>=2.1'"
        raise InputError.one("export", "shapely", shapely.__version__, "version 2.1, which triangulates roofs", hint)
    for place, first in enumerate(range(0, len(city), TOPIC_BUILDINGS)):
        topic = f"{BUILDINGS_TOPIC}/{place + 1}" if place else BUILDINGS_TOPIC
        corners: list[Corner] = []
        for number, row in enumerate(city[first : first + TOPIC_BUILDINGS], start=first):
            corners += _corners(row, number, who)
        points, index = np.unique(np.round(np.array(corners), 2), axis=0, return_inverse=True)
        drawn = ",".join(f'{{"x":{x:.2f},"y":{y:.2f},"z":{z:.2f}}}' for x, y, z in points.tolist())
        indices = json.dumps(index.reshape(-1).tolist(), separators=(",", ":"))
        triangles = (
            f'"triangles":[{{"pose":{_FORWARD},"points":[{drawn}],"indices":{indices},'
            f'"color":{color_json(_BUILDING_COLOUR)}}}]'
        )
        entity = _entity(f"buildings {place + 1}", ROOT_FRAME, start_ns, triangles, locked=False)
        yield TimedMessage(0, topic, SCENE_UPDATE, f'{{"entities":[{entity}]}}')


def _corners(row: Mapping[str, Any], number: int, who: str) -> list[Corner]:
    try:
        outline, *holes = row["rings"]
        return prism_triangles(shapely.Polygon(outline, holes), float(row.get("base_m") or 0.0), float(row["height_m"]))
    except (shapely.errors.ShapelyError, AttributeError, KeyError, TypeError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise InputError.one(who, f"city.json: {number}", reason, "height_m and rings of a polygon") from error


def aircraft_message(
    names: Iterable[str], colours: Mapping[str, ThemeColour], time_ns: Time, start_ns: int
) -> TimedMessage:
    """The shapes of the aircraft `names`, in their colours: a sphere of a metre, an arrow forward, and the name."""
    entities = []
    for name in names:
        color = color_json(colours.get(name, UNKNOWN_COLOUR).dark)
        text = json.dumps(name, ensure_ascii=False)
        shapes = (
            f'"spheres":[{{"pose":{_FORWARD},"size":{{"x":1,"y":1,"z":0.4}},"color":{color}}}],'
            f'"arrows":[{{"pose":{_FORWARD},"shaft_length":1.2,"shaft_diameter":0.15,"head_length":0.5,'
            f'"head_diameter":0.4,"color":{color}}}],'
            f'"texts":[{{"pose":{_ABOVE},"billboard":true,"font_size":14,"scale_invariant":true,"color":{color},'
            f'"text":{text}}}]'
        )
        entities.append(_entity(name, name, start_ns + time_ns, shapes, locked=True))
    return TimedMessage(time_ns, AIRCRAFT_TOPIC, SCENE_UPDATE, f'{{"entities":[{",".join(entities)}]}}')


def _entity(identity: str, frame: str, unix_ns: int, shapes: str, *, locked: bool) -> str:
    return (
        f'{{"timestamp":{time_json(unix_ns)},"frame_id":{json.dumps(frame, ensure_ascii=False)},'
        f'"id":{json.dumps(identity, ensure_ascii=False)},"lifetime":{_FOREVER},'
        f'"frame_locked":{"true" if locked else "false"},"metadata":[],{shapes}}}'
    )
