"""Program of a radio engine: its file, its parameters, its starts beside a medium, and a trial of one frame."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np

from skyrange.codec.medium_protocol import (
    NOISE,
    PATH,
    TRANSMISSION,
    Ability,
    Advance,
    EngineRadio,
    Hello,
    MessageType,
    Ready,
    decode_done,
    decode_ready,
    encode_advance,
    encode_hello,
)
from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.medium import ProgramStatus, ReceptionOutcome, Waveform
from skyrange.contracts.params import Params
from skyrange.core.engine_sources import engine_folder, source_digest
from skyrange.core.errors import ComponentError, DecodeError, InputError
from skyrange.core.files import expand_user
from skyrange.core.time import NS_PER_MS
from skyrange.io.processes.program_socket import EngineSocket


def encode_params(params: Params) -> dict[str, str]:
    """Parameters as texts, without those that are None and without `deadline_s`, which is skyrange's own."""
    values = params.model_dump(exclude_none=True, exclude={"deadline_s"})
    return {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in values.items()}


def find_engine(name: str, title: str, variable: str, install: str) -> Path:
    """The compiled program of an engine: the file that `variable` names, else the one compiled last from these sources.

    Raises `InputError` in the name of `title`, with the command `install`, if there is none.
    """
    hint = f"Compile it: {install}"
    named = os.environ.get(variable)
    if named:
        path = expand_user(named)
        if not os.access(path, os.X_OK) or path.is_dir():
            raise InputError.one(variable, "path", named, "an executable file", hint)
        return path
    folder = engine_folder(name)
    digest = source_digest(name)[:16]
    programs = [path for path in folder.glob(f"{digest}-*/engine") if os.access(path, os.X_OK)]
    if programs:
        return max(programs, key=lambda path: path.stat().st_mtime_ns)
    older = any(folder.glob("*/engine"))
    value = "compiled from sources of another version of skyrange" if older else "not compiled yet"
    raise InputError.one(title, "radio.engine", value, "its engine program", hint)


MAX_STARTS: Final = 4
"""Starts of one engine, as of a process of a live range."""
WIFI: Final = (int(Waveform.DSSS_1M), int(Waveform.OFDM_6M))


class EngineStarts:
    """Starts an engine and greets it, as often as `on_death` allows (see `MediumContext.on_death`)."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        hello: Hello,
        deadline_s: float,
        on_death: Literal["stop", "continue", "restart"],
    ) -> None:
        self.command = tuple(command)
        self.ended: tuple[str, ...] = ()
        """How the engines ended that were started so far, but for the one that runs."""
        self.gone = False
        """Whether the last one died and is not replaced."""
        self._name = f"radio engine {name}"
        self._hello = hello
        self._deadline_s = deadline_s
        self._on_death = on_death

    def start(self) -> tuple[EngineSocket, Ready]:
        """The engine and its answer to HELLO. Raises `ComponentError` if it does not start, or cannot do its part."""
        engine = EngineSocket(self._name, self.command, self._deadline_s)
        try:
            return engine, self._greet(engine)
        except BaseException:
            engine.close()
            raise

    def replace(self, dead: EngineSocket, error: ComponentError) -> tuple[EngineSocket, Ready] | None:
        """The engine in place of one that failed with `error`, which is ended; None to go on without one.

        Raises `error` if `on_death` is "stop".
        """
        dead.close()
        if self._on_death == "stop":
            raise error
        while True:
            self.ended = (*self.ended, str(error))
            if self._on_death == "continue" or len(self.ended) >= MAX_STARTS:
                self.gone = True
                return None
            try:
                return self.start()
            except ComponentError as again:
                error = again

    def status(self, engine: EngineSocket) -> ProgramStatus:
        """The status of `engine`, the last one that was started."""
        state = InstanceStatus.DEAD if self.gone else InstanceStatus.READY
        return ProgramStatus(self._name, engine.pid, state, self.ended)

    def _greet(self, engine: EngineSocket) -> Ready:
        kind, body = engine.request(MessageType.HELLO, encode_hello(self._hello))
        try:
            if kind != MessageType.READY:
                raise DecodeError(f"{kind.name} instead of READY")
            ready = decode_ready(body)
        except DecodeError as error:
            raise engine.misspoke(error) from None
        if not ready.waveforms & sum(1 << waveform for waveform in WIFI):
            raise ComponentError(self._name, "simulates neither of the Wi-Fi waveforms of this medium")
        if self._hello.own_losses and Ability.OWN_LOSSES not in ready.abilities:
            hint = 'Use losses = "city", with which skyrange computes the losses'
            raise ComponentError(self._name, "cannot compute path losses", hint)
        return ready


TRIAL_S: Final = 60.0
"""Wall time within which an engine must answer, in seconds."""


def try_engine(who: str, command: Sequence[str]) -> tuple[str, str]:
    """Let an engine send one frame from one radio to another; its name and release.

    Raises `ComponentError` if it does not greet, or if the frame is not received.
    """
    engine = EngineSocket(who, command, TRIAL_S)
    try:
        radios = [EngineRadio("one", 1, 7.0), EngineRadio("two", 2, 7.0)]
        kind, body = engine.request(MessageType.HELLO, encode_hello(Hello(1, 1000.0, own_losses=False, radios=radios)))
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
