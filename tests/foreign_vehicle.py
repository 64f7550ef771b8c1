"""A vehicle that the range did not start, as small as one can be: it stands or drifts, reports that, and keeps what it
is told."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from skyrange.codec.mavlink import Deframer, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin

ORIGIN = Origin(40.778, -73.955, 20.0, -32.0)
HZ = 50.0


class Foreign:
    """Serves one TCP connection at a time, as SITL's serial port does; `with` ends it."""

    def __init__(
        self, system_id: int = 1, place: Callable[[float], tuple[float, float, float]] = lambda _: (0.0, 0.0, 0.0),
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), origin: Origin = ORIGIN,
        kind: tuple[int, int] = (mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
    ) -> None:  # fmt: skip
        self.system_id, self.place, self.velocity, self.origin = system_id, place, velocity, origin
        self.kind = kind
        """MAV_TYPE and MAV_AUTOPILOT of its heartbeats."""
        self.quiet = False
        """Says nothing, though it is connected."""
        self.calls = 0
        self.heard: list[bytes] = []
        self.attitude = (0.0, 0.0, math.pi / 2)
        """East."""
        self._packer = Packer(system_id, 1)
        self._began = time.monotonic()
        self._server = socket.socket()
        self._server.bind(("127.0.0.1", 0))
        self._server.listen()
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self._end = threading.Event()
        self._drop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> Foreign:
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        self._server.close()

    @property
    def told(self) -> list[Any]:
        """What it was told, as messages."""
        return [decode(frame) for frame in self.heard]

    def hang_up(self) -> None:
        """Close the connection."""
        self._drop.set()

    def reports(self) -> bytes:
        """HEARTBEAT, ATTITUDE and GLOBAL_POSITION_INT, as of now."""
        since_s = time.monotonic() - self._began
        east_m, north_m, up_m = self.place(since_s)
        lat, lon = self.origin.geodetic_of(east_m, north_m)
        east, north, up = self.velocity
        boot_ms = int(since_s * 1e3)
        said = (
            mav.MAVLink_heartbeat_message(*self.kind, 81, 0, 3, 3),
            mav.MAVLink_attitude_message(boot_ms, *self.attitude, 0.0, 0.0, 0.0),
            mav.MAVLink_global_position_int_message(
                boot_ms, round(lat * 1e7), round(lon * 1e7), round((self.origin.alt_msl_m + up_m) * 1e3),
                round(up_m * 1e3), round(north * 100), round(east * 100), round(-up * 100), 9000,
            ),
        )  # fmt: skip
        return b"".join(self._packer.pack(message) for message in said)

    def _serve(self) -> None:
        while not self._end.is_set():
            with suppress(TimeoutError, OSError):
                peer, _ = self._server.accept()
                with peer:
                    self.calls += 1
                    self._drop.clear()
                    self._speak(peer)

    def _speak(self, peer: socket.socket) -> None:
        peer.settimeout(1.0 / HZ)
        deframer = Deframer()
        while not self._end.is_set() and not self._drop.is_set():
            if not self.quiet:
                peer.sendall(self.reports())
            with suppress(TimeoutError):
                data = peer.recv(1 << 16)
                if not data:
                    return
                self.heard += [piece.data for piece in deframer.feed(data)]
