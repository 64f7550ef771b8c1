"""Trial of an engine: one frame from one radio to another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.codec.medium_protocol import (
    NOISE,
    PATH,
    TRANSMISSION,
    Advance,
    EngineRadio,
    Hello,
    MessageType,
    decode_done,
    decode_ready,
    encode_advance,
    encode_hello,
)
from skyrange.contracts.medium import ReceptionOutcome, Waveform
from skyrange.core.errors import ComponentError, DecodeError
from skyrange.core.time import NS_PER_MS
from skyrange.io.processes.program_socket import EngineSocket

TRIAL_S: Final = 60.0
"""Wall time within which an engine must answer, in seconds."""


def try_engine(who: str, command: Sequence[str]) -> tuple[str, str]:
    """Let an engine send one frame from one radio to another; its name and release.

    Raises `ComponentError` if it does not greet, or if the frame is not received.
    """
    engine = EngineSocket(who, command, TRIAL_S)
    try:
        radios = [EngineRadio("one", 1, 7.0), EngineRadio("two", 2, 7.0)]
        kind, body = engine.request(MessageType.HELLO, encode_hello(Hello(1, 1000.0, False, radios)))
        if kind != MessageType.READY:
            raise ComponentError(who, f"answered {kind.name} instead of READY")
        ready = decode_ready(body)
        frames, paths = np.zeros(1, dtype=TRANSMISSION), np.zeros(1, dtype=PATH)
        frames[0] = (7, NS_PER_MS, 15.0, 0, 200, Waveform.OFDM_6M, 6, 0, 1, 0)
        paths[0] = (-60.0, 1, 0)
        places = np.array([(0.0, 0.0, 10.0), (10.0, 0.0, 10.0)])
        advance = Advance(20 * NS_PER_MS, 0, places, frames, np.zeros(0, dtype=NOISE), paths)
        kind, body = engine.request(MessageType.ADVANCE, encode_advance(advance))
        if kind != MessageType.DONE:
            raise ComponentError(who, f"answered {kind.name} instead of DONE")
        heard = decode_done(body).heard
        if heard["key"].tolist() != [7] or heard["outcome"][0] != ReceptionOutcome.DECODED:
            raise ComponentError(who, "does not receive a frame over 10 m")
        return ready.name, ready.release
    except DecodeError as error:
        raise ComponentError(who, f"sent {error}") from None
    finally:
        engine.close()
