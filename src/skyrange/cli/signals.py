"""Signals that end a command: SIGINT, SIGTERM and SIGHUP unwind it, so that it cleans up and has its exit code.

Parts that end in order, such as a run, note signals themselves while they last (`runtime.interrupt`).
"""

from __future__ import annotations

import os
import signal
import threading
from types import FrameType, TracebackType

INTERRUPTED = 4
"""The exit code of a command that a signal ended: it fell short of what was requested."""


class EndingSignals:
    """A context in which these signals raise `KeyboardInterrupt`, and `received` has the first of them.

    A second SIGINT raises again; a second one of the others does nothing, because the command is ending. SIGHUP stays
    ignored where it is (`nohup`). Processes that are forked in the context end by SIGTERM and SIGHUP as others do.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._process = os.getpid()
        self._before: dict[int, object] = {}

    def __enter__(self) -> EndingSignals:
        if threading.current_thread() is threading.main_thread():
            hang_up = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
            for number in (signal.SIGINT, signal.SIGTERM, *hang_up):
                self._before[number] = signal.signal(number, self._end)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal.signal itself returned

    def _end(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._process and number != signal.SIGINT:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        is_first = self.received is None
        self.received = self.received or signal.Signals(number)
        if is_first or number == signal.SIGINT:
            raise KeyboardInterrupt
