"""Machines of a live range: a map from components, or patterns of them, to addresses."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import AfterValidator, Field

from skyrange.scenario.model.base import wrong


def _address(text: str) -> str:
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        raise wrong(text, "an IP address", "Names are not looked up; write its address.") from None
    if address.is_unspecified or address.is_multicast:
        raise wrong(text, "the address of one machine")
    return str(address)


Hosts = Annotated[
    dict[Annotated[str, Field(min_length=1, max_length=128)], Annotated[str, AfterValidator(_address)]],
    Field(
        description="For `skyrange live` on several machines: component, such as blue.gcs, blue/b1.companion, "
        "blue/b1.proxy, approval or world (with all autopilots), or a pattern with *, and the IP address of the "
        "machine that it runs on; later ones stand over earlier. What is not named runs where the world does. "
        "Default: all on the machine where the range is started.",
    ),
]
