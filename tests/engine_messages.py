"""The engine's side of the medium protocol: what skyrange encodes is decoded, and the other way round."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.codec import medium_protocol as protocol


def decode_hello(body: bytes) -> protocol.Hello:
    """Decode a HELLO, as an engine does."""
    reader = protocol._Reader(body)
    magic, version, _, seed, _, horizon_m, own, radios, buildings, _ = reader.fields(protocol._HELLO)
    protocol._check_version(magic, version)
    lines = reader.text().splitlines()
    params = dict(line.split("=", 1) for line in lines if "=" in line)
    found = []
    for _ in range(radios):
        stream, noise_figure_db = reader.fields(protocol._RADIO)
        found.append(protocol.EngineRadio(reader.text(), stream, noise_figure_db))
    blocks = []
    for _ in range(buildings):
        base_m, top_m, corners = reader.fields(protocol._BUILDING)
        places = np.frombuffer(reader.take(16 * corners), dtype="<f8").reshape(-1, 2).copy()
        blocks.append(protocol.Building(base_m, top_m, places))
    reader.end()
    return protocol.Hello(seed, horizon_m, bool(own), found, params, blocks)


def encode_ready(ready: protocol.Ready) -> bytes:
    """The body of a READY."""
    head = protocol._READY.pack(
        protocol.MAGIC, protocol.VERSION, ready.waveforms, int(ready.abilities), 0, ready.lookahead_ns
    )
    return head + protocol._text(ready.name) + protocol._text(ready.release)


def decode_advance(body: bytes, radios: int) -> protocol.Advance:
    """Decode an ADVANCE, as an engine with `radios` radios does."""
    reader = protocol._Reader(body)
    until, since, has_places, transmissions, noise, paths = reader.fields(protocol._ADVANCE)
    places = None
    if has_places:
        places = np.frombuffer(reader.take(24 * radios), dtype="<f8").reshape(radios, 3).copy()
    found = protocol.Advance(
        until, since, places, reader.rows(protocol.TRANSMISSION, transmissions), reader.rows(protocol.NOISE, noise),
        reader.rows(protocol.PATH, paths),
    )  # fmt: skip
    reader.end()
    return found


def encode_done(done: protocol.Done) -> bytes:
    """The body of a DONE."""
    head = protocol._DONE.pack(done.events, done.active, len(done.sent), len(done.heard))
    sent = np.ascontiguousarray(done.sent, dtype=protocol.SENT)
    heard = np.ascontiguousarray(done.heard, dtype=protocol.HEARD)
    return head + sent.tobytes() + heard.tobytes()


def decode_path_losses(body: bytes) -> NDArray[np.float64]:
    """Decode a PATH_LOSSES, as an engine does."""
    return protocol._decode_floats(body, 6)


def encode_losses(losses_db: NDArray[np.float64]) -> bytes:
    """The body of a LOSSES: (k,) dB."""
    losses = np.ascontiguousarray(losses_db, dtype="<f8")
    return protocol._COUNT.pack(len(losses)) + losses.tobytes()


def encode_failed(reason: str) -> bytes:
    """The body of a FAILED."""
    return protocol._text(reason)
