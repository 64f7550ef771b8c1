"""Wi-Fi control links that an attack is about: their selection, and a base of kinds that transmit on their channels."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any, ClassVar

from skyrange.attack.bases.transmission import Periodic, radiated_power
from skyrange.attack.contract import AirLink, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.contracts.params import Number
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
        each = with_access_points
        return sorted({(round(one.centre_mhz * 1000), one.station_address if each else b"") for one in self.targets})


def find_wifi_links(context: AttackContext, patterns: tuple[str, ...]) -> dict[str, AirLink]:
    """The Wi-Fi links that match one of `patterns`; raises `InputError` for a pattern that matches none."""
    wifi = {name: link for name, link in context.over_air.items() if link.kind == "wifi"}
    found: dict[str, AirLink] = {}
    for pattern in patterns:
        matches = {name: link for name, link in wifi.items() if fnmatchcase(name, pattern)}
        if not matches:
            hint = nearest(pattern, wifi) or 'Give [[links]] match = "gcs:*" the key channel = "wifi".'
            raise InputError.one(context.id, "links", pattern, "a control link over Wi-Fi", hint)
        found |= matches
    return found
