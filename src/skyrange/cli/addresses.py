"""Addresses among the arguments of commands."""

from __future__ import annotations

from ipaddress import ip_address

from skyrange.core.errors import InputError


def parse_ip_address(who: str, option: str, text: str) -> str:
    """The IP address `text`, in its usual form. Raises `InputError`, in the name of `who`, for anything else."""
    try:
        return str(ip_address(text))
    except ValueError:
        raise InputError.one(who, option, text, "an IP address") from None


def parse_address(who: str, option: str, text: str, default_port: int) -> tuple[str, int]:
    """IP address and TCP port of `text`: ADDRESS, ADDRESS:PORT or [ADDRESS]:PORT. Raises `InputError`."""
    host, separator, port = text.rpartition(":") if text.count(":") == 1 or "]:" in text else (text, "", "")
    if separator and not (port.isdigit() and 0 < int(port) < 65_536):
        raise InputError.one(who, option, text, "ADDRESS or ADDRESS:PORT")
    return parse_ip_address(who, option, host.strip("[]")), int(port) if separator else default_port
