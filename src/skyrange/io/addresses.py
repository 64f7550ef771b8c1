"""Rules of all transports: loopback unless there is a key, and errors that name the address."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable

from skyrange.core.errors import InputError
from skyrange.io.mavlink.transports import Address

OnNote = Callable[[str, str], None]
"""Called with an event of a transport (`connected`, `disconnected`, `refused`, `lost`) and a description."""


def ignore_note(kind: str, detail: str) -> None:
    """An `OnNote` that does nothing."""


def is_loopback(host: str) -> bool:
    """Whether `host` can be reached from this machine only; of names, only `localhost` is trusted to be so."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def format_address(address: Address) -> str:
    """The address as `host:port`, an IPv6 host in brackets."""
    host, port = address
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def check_guarded(who: str, address: Address, *, guarded: bool, remedy: str) -> None:
    """Raise `InputError` for an address beyond loopback where peers are not authenticated."""
    if not guarded and not is_loopback(address[0]):
        raise InputError.one(who, "address", format_address(address), "a loopback address, such as 127.0.0.1", remedy)


def with_address(address: Address, error: OSError) -> OSError:
    """An `OSError` like `error`, with the address in its text."""
    return OSError(error.errno, f"cannot use {format_address(address)}: {(error.strerror or str(error)).lower()}")
