"""One ArduPilot SITL process: two of its serial ports over TCP, its JSON physics backend over UDP.

The process connects to this one, to loopback ports chosen by the system and held here, so any number of runs share a
machine. One part of it listens, and cannot be confined: RC input, on UDP and all interfaces (AP_RCProtocol_UDP.cpp,
`init`). Without that port it has no centred sticks, and takes them for deflected. The port is chosen and held here too,
so that no other program takes it, and what is sent to it from this machine ends here.

In one exchange a line of JSON is sent, one step of simulated time passes, and a servo packet comes back. The process
repeats a servo packet after a second of silence, with the same count (SIM_JSON.cpp `recv_fdm`, `output_servos`).
Everything that it writes to its serial ports in a step arrives before the packet, since it writes them first.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import select
import socket
import struct
from collections.abc import Sequence
from pathlib import Path
from time import monotonic

from skyrange.core.errors import ComponentError, InputError, Problem
from skyrange.io.processes.program import Program

LOOPBACK = "127.0.0.1"
_RC_PORTS = range(20_000, 30_000)
FILES = 6
"""Sockets that are held here for one process."""
HEAD = 8
"""Bytes of a servo packet before its pulse widths."""
SIZES = {(18458).to_bytes(2, "little"): 40, (29569).to_bytes(2, "little"): 72}
"""Sizes by magic number: rate and count, then 16 or 32 pulse widths (SIM_JSON.h, `servo_packet_16` and `_32`)."""
_LOOK_S = 0.25
"""How often a waiting call checks whether the process is still running."""
_CHUNK = 1 << 16
_SLACK_S = 0.05


class Sitl:
    """One process with its serial ports, which simulates a physics `model` of its own.

    `serial` are its ports 0 and 1, once it has connected; in the other order if they are `crossed`.
    """

    def __init__(
        self,
        name: str,
        binary: Path,
        folder: Path,
        *,
        model: str,
        home: tuple[float, float, float, float],
        system_id: int,
        start_unix_s: int,
        parameters: str,
        options: Sequence[str] = (),
        crossed: bool = False,
        slack_s: float | None = None,
    ) -> None:
        """Start it in `folder`, which is empty and its own; returns at once.

        `home` is latitude and longitude in degrees, metres above mean sea level and heading in degrees; `parameters` is
        the text of a file of defaults; `slack_s` is as for `Program`. Raises `ComponentError` if it cannot be started.
        """
        self.name = name
        self.folder = folder
        (folder / "defaults.parm").write_text(parameters)
        self._listeners = [_bound(socket.SOCK_STREAM) for _ in range(2)]
        for listener in self._listeners:
            listener.listen(1)
            listener.settimeout(0.0)
        self.serial: list[socket.socket | None] = [None, None]
        self._sticks = _bound_rc_port()
        sticks = self._sticks.getsockname()[1]
        paths = [f"tcpclient:{LOOPBACK}:{listener.getsockname()[1]}" for listener in self._listeners]
        if crossed:
            paths.reverse()
        self.program = Program(
            name,
            [
                str(binary), "--model", model, "--home", ",".join(f"{part:.9f}" for part in home),
                "--defaults", "defaults.parm", "--sysid", str(system_id), "--start-time", str(start_unix_s),
                "--rc-in-port", str(sticks), "--serial0", paths[0], "--serial1", paths[1],
                *(part for number in range(2, 6) for part in (f"--serial{number}", f"none:{number}")), *options,
            ],
            folder,
            slack_s=slack_s,
        )  # fmt: skip

    def accept(self) -> list[int]:
        """Accept connections of its serial ports; the numbers of those that are new."""
        new = []
        for place, listener in enumerate(self._listeners):
            if self.serial[place] is None:
                with contextlib.suppress(BlockingIOError):
                    connection, _ = listener.accept()
                    connection.settimeout(0.0)
                    # data written between two steps must arrive in the next one, not when TCP decides to send it
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self.serial[place] = connection
                    new.append(place)
        return new

    @property
    def connected(self) -> bool:
        """Whether both serial ports are connected."""
        return None not in self.serial

    def read(self, place: int) -> bytes:
        """The bytes that came on a serial port since the last call."""
        port = self.serial[place]
        data = b""
        while port is not None:
            try:
                chunk = port.recv(_CHUNK)
            except (BlockingIOError, ConnectionError):
                break
            data += chunk
            if not chunk:  # closed: it restarts, and will connect again
                port.close()
                self.serial[place] = port = None
            elif len(chunk) < _CHUNK:
                break
        return data

    def write(self, place: int, data: bytes) -> bool:
        """Write to a serial port; False if it is not connected, or the process does not read."""
        port = self.serial[place]
        if port is None:
            return False
        try:
            return port.send(data) == len(data)
        except (BlockingIOError, ConnectionError):
            return False

    def close(self) -> None:
        """Kill the process and close its sockets. A second call does nothing."""
        self.program.kill()
        for connection in (self._sticks, *self._listeners, *self.serial):
            if connection is not None:
                connection.close()

    def lost(self, what: str) -> ComponentError:
        """The error of a process that cannot go on: `what` happened, how it ended, and its last output."""
        ended, output = self.program.ended, self.program.last_words()
        problem = f"{what} ({ended})" if ended else what
        return ComponentError(self.name, problem, f"It said last:\n{output}" if output else "")


class LockstepSitl(Sitl):
    """A process whose physics is computed here: it answers each line with one step of its time."""

    def __init__(
        self,
        name: str,
        binary: Path,
        folder: Path,
        *,
        home: tuple[float, float, float, float],
        system_id: int,
        start_unix_s: int,
        parameters: str,
        options: Sequence[str] = (),
        crossed: bool = False,
        logs: bool = False,
    ) -> None:
        """Start it, as `Sitl`; it waits for its first line.

        Unless it writes `logs` its logging thread is made to sleep longer: with nothing to do it checks the simulated
        time every millisecond of wall time, for 1.4 % of a core (SITL_State.cpp, `wait_clock`).
        """
        self.strangers = 0
        """Datagrams that were no servo packets of the process."""
        self.restarts = 0
        """Number of reboots (MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN), after each of which its clock is at 0 again."""
        self.count = -1
        """The count in its last answer."""
        self.peer: tuple[str, int] | None = None
        """The address that its answers come from; `None` before the first."""
        self._physics = _bound(socket.SOCK_DGRAM)
        self._physics.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, round(_LOOK_S * 1e6)))
        super().__init__(
            name, binary, folder, model=f"JSON:{LOOPBACK}", home=home, system_id=system_id, start_unix_s=start_unix_s,
            parameters=parameters, options=("--sim-port-out", str(self._physics.getsockname()[1]), *options),
            crossed=crossed, slack_s=None if logs else _SLACK_S,
        )  # fmt: skip

    @property
    def port(self) -> int:
        """The port that it sends from, 0 before its first answer."""
        return self.peer[1] if self.peer is not None else 0

    @property
    def fileno(self) -> int:
        """The file descriptor of the physics socket."""
        return self._physics.fileno()

    def send(self, line: bytes) -> None:
        """Send the line of one step; the process has answered at least once before."""
        assert self.peer is not None
        try:
            self._physics.sendto(line, self.peer)
        except OSError:  # it may have died: the missing answer shows it
            return

    def await_word(self) -> None:
        """Wait until it may have answered, for a quarter of a second at most."""
        with contextlib.suppress(BlockingIOError):
            self._physics.recv(1, socket.MSG_PEEK)

    def servos(self, deadline: float, first: tuple[bytes, tuple[str, int]] | None = None) -> bytes | None:
        """Its answer: pulse widths in µs, little-endian, 16 bits each; `None` if it has ended, or at the deadline.

        `deadline` is on the clock of `wall_s`; `first` is a datagram that was read already, and its sender. If the
        process has rebooted meanwhile, `restarts` has grown.
        """
        heard = first
        while True:
            if heard is None:
                try:
                    heard = self._physics.recvfrom(256)
                except BlockingIOError:  # nothing for `_LOOK_S`
                    if wall_s() > deadline or not self.program.running:
                        return None
                    continue
            if self._is_answer(*heard):
                return heard[0][HEAD:]
            heard = None

    def _is_answer(self, data: bytes, sender: tuple[str, int]) -> bool:
        if SIZES.get(data[:2]) != len(data):
            self.strangers += 1
            return False
        count = int.from_bytes(data[4:8], "little")
        if sender != self.peer:
            if self.peer is not None:
                if count != 0:
                    self.strangers += 1
                    return False
                self.restarts += 1
            self.peer = sender
        elif count == self.count:
            return False  # a repetition
        self.count = count
        return True

    def close(self) -> None:
        """Kill the process and close its sockets. A second call does nothing."""
        super().close()
        self._physics.close()


class SerialPoller:
    """Poller of the serial ports of many processes: one system call for all of them."""

    def __init__(self) -> None:
        self._poll = select.epoll()
        self._ports: dict[int, tuple[int, int]] = {}

    def add(self, who: int, place: int, sitl: Sitl) -> None:
        """Poll a port that has just connected; `who` is the caller's number of the process."""
        port = sitl.serial[place]
        assert port is not None
        self._ports = {number: port for number, port in self._ports.items() if port != (who, place)}
        self._ports[port.fileno()] = (who, place)
        self._poll.register(port.fileno(), select.EPOLLIN)

    def poll_ready(self, wait_s: float = 0.0) -> list[tuple[int, int]]:
        """(who, place) of the ports with data, or that have closed, in order; waits at most `wait_s` for the first."""
        heard = self._poll.poll(wait_s)
        return sorted(self._ports[number] for number, _ in heard if number in self._ports)

    def close(self) -> None:
        """Stop polling."""
        self._poll.close()


def wall_s() -> float:
    """The clock of deadlines, in s."""
    return monotonic()


def check_free(ports: Sequence[int], where: str) -> None:
    """Raise `InputError` with the ports at which no process can listen on all interfaces; `where` asked for them."""
    problems = []
    for port in ports:
        # below, SITL counts from its first port (UARTDriver.cpp `_tcp_start_connection`)
        if not 1024 <= port <= 65_535:
            problems.append(Problem(where, f"port {port}", "ports from 1024 to 65535, for all of them"))
            continue
        try:
            with socket.socket() as tried:
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the process does
                tried.bind(("", port))
                tried.listen()
        except OSError as error:
            problems.append(Problem(where, f"port {port}: {error.strerror}", "one that is free"))
    if problems:
        raise InputError("ardupilot", problems)


def _bound(kind: socket.SocketKind) -> socket.socket:
    made = socket.socket(socket.AF_INET, kind)
    made.bind((LOOPBACK, 0))
    return made


def _bound_rc_port() -> socket.socket:
    """A shared UDP port outside the system's range of ephemeral ports.

    ArduPilot's physics socket asks for an ephemeral port with SO_REUSEADDR: it may get one that is shared already.
    """
    for port in itertools.chain(range(_RC_PORTS.start + os.getpid() % len(_RC_PORTS), _RC_PORTS.stop), _RC_PORTS):
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            made.bind((LOOPBACK, port))  # exclusively first: so no program has it, shared or not
            made.close()
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind((LOOPBACK, port))
            return made
        except OSError:
            made.close()
    raise ComponentError(
        "arducopter", f"no UDP port from {_RC_PORTS.start} to {_RC_PORTS.stop - 1} is free", "Free some"
    )
