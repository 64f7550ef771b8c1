"""TCP port of the master of a Gazebo 11."""

from __future__ import annotations

import contextlib
import socket

from skyrange.core.errors import InputError


def take_port(wanted: int, where: str) -> int:
    """The TCP port `wanted`, or a free one for 0. Raises `InputError` in the name of the key `where` if it is used."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", wanted))
        except OSError as error:
            hint = "Another Gazebo may be running. Omit the port to have a free one chosen."
            expected = f"a free port ({error.strerror})"
            raise InputError.one("gazebo", where, str(wanted), expected, hint) from None
        return int(probe.getsockname()[1])
