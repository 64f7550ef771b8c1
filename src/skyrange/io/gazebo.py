"""Gazebo as a child process: port, the loading of its plugin, and one exchange for each tick of the range's world."""

from __future__ import annotations

import contextlib
import re
import socket
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from skyrange.codec.gazebo_protocol import (
    HEADER,
    Floats,
    MessageType,
    Stepped,
    decode_failed,
    decode_ready,
    decode_stepped,
    encode_step,
    pack,
    unpack_header,
)
from skyrange.core.errors import ComponentError, DecodeError, InputError
from skyrange.io.processes.program import Program
from skyrange.io.processes.program_socket import ProgramSocket, start_with_socket

WORLD: Final = "world.sdf"
_LOAD_LOOK_S: Final = 0.05
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")
_NO_LIBRARY: Final = "error while loading shared libraries"
_FAILURE: Final = re.compile(
    r"^.*(?:Failed to load (?:system )?plugin|Error while loading the library|Error parsing XML"
    r"|Failed to find plugin \[|Unable to load the \[.*\] library|No physics plugins|Failed to load .*physics engine"
    r"|Unable to read .*file|Unable to start server).*$",
    re.MULTILINE,
)
"""What Gazebo says of a plugin, physics engine, world, or port that it cannot use; without the first two it goes on."""


def find_load_failure(text: str) -> str:
    """The first line of Gazebo's output which says that it cannot load a plugin or its world; "" if there is none."""
    match = _FAILURE.search(_COLOURS.sub("", text))
    return match[0].strip() if match else ""


def wait_for_plugin(
    who: str, title: str, command: Callable[[Path], tuple[str, ...]], world: str, loaded: str, deadline_s: float
) -> None:
    """Start a Gazebo named `title` with the SDF text `world`, wait until it prints `loaded`, and kill it.

    `command` returns its command line for a file of the world. Raises `ComponentError` in the name of `who` if it does
    not start, ends early, says that it cannot load something, or has not printed `loaded` after `deadline_s` of wall
    time.
    """
    with tempfile.TemporaryDirectory(prefix="skyrange-gazebo-") as name:
        folder = Path(name)
        file = folder / WORLD
        file.write_text(world)
        program = Program(who, ("env", f"HOME={folder}", *command(file)), folder, is_wrapper=True)  # its logs go there
        try:
            _wait(who, title, program, loaded, deadline_s)
        finally:
            program.kill()


def _wait(who: str, title: str, program: Program, loaded: str, deadline_s: float) -> None:
    until = time.monotonic() + deadline_s
    while True:
        ended = program.ended
        output = _COLOURS.sub("", program.last_words(_LINES))
        if loaded in output:
            return
        failure = find_load_failure(output)
        if failure:
            raise ComponentError(who, f"{title} does not load it: {failure}")
        last = " | ".join(output.splitlines()[-3:]) or "it printed nothing"
        if ended:
            hint = "Set LD_LIBRARY_PATH to the folder of its libraries" if _NO_LIBRARY in output else ""
            raise ComponentError(who, f"{title} ended ({ended}) before it had loaded it: {last}", hint)
        if time.monotonic() > until:
            raise ComponentError(who, f"{title} has not loaded it within {deadline_s:g} s of wall time: {last}")
        time.sleep(_LOAD_LOOK_S)


def take_port(wanted: int, where: str) -> int:
    """The TCP port `wanted`, or a free one for 0. Raises `InputError` in the name of the key `where` if it is used."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", wanted))
        except OSError as error:
            hint = "Another Gazebo may be running. Omit the port to have a free one chosen."
            expected = f"a free port ({error.strerror})"
            raise InputError.one("gazebo", where, str(wanted), expected, hint) from None
        return int(probe.getsockname()[1])


START_S: Final = 120.0
"""Wall seconds in which Gazebo has to load its world: a city of thousands of meshes takes half a minute."""
_CLOSE_S: Final = 1.0
_LOOK_S: Final = 0.25
_LINES: Final = 100
_WINDOW: Final = "gazebo window"


class GazeboSimulator(ProgramSocket):
    """One Gazebo: `begin_step` and `end_step` in turn, then `close`."""

    slow_hint = "Gazebo computes too slowly, or hangs; `[autopilots] deadline_s` sets the time that it has"

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        hello: bytes,
        sizes: tuple[int, int],
        window: Sequence[str] = (),
    ) -> None:
        """Start `command`, and wait until it has loaded the world and answered `hello`; `sizes` are the numbers of
        aircraft and of buildings. `window` is the command of its window, if it is to have one.

        Raises `ComponentError` in the name of `name` if it does not start, does not load the plugin, or does not find
        what `hello` names in the world.
        """
        self.name = name
        self.deadline_s = START_S
        self._aircraft, self._buildings = sizes
        self._number = 0
        self._tick = 0
        self._folders = [tempfile.TemporaryDirectory(prefix="skyrange-gazebo-")]
        self._window: Program | None = None
        self._shared: Any = None
        try:
            folder = Path(self._folders[0].name)
            self._shared, program = start_with_socket(name, command, folder, is_wrapper=True)
            self.use(self._shared, program)
            self.release, self.physics = self._open(hello)
            if window:
                self._folders.append(tempfile.TemporaryDirectory(prefix="skyrange-gazebo-"))
                shown_in = Path(self._folders[1].name)
                self._window = Program(_WINDOW, list(window), shown_in, is_wrapper=True)
        except BaseException:
            self.close()
            raise

    def _open(self, hello: bytes) -> tuple[str, str]:
        """Gazebo's version, and its physics engine."""
        until = time.monotonic() + self.deadline_s
        self.send(pack(MessageType.HELLO, self._number, hello), until)
        while not self._ready.poll(_LOOK_S * 1000.0):
            self._check_loaded()
            if time.monotonic() > until:
                words = self._program.last_words(_LINES)
                hint = f"Its last output was: {words}" if words else "It printed nothing"
                raise ComponentError(self.name, f"did not start its world within {START_S:g} s of wall time", hint)
        try:
            ready = decode_ready(self._receive(MessageType.READY, until))
        except DecodeError as error:
            hint = "Compile its plugin again: skyrange install gazebo"
            raise ComponentError(self.name, f"sent {error}", hint) from None
        self._check_loaded()  # without its physics engine it answers, and moves nothing
        return ready

    def _check_loaded(self) -> None:
        failure = find_load_failure(self._program.last_words(_LINES))
        if failure:
            hint = (
                "If it is skyrange's plugin, compile it for this Gazebo: skyrange install gazebo. "
                "If it is Gazebo's, install the package that has it, or that has the library it needs"
            )
            raise ComponentError(self.name, f"cannot load what it needs: {failure}", hint)

    def begin_step(self, tick_ns: int, inputs: Floats, shown: Floats) -> None:
        """Let Gazebo compute the tick from `tick_ns` to the next; arguments as of `encode_step`."""
        self._number += 1
        self._tick = tick_ns
        body = encode_step(tick_ns, inputs, shown)
        self.send(pack(MessageType.STEP, self._number, body), time.monotonic() + self.deadline_s)

    def end_step(self, deadline_s: float) -> Stepped:
        """The states after the tick and the contacts in it. Raises `ComponentError` if they do not come within
        `deadline_s` of wall time.
        """
        self.deadline_s = deadline_s
        try:
            body = self._receive(MessageType.STEPPED, time.monotonic() + deadline_s)
            return decode_stepped(body, self._tick, self._aircraft, self._buildings)
        except DecodeError as error:
            raise ComponentError(self.name, f"sent {error}") from None

    def _receive(self, expected: MessageType, until: float) -> bytes:
        length, kind, number = unpack_header(self.read(HEADER.size, until))
        body = self.read(length, until)
        if kind is MessageType.FAILED:
            raise ComponentError(self.name, f"failed: {decode_failed(body)}")
        if kind is not expected or number != self._number:
            raise DecodeError(f"the answer {kind.name} {number} to request {self._number}")
        return body

    @property
    def cpu_s(self) -> float:
        """Processor time that Gazebo has used so far, in seconds."""
        return self._program.cpu_s

    @property
    def window_cpu_s(self) -> float:
        """Processor time that its window has used so far, in seconds; 0 without one."""
        return 0.0 if self._window is None else self._window.cpu_s

    def close(self) -> None:
        """End Gazebo, which ends by itself when its socket closes, and its window. A second call does nothing."""
        if self._window is not None:
            self._window.kill()
        if self._shared is not None:
            self._shared.close()
            until = time.monotonic() + _CLOSE_S
            while self._program.running and time.monotonic() < until:
                time.sleep(0.005)
            self._program.kill()
            self._shared = None
        for folder in self._folders:
            folder.cleanup()
