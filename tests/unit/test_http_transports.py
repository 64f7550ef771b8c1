"""The approval link over HTTP: real clients get decisions, frames cross byte for byte, nothing hostile stops it."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink.deframer import Piece
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.errors import DecodeError, InputError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.core.volumes import Volume4D
from skyrange.io.http import frames as http_frames
from skyrange.io.http import transports as http_ends
from skyrange.io.http.transports import HttpClientTransport, HttpServerTransport
from skyrange.io.limited_listener import MAX_CONNECTIONS
from skyrange.io.mavlink.transports import LOOPBACK, Address
from skyrange.utm import messages
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import ApprovalDecision, OperationalIntent, intent_id
from skyrange.utm.messages import PATH, Request, Response, encode
from tests.tiers import needs

EPOCH = Epoch.from_datetime(datetime(2026, 1, 1, 12, tzinfo=UTC))
VOLUME = Volume4D(((-35.0, 149.0), (-35.0, 149.1), (-35.1, 149.1)), 600.25, 640.0, 1_500_000_000, 90 * NS_PER_S)


def request_for(vehicle: str, version: int = 0) -> bytes:
    operator = vehicle.partition("/")[0]
    return encode(Request.of(OperationalIntent(intent_id(vehicle, version), operator, vehicle, (VOLUME,), 3), EPOCH))


REQUEST = request_for("blue/b1")
INTENT = intent_id("blue/b1")
ENDED = encode(Request.end(OperationalIntent(INTENT, "blue", "blue/b1", ())))
BODY = json.dumps(json.loads(REQUEST)["body"])
ACCEPTED = encode(Response.of(INTENT, ApprovalDecision(accepted=True, ovn="x"), EPOCH))


def run(body: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(20):
            await body()

    asyncio.run(bounded())


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0.002)


class Service:
    """The approval's own agent behind an end, asked and answering at once."""

    def __init__(self) -> None:
        self.agent = FlightApproval(["blue"], EPOCH, ApproveAll())
        self.heard: list[bytes] = []
        self.said: list[bytes] = []
        self.end: HttpServerTransport | None = None

    def on_piece(self, piece: Piece) -> None:
        assert not piece.garbage
        self.heard.append(piece.data)
        ref = FrameId("approval:blue", "fwd", "blue.gcs", len(self.heard))
        out = self.agent.step(0, Inbox([Arrival(self.agent.ports[0], 0, piece.data, "blue.gcs", ref)]))
        for departure in out.each(self.agent.ports):
            self.said.append(departure.payload)
            assert self.end is not None
            assert self.end.send(departure.payload)

    @classmethod
    async def open(cls, local: Address = (LOOPBACK, 0)) -> tuple[Service, HttpServerTransport]:
        service = cls()
        service.end = await HttpServerTransport.open(service.on_piece, local)
        return service, service.end


async def raw(address: Address, data: bytes) -> bytes:
    """What comes back for `data`, to the end of the connection."""
    reader, writer = await asyncio.open_connection(*address)
    writer.write(data)
    try:
        return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.close()


def http(
    body: str | bytes,
    *,
    method: str = "PUT",
    path: str = PATH + INTENT,
    kind: str = "application/json",
    more: str = "",
) -> bytes:
    data = body.encode() if isinstance(body, str) else body
    head = f"{method} {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Type: {kind}\r\n{more}"
    return f"{head}Content-Length: {len(data)}\r\n\r\n".encode() + data


def status(answer: bytes) -> int:
    return int(answer.split()[1])


def test_the_longest_frame_is_the_agents() -> None:
    assert http_frames.MAX_BYTES == messages.MAX_FRAME_BYTES


def test_agents_frames_cross_byte_for_byte() -> None:
    async def body() -> None:
        service, server = await Service.open()
        answers: list[Piece] = []
        client = await HttpClientTransport.open(answers.append, server.address)
        foreign = request_for("red/r1")  # 403 on its own path
        unread = REQUEST.replace(b'"priority":3', b'"priority":-3')  # 400 on the collection's path
        for count, frame in enumerate([REQUEST, REQUEST, foreign, unread, ENDED], 1):
            assert client.send(frame)
            await until(partial(lambda n: len(answers) == n, count))
        assert service.heard == [REQUEST, REQUEST, foreign, unread, ENDED]
        assert [piece.data for piece in answers] == service.said
        assert [json.loads(said)["status"] for said in service.said] == [200, 200, 403, 400, 200]
        assert (client.counts.frames, client.counts.sent, client.counts.lost) == (5, 5, 0)
        assert (server.counts.frames, server.counts.sent) == (5, 5)
        client.close()
        server.close()

    run(body)


@needs("curl")
@pytest.mark.parametrize("method", ["PUT", "POST"])
def test_curl_files_an_operational_intent(method: str, tmp_path: Path) -> None:
    async def body() -> None:
        service, server = await Service.open()
        (tmp_path / "intent.json").write_text(BODY)
        url = f"http://{LOOPBACK}:{server.address[1]}{PATH}{INTENT}"
        sends = ["-H", "Content-Type: application/json", "--data-binary", "@intent.json"]
        command = ["curl", "-s", "-S", "-w", "\n%{http_code}", "-X", method, *sends, url]
        program = await asyncio.create_subprocess_exec(*command, cwd=tmp_path, stdout=asyncio.subprocess.PIPE)
        output, _ = await program.communicate()
        answer, _, code = output.decode().rpartition("\n")
        assert code == "200"
        assert json.loads(answer)["decision"] == "Accepted"
        assert service.heard == [REQUEST]
        server.close()

    run(body)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00", 400),
        (b"GET\r\n\r\n", 400),
        (http("{}", method="GET"), 405),
        (http("{}", method="PATCH"), 405),
        (http("not json"), 400),
        (http("[]"), 400),
        (http('{"a": NaN}'), 400),
        (http('{"a": 1e999}'), 400),
        (http("[" * 100_000), 400),
        (http('{"a":' * 100_000), 400),
        (http("{}", kind="text/plain"), 415),
        (http("{}", more="Content-Encoding: gzip\r\n"), 415),
        (http(b"\xff\xfe{}"), 400),
        (http("{}", path="/a?b=c"), 400),
        (http(b"x" * 10, more="X-Long: " + "y" * 9_000 + "\r\n"), 400),
        (http(b'{"a":"' + b"x" * http_frames.MAX_BYTES + b'"}'), 413),
        (b"PUT / HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 99999999999\r\n\r\n", 413),
    ],
)
def test_what_is_no_request_is_answered_4xx_and_counted(data: bytes, expected: int) -> None:
    async def body() -> None:
        service, server = await Service.open()
        assert status(await raw(server.address, data)) == expected
        assert service.heard == []
        assert server.counts.garbage == 1
        assert status(await raw(server.address, http(BODY))) == 200
        server.close()

    run(body)


def test_a_chunked_body_without_end_is_cut_off() -> None:
    async def body() -> None:
        service, server = await Service.open()
        head = f"PUT {PATH}{INTENT} HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
        chunk = b"10000\r\n" + b"x" * 65_536 + b"\r\n"
        answer = await raw(server.address, head.encode() + b"Transfer-Encoding: chunked\r\n\r\n" + chunk * 40)
        assert answer == b"" or status(answer) == 413  # the reset may overtake the answer
        assert (service.heard, server.counts.garbage) == ([], 1)
        server.close()

    run(body)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.binary(min_size=1, max_size=400), min_size=1, max_size=6))
def test_random_bytes_are_survived(runs: list[bytes]) -> None:
    async def body() -> None:
        service, server = await Service.open()
        for data in runs:
            _, writer = await asyncio.open_connection(*server.address)
            writer.write(data)
            writer.write_eof()
            writer.close()
        await until(lambda: server.counts.garbage >= len(runs))
        assert status(await raw(server.address, http(BODY))) == 200
        assert service.heard == [REQUEST]
        server.close()

    run(body)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=200) | st.builds(lambda v: json.dumps(v).encode(), st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["method", "path", "body", "status", "x"]) | st.text(max_size=4), inner),
)))  # fmt: skip
def test_any_frame_is_read_or_refused(payload: bytes) -> None:
    for read in (http_frames.read_request, http_frames.read_response):
        try:
            message = read(payload)
        except DecodeError:
            continue
        assert http_frames.unquoted(http_frames.quoted(message.path)) == message.path


@given(st.text(max_size=30).map(lambda tail: "/" + tail))
def test_a_path_is_carried_unchanged_or_refused(path: str) -> None:
    try:
        raw_path = http_frames.quoted(path)
    except DecodeError:
        return
    assert raw_path.isascii()
    assert not set(raw_path) & set(" \r\n?#")
    assert http_frames.unquoted(raw_path) == path


def test_slow_clients_are_let_go() -> None:
    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append, patience_s=0.1)
        whole = http(BODY)
        assert await raw(server.address, whole[:30]) == b""  # half a header
        assert status(await raw(server.address, whole[:-5])) == 408  # half a body
        await until(lambda: server.counts.garbage == 2)
        assert heard == []
        server.close()

    run(body)


def test_a_client_that_does_not_read_is_let_go() -> None:
    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append, patience_s=0.1)
        line = socket.socket()
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        line.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_connect(line, server.address)
        long = json.dumps({"status": 200, "path": PATH + INTENT, "body": {"x": "y" * 900_000}}).encode()
        whole = http(BODY).replace(b"Connection: close\r\n", b"")
        count = 0
        while not server.counts.garbage:  # the system's own buffers may take some
            count += 1
            try:
                await loop.sock_sendall(line, whole)
            except ConnectionError:
                break
            await until(partial(lambda n: len(heard) == n or server.counts.garbage, count))
            if not server.counts.garbage:
                server.send(long)
        assert count < 30
        assert server.counts.garbage == 1
        line.close()
        server.close()

    run(body)


def test_what_is_not_answered_gets_a_504() -> None:
    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append, answer_s=0.05)
        assert status(await raw(server.address, http(BODY))) == 504
        assert (len(heard), server.counts.lost) == (1, 1)
        assert not server.send(ACCEPTED)  # too late
        assert server.counts.unasked == 1
        server.close()

    run(body)


def test_a_response_answers_the_oldest_request_of_its_path() -> None:
    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append)
        answers: list[bytes] = []

        async def ask(path: str) -> bytes:
            answer = await raw(server.address, http("{}", path=path))
            answers.append(answer)
            return answer

        asked = []
        for count, path in enumerate(["/a", "/b", "/b"], 1):
            asked.append(asyncio.create_task(ask(path)))
            await until(partial(lambda n: len(heard) == n, count))

        def say(path: str, which: int, code: int = 200) -> bool:
            return server.send(json.dumps({"status": code, "path": path, "body": {"n": which}}).encode())

        assert say("/b", 1)
        assert (await asked[1]).endswith(b'{"n":1}')
        assert not say("/c", 2)  # decides nothing that was asked
        assert say("/", 3, 400)  # an error that names none: the oldest
        first = await asked[0]
        assert first.endswith(b'{"n":3}')
        assert b"Content-Location: /\r\n" in first
        assert say("/b", 4)
        assert (await asked[2]).endswith(b'{"n":4}')
        assert (server.counts.sent, server.counts.unasked) == (3, 1)
        for unfit in (b"\xff", b"[]", b'{"status":100,"path":"/b"}', b'{"status":true,"path":"/b"}', b'{"status":200}'):
            assert not server.send(unfit)
        assert server.counts.unfit == 5
        server.close()

    run(body)


def test_open_requests_and_connections_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_ends, "MAX_OPEN", 3)

    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append)
        asked = [asyncio.create_task(raw(server.address, http(BODY))) for _ in range(3)]
        await until(lambda: len(heard) == 3)
        assert status(await raw(server.address, http(BODY))) == 503
        assert server.counts.overflowed == 1
        for _ in range(3):
            assert server.send(ACCEPTED)
        assert [status(answer) for answer in await asyncio.gather(*asked)] == [200] * 3
        lines = [await asyncio.open_connection(*server.address) for _ in range(MAX_CONNECTIONS + 5)]
        await until(lambda: server.counts.overflowed >= 1 + 5)
        for _, writer in lines:
            writer.close()
        client = await HttpClientTransport.open(heard.append, server.address)
        assert [client.send(REQUEST) for _ in range(5)] == [True] * 3 + [False] * 2
        assert client.counts.overflowed == 2
        client.close()
        server.close()

    run(body)


def test_a_flood_of_pipelined_requests_is_survived() -> None:
    async def body() -> None:
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append)
        _, writer = await asyncio.open_connection(*server.address)
        whole = http(BODY).replace(b"Connection: close\r\n", b"")
        writer.write(whole * (16_000_000 // len(whole)))
        await until(lambda: heard)
        # a few dozen are taken in before the first is answered, and what fits the system's buffers: the rest waits
        waiting = -1
        while waiting != (waiting := writer.transport.get_write_buffer_size()):
            await asyncio.sleep(0.05)
        assert waiting > 4_000_000
        assert len(heard) == 1
        writer.close()
        assert server.send(ACCEPTED)
        server.close()

    run(body)


def test_only_with_the_token() -> None:
    async def body() -> None:
        notes: list[tuple[str, str]] = []
        heard: list[Piece] = []
        server = await HttpServerTransport.open(heard.append, token="s3cret", on_note=lambda *note: notes.append(note))
        assert status(await raw(server.address, http(BODY))) == 401
        assert status(await raw(server.address, http(BODY, more="Authorization: Bearer guess\r\n"))) == 401
        assert server.counts.refused == 2
        assert [kind for kind, _ in notes] == ["refused", "refused"]
        client = await HttpClientTransport.open(heard.append, server.address, token="s3cret")
        assert client.send(REQUEST)
        await until(lambda: heard)
        assert heard[0].data == REQUEST
        client.close()
        server.close()

    run(body)


def test_a_client_waits_for_a_service_and_outlives_it() -> None:
    async def body() -> None:
        _, server = await Service.open()
        address = server.address
        answers: list[Piece] = []
        notes: list[tuple[str, str]] = []
        client = await HttpClientTransport.open(answers.append, address, on_note=lambda *note: notes.append(note))
        assert client.send(REQUEST)
        await until(lambda: len(answers) == 1)
        server.close()
        await until(lambda: not server._limited.connections)
        assert client.send(REQUEST)
        await until(lambda: client.counts.lost == 1)
        assert len(answers) == 1
        assert notes[0][0] == "lost"
        assert str(address[1]) in notes[0][1]
        _, server = await Service.open(address)
        assert client.send(REQUEST)
        await until(lambda: len(answers) == 2)
        assert answers[0] == answers[1]
        client.close()
        assert not client.send(REQUEST)
        server.close()

    run(body)


@pytest.mark.parametrize(
    ("answer", "garbage"),
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\nnope", 1),
        (b"HTTP/1.1 302 Found\r\nLocation: http://192.0.2.1/\r\nContent-Length: 0\r\n\r\n", 1),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9999999\r\n\r\n{", 1),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{", 0),
        (b"\x00\xff\r\n\r\n", 0),
        (b"", 0),
    ],
)
def test_a_service_that_speaks_nonsense_is_survived(answer: bytes, garbage: int) -> None:
    async def body() -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(answer)
            await writer.drain()
            writer.close()

        service = await asyncio.start_server(serve, LOOPBACK, 0)
        pieces: list[Piece] = []
        client = await HttpClientTransport.open(pieces.append, service.sockets[0].getsockname()[:2])
        assert client.send(REQUEST)
        await until(lambda: client.counts.garbage + client.counts.lost == 1)
        assert client.counts.garbage == garbage
        assert all(piece.garbage for piece in pieces)
        for unfit in (b"\xff", b"{}", b'{"method":"PUT","path":"x"}', b'{"method":"P T","path":"/"}'):
            assert not client.send(unfit)
        assert client.counts.unfit == 4
        client.close()
        service.close()

    run(body)


def test_a_port_in_use_and_an_address_beyond_loopback_are_named() -> None:
    async def body() -> None:
        _, server = await Service.open()
        with pytest.raises(OSError, match=f"{LOOPBACK}:{server.address[1]}.*in use"):
            await HttpServerTransport.open(lambda _: None, server.address)
        server.close()
        with pytest.raises(InputError, match=r"0\.0\.0\.0:80.*Give it a token"):
            await HttpServerTransport.open(lambda _: None, ("0.0.0.0", 80))
        with pytest.raises(InputError, match=r"192\.0\.2\.1:80"):
            await HttpClientTransport.open(lambda _: None, ("192.0.2.1", 80))

    run(body)
