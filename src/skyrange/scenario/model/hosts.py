"""Machines of a live range: IP addresses by component, or by a pattern that matches components."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import AfterValidator, Field

from skyrange.scenario.model.base import wrong


def _address(text: str) -> str:
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        raise wrong(text, "an IP address", "Host names are not resolved; write an IP address.") from None
    if address.is_unspecified or address.is_multicast:
        raise wrong(text, "the IP address of one machine, not an unspecified or multicast one")
    return str(address)


Hosts = Annotated[
    dict[Annotated[str, Field(min_length=1, max_length=128)], Annotated[str, AfterValidator(_address)]],
    Field(
        description="IP addresses of the machines of a live range, by component. A key is the name of a component, "
        "such as blue.gcs, blue/b1.companion, blue/b1.proxy, approval or world (which has all autopilots), or a "
        "pattern with *; a later key overrides an earlier one. A component that no key matches runs on the machine of "
        "the world. Default: all components run on the machine that starts the range.",
    ),
]
