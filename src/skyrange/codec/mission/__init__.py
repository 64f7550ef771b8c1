"""Missions: the model, and reading and writing of mission files."""

from skyrange.codec.mission.items import Mission, MissionItem
from skyrange.codec.mission.mission_file import read_mission
from skyrange.codec.mission.qgc_plan import format_plan, parse_plan
from skyrange.codec.mission.qgc_wpl import format_waypoints, parse_waypoints

__all__ = [
    "Mission",
    "MissionItem",
    "format_plan",
    "format_waypoints",
    "parse_plan",
    "parse_waypoints",
    "read_mission",
]
