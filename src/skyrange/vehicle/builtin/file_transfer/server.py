"""MAVLink FTP as ArduPilot 4.6 serves it: requests of FILE_TRANSFER_PROTOCOL and their replies.

After libraries/GCS_MAVLink/GCS_FTP.cpp of that version (`ftp_worker`, `ftp_list_dir`), beyond or unlike
https://mavlink.io/en/services/ftp.html: there is one session with one file, under the number that the client chose;
while it is in use, requests of another session are refused, and after 3 s another session may take its place. Nothing
binds a session to its client: who knows the number reads, writes and closes the file of another. A file that stands for
parameters or missions takes effect when it is closed, and what is wrong with it is not told. A request that comes twice
has the same reply twice. A burst of pieces is sent at the pace of a parameter list; requests wait meanwhile, five at
most, as in ArduPilot, whose worker serves one request at a time.

There is no @SYS and no @ROMFS, and what an unknown command is answered with is as in later versions.
"""

from __future__ import annotations

import errno
import zlib
from collections.abc import Callable
from typing import Any, Final

from skyrange.codec.ardupilot_files import missions, parameters
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import file_transfer as ftp
from skyrange.codec.mavlink.file_transfer import DATA_BYTES, Error, Opcode, Transfer
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.vehicle.builtin.file_transfer import mission_file, param_file
from skyrange.vehicle.builtin.fleet import Burst, Causes, FileServer, Fleet, OpenFile, Slowdown, Timer, Vehicle
from skyrange.vehicle.builtin.memory_card import Entry, fail
from skyrange.vehicle.builtin.parameter_protocol import send_banner

SESSION_TIMEOUT_NS: Final = 3 * NS_PER_S
"""FTP_SESSION_TIMEOUT."""
MAX_WAITING: Final = 5
"""Requests that wait for the worker (`ObjectBuffer<pending_ftp>(5)`); more are lost."""
BURST_PIECES: Final = 500
"""Most pieces of a burst (`transfer_size`); the client asks for the rest."""
_PIECES_PER_BATCH: Final = 5
_PAUSE_NS: Final = 10 * NS_PER_MS
"""Assumed pace of a burst: that of a parameter list. ArduPilot waits for room in the buffer of the line."""
MAX_CAUSES: Final = 1_000
"""Frames that are kept as causes of a file: those of the longest upload of parameters, 275, and not of one that writes
the same piece for ever."""
_PARAM, _MISSION = parameters.PATH.rpartition("/")[0] + "/", missions.DIRECTORY
_UNINVERTED: Final = 0xFFFFFFFF
"""`crc_crc32` begins with 0 and inverts nothing; zlib inverts before and after."""
Peer = tuple[int, int]


class _RequestError(Exception):
    """A request is answered with a NAK."""

    def __init__(self, error: Error) -> None:
        super().__init__(error.name)
        self.error = error


def on_file_transfer(fleet: Fleet, vehicle: Vehicle, message: Any, peer: Peer, causes: Causes) -> None:
    """FILE_TRANSFER_PROTOCOL: serve a request, or let it wait for the end of a burst."""
    server = vehicle.file_server
    if server is None:
        server = vehicle.file_server = FileServer()
    payload = bytes(message.payload)
    if server.burst is None:
        _serve(fleet, vehicle, server, payload, peer, causes)
    elif len(server.waiting) < MAX_WAITING:
        server.waiting.append((peer, payload, causes))


def on_burst_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Send the next pieces of a burst; after the last one, serve the requests that waited."""
    server = vehicle.file_server
    if server is None or server.burst is None:
        return
    _continue_burst(fleet, vehicle, server, server.burst)
    while server.burst is None and server.waiting:
        peer, payload, causes = server.waiting.pop(0)
        _serve(fleet, vehicle, server, payload, peer, causes)


def _serve(fleet: Fleet, vehicle: Vehicle, server: FileServer, payload: bytes, peer: Peer, causes: Causes) -> None:
    request = ftp.unpack(payload)
    sequence = request.sequence + 1
    last = server.last_reply
    if last is not None and last[:3] == (peer, request.session, sequence):
        _send(fleet, vehicle, server, last[3], peer, causes)
        return
    if request.opcode in (Opcode.ACK, Opcode.NAK):
        return
    offset = 0
    try:
        if request.size > DATA_BYTES:
            raise _RequestError(Error.INVALID_DATA_SIZE)
        if not _takes_session(fleet, vehicle, server, request):
            data = b""
        elif request.opcode == Opcode.LIST_DIRECTORY:
            offset = request.offset
            data = _list_directory(vehicle, request)
        elif request.opcode == Opcode.BURST_READ_FILE:
            _start_burst(fleet, vehicle, server, request, peer)
            return
        else:
            handler = _HANDLERS.get(request.opcode)
            if handler is None:
                raise _RequestError(Error.UNKNOWN_COMMAND)
            data = handler(fleet, vehicle, server, request, causes)
            offset = request.offset if request.opcode in (Opcode.READ_FILE, Opcode.WRITE_FILE) else 0
    except _RequestError as refused:
        opcode, data = Opcode.NAK, bytes([refused.error])
    except OSError as error:
        opcode, data = Opcode.NAK, _told_errno(error)
    else:
        opcode = Opcode.ACK
    reply = ftp.pack(sequence, request.session, opcode, data, offset=offset, request=request.opcode)
    _reply(fleet, vehicle, server, reply, causes, peer=peer, session=request.session, sequence=sequence)
    if request.opcode == Opcode.TERMINATE_SESSION:
        server.sent_ns = -SESSION_TIMEOUT_NS
    if opcode == Opcode.ACK and request.opcode == Opcode.OPEN_FILE_RO and ftp.text_of(request).startswith(_PARAM):
        send_banner(fleet, vehicle)  # as before a parameter list


def _takes_session(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer) -> bool:
    """Whether a request is to be handled in the session; `False` for the end of one that is not there."""
    if request.session == server.session:
        return True
    if request.opcode in (Opcode.TERMINATE_SESSION, Opcode.RESET_SESSIONS):
        return False
    if server.file is not None:
        if fleet.now - server.sent_ns < SESSION_TIMEOUT_NS:
            raise _RequestError(Error.INVALID_SESSION)
        _end_session(fleet, vehicle, server)
    return True


def _end_session(fleet: Fleet, vehicle: Vehicle, server: FileServer) -> None:
    """Close the file, which makes parameters or a mission of what was written."""
    file, server.file, server.session = server.file, None, -1
    if file is None or not file.writes:
        return
    assert file.content is not None
    problem = ""
    try:
        if file.virtual == _PARAM:
            param_file.apply(fleet, vehicle, bytes(file.content), file.causes)
        elif file.virtual == _MISSION:
            kind = mission_file.mission_type(file.path.removeprefix(_MISSION))
            mission_file.apply(fleet, vehicle, kind, bytes(file.content), file.causes)
    except OSError as error:
        problem = errno.errorcode.get(error.errno or 0, "")
    _note(fleet, vehicle, "write", file.path, file.causes, bytes=len(file.content), error=problem)


def _note(fleet: Fleet, vehicle: Vehicle, operation: str, path: str, causes: Causes, **more: str | int) -> None:
    fleet.note("event.file", vehicle, {"operation": operation, "path": path, **more}, causes)


def _told_errno(error: OSError) -> bytes:
    """The data of a NAK for a failed call (`ftp_error`)."""
    number = error.errno or 0
    known = {errno.EEXIST: Error.FILE_EXISTS, errno.ENOENT: Error.FILE_NOT_FOUND}
    return bytes([known[number]]) if number in known else bytes([Error.FAIL_ERRNO, number & 0xFF])


def _path(request: Transfer) -> str:
    """The path of a request, whose size has to be its length."""
    end = request.data.find(b"\0")
    if request.size == 0 or (len(request.data) if end < 0 else end) != request.size:
        raise _RequestError(Error.INVALID_DATA_SIZE)
    return request.data[: DATA_BYTES - 1].split(b"\0", 1)[0].decode("latin-1")


def _virtual(path: str) -> str:
    """@PARAM/ or @MISSION/ for a file behind these, "" for one of the card."""
    return next((prefix for prefix in (_PARAM, _MISSION) if path.startswith(prefix)), "")


def _on_card(path: str) -> str:
    """A path of the card. Raises `OSError` for one where nothing is listed, made or removed."""
    if _virtual(path):
        raise fail(errno.ENOENT)
    return path


def _list_directory(vehicle: Vehicle, request: Transfer) -> bytes:
    """The entries of a directory from the offset on that fit (`ftp_list_dir`, `gen_dir_entry`)."""
    path = _path(request)
    path = path.removesuffix("/") or path
    lines = [line for line in map(_line, vehicle.card.list_directory(_on_card(path))) if len(line) <= DATA_BYTES]
    out = b""
    for line in lines[request.offset :]:
        if len(out) + len(line) >= DATA_BYTES:
            break
        out += line + b"\0"
    if not out:
        raise _RequestError(Error.END_OF_FILE)
    return out


def _line(entry: Entry) -> bytes:
    name = entry.name.encode("latin-1", "replace")
    return b"D%s\0" % name if entry.is_directory else b"F%s\t%u\0" % (name, len(entry.read()))


def _do_nothing(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    return b""


def _terminate(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    _end_session(fleet, vehicle, server)
    return b""


def _open_to_read(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    if server.file is not None and fleet.now - server.sent_ns > SESSION_TIMEOUT_NS:
        _end_session(fleet, vehicle, server)
    if server.file is not None:
        raise _RequestError(Error.FAIL)
    path = _path(request)
    virtual, content = _virtual(path), None
    if virtual == _PARAM:
        param_file.parse_query(path.removeprefix(_PARAM))
        size = param_file.stated_size(fleet, vehicle)
    elif virtual == _MISSION:
        kind = mission_file.mission_type(path.removeprefix(_MISSION))
        content, size = mission_file.pack(fleet, vehicle, kind), mission_file.STATED_SIZE
    else:
        content = vehicle.card.find_file(path).read()
        size = len(content)
    server.file, server.session = OpenFile(path, virtual, writes=False, content=content, causes=causes), request.session
    _note(fleet, vehicle, "read", path, causes, bytes=size)
    return size.to_bytes(4, "little")


def _open_to_write(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    if server.file is not None:
        raise _RequestError(Error.FAIL)
    path = _path(request)
    virtual = _virtual(path)
    if virtual == _PARAM:
        param_file.parse_query(path.removeprefix(_PARAM))
    elif virtual == _MISSION:
        mission_file.mission_type(path.removeprefix(_MISSION))
    content = bytearray() if virtual else vehicle.card.open_to_write(path, create=request.opcode == Opcode.CREATE_FILE)
    server.file, server.session = OpenFile(path, virtual, writes=True, content=content, causes=causes), request.session
    return b""


def _opened(server: FileServer, *, writes: bool) -> OpenFile:
    if server.file is None:
        raise _RequestError(Error.FILE_NOT_FOUND)
    if server.file.writes is not writes:
        raise _RequestError(Error.FAIL)
    return server.file


def _read_piece(fleet: Fleet, vehicle: Vehicle, file: OpenFile, offset: int, size: int) -> bytes:
    """Bytes of a file that is open to be read. Parameters are read in pieces of one size alone."""
    if file.virtual == _PARAM:
        if size and not file.size:
            query = param_file.parse_query(file.path.removeprefix(_PARAM))
            file.size, file.content = size, param_file.pack(fleet, vehicle, query, size)
        if file.size and file.size != size:
            raise fail(errno.EINVAL)
    return bytes((file.content or b"")[offset : offset + size])


def _read(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    data = _read_piece(fleet, vehicle, _opened(server, writes=False), request.offset, request.size)
    if not data:
        raise _RequestError(Error.END_OF_FILE)
    return data


def _write(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    file = _opened(server, writes=True)
    content, data = file.content, request.data[: request.size]
    assert isinstance(content, bytearray)
    if len(file.causes) < MAX_CAUSES:
        file.causes += causes
    if not file.virtual:
        vehicle.card.write(content, request.offset, data)
        return b""
    parameter = file.virtual == _PARAM
    stated = (parameters if parameter else missions).stated_length(data) if request.offset == 0 else 0
    end = max(request.offset + len(data), stated)
    if end > (parameters.MAX_UPLOAD_BYTES if parameter else mission_file.MAX_UPLOAD_BYTES):
        raise fail(errno.EINVAL if parameter else errno.ENOSPC)
    content.extend(bytes(max(0, end - len(content))))
    content[request.offset : request.offset + len(data)] = data
    return b""


def _make_directory(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    path = _path(request)
    vehicle.card.make_directory(_on_card(path))
    _note(fleet, vehicle, "make_directory", path, causes)
    return b""


def _remove(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    path = _path(request)
    vehicle.card.remove(_on_card(path))
    _note(fleet, vehicle, "remove", path, causes)
    return b""


def _rename(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    old, middle, rest = request.data.partition(b"\0")
    new = rest.split(b"\0", 1)[0]
    if not middle or request.size == 0 or len(old) + len(new) + 1 != request.size:
        raise _RequestError(Error.INVALID_DATA_SIZE)
    before, after = old.decode("latin-1"), new[: DATA_BYTES - 2 - len(old)].decode("latin-1")
    vehicle.card.rename(_on_card(before), _on_card(after))
    _note(fleet, vehicle, "rename", before, causes, to=after)
    return b""


def _checksum(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, causes: Causes) -> bytes:
    """CRC32 of a file, by AP_Filesystem::crc32, which cannot read the files that stand for something in one piece."""
    path = _path(request)
    content = vehicle.card.find_file(_on_card(path)).read()
    return (zlib.crc32(content, _UNINVERTED) ^ _UNINVERTED).to_bytes(4, "little")


_HANDLERS: Final[dict[int, Callable[[Fleet, Vehicle, FileServer, Transfer, Causes], bytes]]] = {
    Opcode.NONE: _do_nothing,
    Opcode.TERMINATE_SESSION: _terminate,
    Opcode.RESET_SESSIONS: _terminate,
    Opcode.OPEN_FILE_RO: _open_to_read,
    Opcode.READ_FILE: _read,
    Opcode.CREATE_FILE: _open_to_write,
    Opcode.OPEN_FILE_WO: _open_to_write,
    Opcode.WRITE_FILE: _write,
    Opcode.REMOVE_FILE: _remove,
    Opcode.REMOVE_DIRECTORY: _remove,
    Opcode.CREATE_DIRECTORY: _make_directory,
    Opcode.RENAME: _rename,
    Opcode.CALC_FILE_CRC32: _checksum,
}
"""By opcode: the data of an ACK; `_RequestError` or `OSError` for a NAK."""


def _start_burst(fleet: Fleet, vehicle: Vehicle, server: FileServer, request: Transfer, peer: Peer) -> None:
    _opened(server, writes=False)
    size = min(request.size or DATA_BYTES, DATA_BYTES)
    server.burst = Burst(peer, request.session, request.sequence + 1, request.offset, size, BURST_PIECES)
    _continue_burst(fleet, vehicle, server, server.burst)


def _continue_burst(fleet: Fleet, vehicle: Vehicle, server: FileServer, burst: Burst) -> None:
    """Send pieces until the pause, the end of the burst, or that of the file."""
    for _ in range(_PIECES_PER_BATCH):
        file = server.file
        assert file is not None
        error, data = b"", b""
        try:
            data = _read_piece(fleet, vehicle, file, burst.offset, burst.size)
            error = b"" if data else bytes([Error.END_OF_FILE])
        except OSError as problem:
            error = _told_errno(problem)
        burst.left -= 1
        complete = burst.left == 0 and not error
        reply = ftp.pack(
            burst.sequence, burst.session, Opcode.NAK if error else Opcode.ACK, error or data, offset=burst.offset,
            request=Opcode.BURST_READ_FILE, burst_complete=complete,
        )  # fmt: skip
        _reply(fleet, vehicle, server, reply, (), peer=burst.peer, session=burst.session, sequence=burst.sequence)
        burst.sequence += 1
        burst.offset += len(data)
        if error or complete:
            server.burst = None
            return
    fleet.set_timer(vehicle, Timer.FILE_BURST, fleet.now + _PAUSE_NS)


def on_idle_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Streams have their own pace again, a second after the last reply."""
    fleet.slow_streams(vehicle, Slowdown.FILE_TRANSFER, on=False)


def _reply(
    fleet: Fleet,
    vehicle: Vehicle,
    server: FileServer,
    payload: list[int],
    causes: Causes,
    *,
    peer: Peer,
    session: int,
    sequence: int,
) -> None:
    """Send a reply, and keep it for a request that comes again."""
    server.last_reply = peer, session, sequence, tuple(payload)
    _send(fleet, vehicle, server, tuple(payload), peer, causes)


def _send(
    fleet: Fleet, vehicle: Vehicle, server: FileServer, payload: tuple[int, ...], peer: Peer, causes: Causes
) -> None:
    server.sent_ns = fleet.now
    fleet.slow_streams(vehicle, Slowdown.FILE_TRANSFER, on=True)
    fleet.set_timer(vehicle, Timer.FILE_IDLE, fleet.now + NS_PER_S)
    fleet.send(vehicle, mav.MAVLink_file_transfer_protocol_message(0, *peer, list(payload)), causes)
