"""What do all live link ends hold to? Loopback unless there is a key, and errors that name the address."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable

from skyrange.core.errors import InputError
from skyrange.io.mavlink_sockets import Address

OnNote = Callable[[str, str], None]
"""Told what happened to an end (`connected`, `disconnected`, `refused`, `lost`) and, in words, how."""


def ignore_note(kind: str, detail: str) -> None:
    """An `OnNote` for whom the counts are enough."""


def worth_noting(count: int) -> bool:
    """Whether the `count`-th of its kind is to be noted: at powers of two, so that a flood does not fill the record."""
    return count & (count - 1) == 0


def is_loopback(host: str) -> bool:
    """Whether nobody beyond this machine can reach `host`; of names, only `localhost` is trusted to be so."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def text(address: Address) -> str:
    """`host:port`, an IPv6 host in brackets."""
    host, port = address
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def must_be_guarded(who: str, address: Address, guarded: bool, remedy: str) -> None:
    """`InputError` for an address beyond loopback where nothing tells friend from foe."""
    if not guarded and not is_loopback(address[0]):
        raise InputError.one(who, "address", text(address), "a loopback address, such as 127.0.0.1", remedy)


def naming(address: Address, error: OSError) -> OSError:
    """`error` with the address in its text."""
    return OSError(error.errno, f"cannot use {text(address)}: {(error.strerror or str(error)).lower()}")
