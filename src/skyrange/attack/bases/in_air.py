"""Base of kinds that may be in the air: beside a control link over Wi-Fi, with a radio of their own."""

from __future__ import annotations

from skyrange.attack.bases.on_path import LinkTap
from skyrange.attack.bases.transmission import radiated_power
from skyrange.attack.contract import AttackContext
from skyrange.attack.places import place_param
from skyrange.contracts.links import NetworkPlace, RadioSite
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import InputError


class InAir(LinkTap):
    """Has a place on control links, and in the air a radio. Name it before other bases.

    In the air it is shown the frames that its radio decodes, and what it injects goes over the air as frames of one
    transmission at 6 Mb/s. It can hold or alter no frame.
    """

    place: NetworkPlace | None = param(
        "Where it is on gcs links. air: near a link over Wi-Fi, with a radio of its own; network: in the operator's "
        "network, behind the access point or base station; onboard: in the companion. Default: network for links over "
        "the air, else onboard.",
        default=None,
    )
    radio_m: Enu | None = place_param("Position of its radio in the air", default=None)
    power_dbm: Number = radiated_power()
    has_key: bool = param(
        "Whether it has the keys of encrypted Wi-Fi links, such as from a password that was never changed and the "
        "handshake that it overheard; for 'air'.",
        default=False,
    )

    def find_site(self, context: AttackContext) -> RadioSite | None:
        """See `LinkTap`. Raises `InputError` for a radio without a place, and for one that is not in the air."""
        if self.place == "air":
            if self.radio_m is None:
                raise InputError.one(context.id, "radio_m", "none", "the position of the radio, for place 'air'")
            return RadioSite(context.radio, self.radio_m, self.power_dbm, self.has_key)
        if self.radio_m is not None:
            value = f"a position, with place {self.place or 'by default'}"
            raise InputError.one(context.id, "radio_m", value, "none: it has a radio for place 'air' alone")
        return None
