"""Addresses among the arguments of commands."""

from __future__ import annotations

from ipaddress import ip_address

from skyrange.core.errors import InputError
from skyrange.core.whole_numbers import parse_whole


def parse_ip_address(who: str, option: str, text: str) -> str:
    """The IP address `text`, in its usual form. Raises `InputError`, in the name of `who`, for anything else."""
    try:
        return str(ip_address(text))
    except ValueError:
        raise InputError.one(who, option, text, "an IP address") from None


def parse_address(who: str, option: str, text: str, default_port: int) -> tuple[str, int]:
    """IP address and TCP port of `text`: ADDRESS, ADDRESS:PORT or [ADDRESS]:PORT. Raises `InputError`."""
    host, separator, port = text.rpartition(":") if text.count(":") == 1 or "]:" in text else (text, "", "")
    number = parse_whole(port) if separator else default_port
    if number is None or not 0 < number < 65_536:
        raise InputError.one(who, option, text, "ADDRESS or ADDRESS:PORT")
    return parse_ip_address(who, option, host.strip("[]")), number
