"""Connections to autopilots that run already: MAVLink over TCP, UDP or a serial device, restored when they break.

Nothing here blocks: while there is no connection each `read` tries again, once a second. One connection has one peer.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import select
import socket
from abc import ABC, abstractmethod
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any, Final, Literal

from skyrange.codec.mavlink.deframer import Deframer, Piece
from skyrange.core.errors import InputError, nearest
from skyrange.core.extras import describe_install
from skyrange.core.whole_numbers import parse_whole

Kind = Literal["tcp", "udpin", "udpout", "serial"]
ADDRESS_FORMS: Final = {
    "tcp": "tcp:ADDRESS:PORT",
    "udpin": "udpin:ADDRESS:PORT",
    "udpout": "udpout:ADDRESS:PORT",
    "serial": "serial:DEVICE:BAUD",
}
RETRY_S: Final = 1.0
"""Between two attempts to connect."""
CONNECT_S: Final = 5.0
"""After so many seconds without an answer an attempt is given up."""
MAX_READ_BYTES: Final = 1 << 14
"""Bytes that are read at once; the rest of a flood waits in the system's own, bounded, buffers."""
MAX_BAUD: Final = 4_000_000
_DATAGRAM: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Address:
    """The address of an autopilot: `host` and `port`, or a serial device as `host` and its baud rate as `port`."""

    kind: Kind
    host: str
    port: int

    @classmethod
    def of(cls, text: str, where: str = "address") -> Address:
        """Parse an address in one of `ADDRESS_FORMS`; raises `InputError` for any other text."""
        word, _, rest = text.partition(":")
        kind = next((form for form in ADDRESS_FORMS if form == word), None)
        if kind is None:
            forms = ", ".join(ADDRESS_FORMS.values())
            raise InputError.one("wire", where, text, f"one of {forms}", nearest(word, ADDRESS_FORMS))
        host, _, number = rest.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        most = MAX_BAUD if kind == "serial" else 65_535
        port = parse_whole(number)
        if not host or port is None or not 1 <= port <= most:
            raise InputError.one("wire", where, text, ADDRESS_FORMS[kind])
        if kind != "serial" and not _is_address(host):
            raise InputError.one("wire", where, text, f"{ADDRESS_FORMS[kind]} with an IP address, or localhost")
        return cls(kind, host, port)  # type: ignore[arg-type]

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host and self.kind != "serial" else self.host
        return f"{self.kind}:{host}:{self.port}"


def _is_address(host: str) -> bool:
    """Whether `host` is an IP address or localhost: a name server might block in flight."""
    if host == "localhost":
        return True
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


class MavlinkConnection(ABC):
    """One connection, made by `make_connection`, and opened by the first `read`."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self.trouble = "not tried yet"
        """Why no peer is there; "" while one is."""
        self.strangers = 0
        """Datagrams of senders other than the peer."""
        self.unsent = 0
        """Frames dropped because the system's buffer was full."""
        self._deframer = Deframer()
        self._rest = b""
        """The unsent part of a frame."""
        self._due_s = 0.0

    @property
    def connected(self) -> bool:
        """Whether a peer is there to write to."""
        return not self.trouble

    def read(self) -> list[Piece]:
        """The pieces received since the last call. Connects if that is due."""
        if not self._holds():
            if monotonic() < self._due_s:
                return []
            self._due_s = monotonic() + RETRY_S
            try:
                self._open()
            except (OSError, ValueError) as error:
                self._lose(_reason(error))
                return []
        try:
            return self._take()
        except (OSError, TypeError) as error:  # pyserial raises a TypeError if its port is gone
            left = self._deframer.finish()
            self._lose(_reason(error))
            return left

    def write(self, frame: bytes) -> bool:
        """Write one frame; False if no peer is there, or the system's buffer is full."""
        if not self.connected:
            return False
        try:
            if self._rest:
                self._rest = self._rest[self._put(self._rest) :]
            if self._rest:
                self.unsent += 1
                return False
            put = self._put(frame)
        except (OSError, TypeError) as error:
            self._lose(_reason(error))
            return False
        if put == 0:
            self.unsent += 1
            return False
        self._rest = frame[put:]  # a frame that was begun is finished before the next
        return True

    def again(self, why: str) -> None:
        """Give this connection up because of `why`, such as silence, and connect again."""
        if self._holds():
            self._lose(why)

    @abstractmethod
    def close(self) -> None:
        """Close the socket or device. A second call does nothing."""

    @abstractmethod
    def _holds(self) -> bool:
        """Whether there is a socket or device, connected or not yet."""

    @abstractmethod
    def _open(self) -> None:
        """Begin to connect. Raises `OSError` if that fails at once."""

    @abstractmethod
    def _take(self) -> list[Piece]:
        """Read what is there. Raises `OSError` if the connection is lost."""

    @abstractmethod
    def _put(self, data: bytes) -> int:
        """Write as much as fits into the system's buffer; the number of bytes written."""

    def _lose(self, why: str) -> None:
        self.close()
        self.trouble, self._rest, self._deframer = why, b"", Deframer()


class _Socket(MavlinkConnection):
    """The part common to connections over sockets."""

    _socket: socket.socket | None = None

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self.trouble = self.trouble or "closed"

    def _holds(self) -> bool:
        return self._socket is not None

    def _made(self, kind: socket.SocketKind) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.address.host else socket.AF_INET
        made = self._socket = socket.socket(family, kind)
        made.settimeout(0.0)
        return made

    @property
    def _place(self) -> tuple[str, int]:
        host = self.address.host
        return ("127.0.0.1" if host == "localhost" else host), self.address.port


class _Tcp(_Socket):
    """A client, as a ground station is to SITL."""

    _begun_s = 0.0

    def _open(self) -> None:
        made = self._made(socket.SOCK_STREAM)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._begun_s = monotonic()
        self.trouble = "not answered yet"
        error = made.connect_ex(self._place)
        if error not in (0, errno.EINPROGRESS):
            raise OSError(error, os.strerror(error))

    def _take(self) -> list[Piece]:
        assert self._socket is not None
        if self.trouble and not self._answered(self._socket):
            return []
        data = b""
        with contextlib.suppress(BlockingIOError):
            data = self._socket.recv(MAX_READ_BYTES)
            if not data:
                raise ConnectionResetError(errno.ECONNRESET, "closed by the other side")
        return self._deframer.feed(data)

    def _answered(self, connection: socket.socket) -> bool:
        ready = select.poll()
        ready.register(connection, select.POLLOUT)
        if not ready.poll(0):
            if monotonic() - self._begun_s > CONNECT_S:
                raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
            return False
        error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error:
            raise OSError(error, os.strerror(error))
        self.trouble = ""
        return True

    def _put(self, data: bytes) -> int:
        assert self._socket is not None
        with contextlib.suppress(BlockingIOError):
            return self._socket.send(data)
        return 0


class _Udp(_Socket):
    """A datagram is complete: an unfinished frame in it is garbage."""

    def _pieces(self, data: bytes) -> list[Piece]:
        return [*self._deframer.feed(data), *self._deframer.finish()]

    def _receive(self, data: bytes, peer: Any) -> list[Piece]:
        return self._pieces(data)

    def _take(self) -> list[Piece]:
        assert self._socket is not None
        pieces: list[Piece] = []
        taken = 0
        while taken < MAX_READ_BYTES:
            try:
                data, peer = self._socket.recvfrom(_DATAGRAM)
            except BlockingIOError:
                break
            except ConnectionRefusedError:  # no peer is there yet: an own datagram was refused
                continue
            taken += max(len(data), 64)
            pieces += self._receive(data, peer)
        return pieces


class _UdpOut(_Udp):
    """Sends first, to one address, and receives from that alone."""

    def _open(self) -> None:
        self._made(socket.SOCK_DGRAM).connect(self._place)
        self.trouble = ""

    def _put(self, data: bytes) -> int:
        assert self._socket is not None
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(data)
        return len(data)


class _UdpIn(_Udp):
    """Waits for a peer: the sender of the first MAVLink frame, until `again`."""

    _peer: Any = None

    def _open(self) -> None:
        self._peer = None
        self._made(socket.SOCK_DGRAM).bind(self._place)
        self.trouble = "nobody has called"

    def _receive(self, data: bytes, peer: Any) -> list[Piece]:
        if self._peer is not None and peer != self._peer:
            self.strangers += 1
            return []
        pieces = self._pieces(data)
        if self._peer is None and any(not piece.garbage for piece in pieces):
            self._peer, self.trouble = peer, ""
        return pieces

    def _put(self, data: bytes) -> int:
        assert self._socket is not None
        with contextlib.suppress(BlockingIOError):
            self._socket.sendto(data, self._peer)
        return len(data)


class _Serial(MavlinkConnection):
    """A serial device, through pyserial."""

    _port: Any = None

    def close(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError, TypeError):
                self._port.close()
            self._port = None
        self.trouble = self.trouble or "closed"

    def _holds(self) -> bool:
        return self._port is not None

    def _open(self) -> None:
        import serial

        self._port = serial.Serial(
            self.address.host, self.address.port, timeout=0, write_timeout=0, exclusive=True
        )  # fmt: skip
        self.trouble = ""

    def _take(self) -> list[Piece]:
        return self._deframer.feed(self._port.read(MAX_READ_BYTES))

    def _put(self, data: bytes) -> int:
        with contextlib.suppress(BlockingIOError):  # pyserial's own `write` blocks until there is room
            return os.write(self._port.fileno(), data)
        return 0


_KINDS: Final[dict[str, type[MavlinkConnection]]] = {"tcp": _Tcp, "udpin": _UdpIn, "udpout": _UdpOut, "serial": _Serial}


def make_connection(address: Address) -> MavlinkConnection:
    """A connection to `address`, not opened yet. Raises `InputError` if it is a serial device without pyserial."""
    if address.kind == "serial":
        try:
            import serial  # noqa: F401
        except ImportError:
            expected = "pyserial, which serial devices need"
            raise InputError.one("wire", str(address), "no pyserial", expected, describe_install("serial")) from None
    return _KINDS[address.kind](address)


def sleep_for(seconds: float) -> None:
    """Sleep for so much wall time."""
    sleep(max(seconds, 0.0))


def _reason(error: Exception) -> str:
    """What is wrong, in the system's words."""
    number = getattr(error, "errno", None)
    return (os.strerror(number) if isinstance(number, int) else str(error) or type(error).__name__).lower()
