"""A relay of viewers' ports: shows what the run shows, lets nothing pass back, and ends with the run."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from select import select
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from typer.testing import CliRunner

from skyrange.cli import options as addresses
from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError
from skyrange.io.mavlink.viewer_ports import ViewerPorts
from skyrange.runtime.live.node.viewers import assign_viewer_ports
from skyrange.runtime.viewers import PORT_STEP, ViewerRelay, Viewers
from tests.ports import OFFSET

AT = ("127.0.0.1", OFFSET + 7_000)


@pytest.fixture
def shown() -> Iterator[ViewerPorts]:
    """The ports of a run with two aircraft."""
    with closing(ViewerPorts([AT[1], AT[1] + PORT_STEP])) as ports:
        yield ports


def until(true: Callable[[], Any], *served: Callable[[], None]) -> None:
    limit = time.monotonic() + 10.0
    while not true():
        assert time.monotonic() < limit, "nothing came"
        for serve in served:
            serve()


def viewer(relay: ViewerRelay, place: int = 0) -> socket.socket:
    made = socket.create_connection(relay.addresses[place], 5.0)
    relay.poll()
    return made


def test_what_the_run_shows_is_shown_by_aircraft_and_nothing_passes_back(shown: ViewerPorts) -> None:
    with ViewerRelay(AT, ("127.0.0.1", 0), 2) as relay:
        until(lambda: shown.watched(0) and shown.watched(1), relay.poll, shown.serve)
        with viewer(relay) as first, viewer(relay, 1) as second:
            first.sendall(b"disarm" * 100)
            shown.show(0, b"of the first ")
            shown.show(1, b"of the second")
            for client, expected in ((first, b"of the first "), (second, b"of the second")):
                until(partial(lambda one: select([one], [], [], 0)[0], client), shown.serve, relay.poll)
                assert client.recv(100) == expected
            until(lambda: relay.counts.bytes_ignored == 600, relay.poll, shown.serve)
            assert shown.counts.bytes_ignored == 0
            assert not relay.ended


def test_a_frame_that_arrives_in_two_parts_is_passed_on_whole(shown: ViewerPorts) -> None:
    """So a viewer that comes between them does not begin inside a frame."""
    link = mav.MAVLink(None, 1, 1)
    frame = link.heartbeat_encode(2, 3, 0, 0, 4).pack(link)
    with ViewerRelay(AT, ("127.0.0.1", 0), 1) as relay:
        until(lambda: shown.watched(0), relay.poll, shown.serve)
        with viewer(relay) as client:
            shown.show(0, frame[:7])
            until(lambda: relay.shown, shown.serve, relay.poll)
            assert not select([client], [], [], 0.05)[0]
            shown.show(0, frame[7:])
            until(lambda: select([client], [], [], 0)[0], shown.serve, relay.poll)
            assert client.recv(100) == frame


def test_it_ends_with_the_run_and_not_when_a_range_tries_its_ports() -> None:
    with ViewerRelay(AT, ("127.0.0.1", 0), 1) as relay:
        relay.poll()  # nobody listens yet
        with closing(ViewerPorts([AT[1]])) as tried:
            until(lambda: tried.watched(0), relay.poll, tried.serve)
        for _ in range(10):
            relay.poll()
        assert not relay.ended
        with closing(ViewerPorts([AT[1]])) as ports:
            until(lambda: ports.watched(0), relay.poll, ports.serve)
            ports.show(0, b"here")
            until(lambda: relay.shown, ports.serve, relay.poll)
        until(lambda: relay.ended, relay.poll)


def test_a_run_that_does_not_begin_is_named() -> None:
    with ViewerRelay(AT, ("127.0.0.1", 0), 1) as relay, pytest.raises(ComponentError, match=f"127.0.0.1:{AT[1]}"):
        relay.serve(0.1, lambda word: None)


def test_a_port_that_is_taken_ends_it_at_once(shown: ViewerPorts) -> None:
    with pytest.raises(InputError, match="is taken"):
        ViewerRelay(("127.0.0.1", 1), AT, 1)


def test_the_command_shows_where_viewers_connect_and_what_they_were_shown() -> None:
    asked = [
        "relay",
        "--from",
        f"127.0.0.1:{AT[1]}",
        "--vehicles",
        "1",
        "--listen",
        f"127.0.0.1:{AT[1] + 5}",
        "--wait",
        "1",
    ]
    said = CliRunner().invoke(app, asked)
    assert isinstance(said.exception, ComponentError)
    assert f"viewers: 127.0.0.1:{AT[1] + 5}" in said.output


@pytest.mark.parametrize("text", ["lab1", "10.0.0.1:x", "10.0.0.1:0", "10.0.0.1:65536", ""])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--from"):
        addresses.parse_address("relay", "--from", text, 5763)


@pytest.mark.parametrize(
    ("text", "parsed"),
    [
        ("10.0.0.1", ("10.0.0.1", 5763)),
        ("10.0.0.1:7", ("10.0.0.1", 7)),
        ("::1", ("::1", 5763)),
        ("[::1]:7", ("::1", 7)),
    ],
)
def test_addresses_have_a_port_or_the_usual_one(text: str, parsed: tuple[str, int]) -> None:
    assert addresses.parse_address("relay", "--from", text, 5763) == parsed


def test_viewers_listen_at_the_given_address_alone() -> None:
    with Viewers(["blue/b1"], 0, "127.0.0.5") as viewers:
        (there,) = viewers.addresses
        assert there.host == "127.0.0.5"
        socket.create_connection(there[1:], 5.0).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", there.port), 5.0)


def test_an_address_of_another_machine_is_named() -> None:
    with pytest.raises(InputError, match=r"192\.0\.2\.1"):
        assign_viewer_ports(["blue/b1"], 0, "192.0.2.1")


@pytest.mark.parametrize("command", [["live", "squares"], ["run", "squares", "--qgc"]])
def test_a_host_name_is_refused_before_the_run(command: list[str]) -> None:
    said = CliRunner().invoke(app, [*command, "--viewer-host", "lab1"])
    assert isinstance(said.exception, InputError)
    assert "--viewer-host" in str(said.exception)
