"""Addresses among the arguments of commands: every text is an address with a port, or an error that names it."""

from __future__ import annotations

import re
from ipaddress import IPv4Address, IPv6Address

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skyrange.cli.options import parse_address
from skyrange.core.errors import InputError
from skyrange.io.mavlink.connections import ADDRESS_FORMS, Address
from skyrange.runtime.live.taps.tap_process import parse_loopback
from tests.cases import each_case

hosts = st.ip_addresses()
ports = st.integers(1, 65_535)


def parse(text: str) -> tuple[str, int]:
    return parse_address("live", "--join", text, 14_590)


@given(hosts, ports)
@example(IPv4Address("10.0.0.1"), 65_535)
def test_an_address_with_a_port_is_read(host: IPv4Address | IPv6Address, port: int) -> None:
    text = f"[{host}]:{port}" if host.version == 6 else f"{host}:{port}"
    assert parse(text) == (str(host), port)
    assert parse(str(host)) == (str(host), 14_590)


NO_PORTS = ("65536", "-1", "+1", "1_0", "\u00b2", "\u0661", "1" * 5_000)
"""Also a superscript and an Arabic digit, which `str.isdigit` accepts, and more digits than `int` reads."""


@each_case("port", ("", "0", *NO_PORTS))
def test_what_is_no_port_is_named(port: str) -> None:
    with pytest.raises(InputError, match=r"--join: 10\.0\.0\.1:.*ADDRESS:PORT"):
        parse(f"10.0.0.1:{port}")


@each_case("port", ("", *NO_PORTS))
def test_what_is_no_port_is_named_wherever_addresses_are_read(port: str) -> None:
    with pytest.raises(InputError, match="a port of the loopback"):
        parse_loopback(f"127.0.0.1:{port}")
    with pytest.raises(InputError, match=re.escape(ADDRESS_FORMS["tcp"])):
        Address.of(f"tcp:127.0.0.1:{port}")


@given(st.text(st.sampled_from("0123456789.:[]af/%\u00b2 -"), max_size=24))
def test_whatever_else_is_named(text: str) -> None:
    try:
        host, port = parse(text)
    except InputError:
        return
    assert 0 < port < 65_536
    assert parse(f"[{host}]:{port}" if ":" in host else f"{host}:{port}") == (host, port)
