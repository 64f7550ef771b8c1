"""Selection of the Wi-Fi control links that an attack is about."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Final

from skyrange.attack.contract import AirLink, AttackContext
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import InputError, nearest

WIFI_LINKS: Final = param("Control links over Wi-Fi by name or pattern.", default=("gcs:*",), min_length=1)
"""The parameter `links`."""


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
