"""Starts of a medium's engine: the first, and those that replace an engine that has died."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

from skyrange.codec.medium_protocol import Ability, Hello, MessageType, Ready, decode_ready, encode_hello
from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.medium import ProgramStatus, Waveform
from skyrange.core.errors import ComponentError, DecodeError
from skyrange.io.processes.program_socket import EngineSocket

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
