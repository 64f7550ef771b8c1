"""Bases of kinds on control links over Wi-Fi: on the channel of a link, or with a place beside it in the air."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any, ClassVar

from skyrange.attack.bases.links import LinkTap
from skyrange.attack.bases.transmission import Periodic, radiated_power
from skyrange.attack.contract import AirLink, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.params import place_param
from skyrange.contracts.links import NetworkPlace, RadioSite
from skyrange.contracts.params import Enu, Number
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import InputError, nearest


class OnWifiLinks(Periodic):
    """Transmits on the channels of control links over Wi-Fi, once in each period."""

    attack_facts: ClassVar[Facts] = {"technique": "T0814", "surface": ("gcs", "medium")}

    links: tuple[str, ...] = param("Control links over Wi-Fi by name or pattern.", default=("gcs:*",), min_length=1)
    power_dbm: Number = radiated_power(le=60)
    targets: Sequence[AirLink]
    """The links that match."""

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`. Raises `InputError` for a pattern that matches no link over Wi-Fi."""
        self.targets = list(find_wifi_links(context, self.links).values())
        return super().assemble(context)

    def find_channels(self, *, with_access_points: bool) -> list[tuple[int, bytes]]:
        """Centres of their channels in kHz, each once, or of each access point with its address; else that is empty."""
        per_access_point = with_access_points
        return sorted(
            {
                (round(target.centre_mhz * 1000), target.station_address if per_access_point else b"")
                for target in self.targets
            }
        )


def find_wifi_links(context: AttackContext, patterns: tuple[str, ...]) -> dict[str, AirLink]:
    """The Wi-Fi links that match one of `patterns`; raises `InputError` for a pattern that matches none."""
    wifi = {name: link for name, link in context.over_air.items() if link.kind == "wifi"}
    links: dict[str, AirLink] = {}
    for pattern in patterns:
        matches = {name: link for name, link in wifi.items() if fnmatchcase(name, pattern)}
        if not matches:
            hint = nearest(pattern, wifi) or 'Give [[links]] match = "gcs:*" the key channel = "wifi".'
            raise InputError.one(context.id, "links", pattern, "a control link over Wi-Fi", hint)
        links |= matches
    return links


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
