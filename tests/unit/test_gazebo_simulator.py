"""Is a Gazebo that does not start, does not answer or answers nonsense named, and does nothing of it stay?"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from skyrange.codec.gazebo_protocol import Aircraft, encode_hello
from skyrange.core.errors import ComponentError
from skyrange.io import gazebo
from skyrange.io.gazebo import GazeboSimulator

IRIS = Aircraft("blue.1", 1e-5, 0.02, 1e-4, 0.01, 1e-4, [(0.1, 0.1, 1.0)] * 4)
PROLOGUE = """
import socket, struct, sys, time
peer = socket.socket(fileno=0)

def take(count):
    data = b""
    while len(data) < count:
        piece = peer.recv(count - len(data))
        if not piece:
            sys.exit(0)
        data += piece
    return data

def receive():
    length, kind, zero, number = struct.unpack("<IHHI", take(12))
    return kind, number, take(length)

def send(kind, number, body):
    peer.sendall(struct.pack("<IHHI", len(body), kind, 0, number) + body)

def text(value):
    return struct.pack("<I", len(value)) + value.encode()

def ready(number, version=1):
    send(129, number, struct.pack("<8sI", b"SKYGAZEB", version) + text("99.1") + text("tested"))

def stepped(number, body, value=0.0):
    tick = struct.unpack_from("<q", body)[0]
    send(130, number, struct.pack("<qI4x", tick, 0) + struct.pack("<13d", *[value] * 13))
"""


def start(tmp_path: Path, body: str) -> GazeboSimulator:
    """A program that speaks as the plugin does, and then does `body`."""
    script = tmp_path / "fake.py"
    script.write_text(PROLOGUE + dedent(body))
    hello = encode_hello([IRIS], [], 0.0025, 1, 4)
    return GazeboSimulator("engine gazebo", [sys.executable, str(script)], hello, (1, 0))


def step(one: GazeboSimulator, tick_ns: int = 0, deadline_s: float = 20.0) -> np.ndarray:
    one.begin_step(tick_ns, np.zeros((1, 13)), np.zeros((0, 7)))
    return one.end_step(deadline_s).states


def test_each_tick_is_answered_by_its_own_state(tmp_path: Path) -> None:
    one = start(
        tmp_path,
        """
        kind, number, body = receive()
        ready(number)
        for tick in range(3):
            kind, number, body = receive()
            stepped(number, body, float(tick))
        """,
    )
    assert (one.release, one.physics) == ("99.1", "tested")
    assert [step(one, 10 * tick)[0, 0] for tick in range(3)] == [0.0, 1.0, 2.0]
    one.close()
    one.close()


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("print('no such file'); sys.exit(3)", r"ended \(exit 3\).*no such file"),
        ("print('[Err] Failed to load plugin libskyrange.so: undefined symbol'); time.sleep(60)", "undefined symbol"),
        (
            "print('Error while loading the library [dartsim.so]: libdart.so.6: no such file', flush=True);"
            "k, n, b = receive(); ready(n); time.sleep(60)",
            "cannot load what it needs: .*libdart.so.6.*install the package",
        ),
        ("k, n, b = receive(); ready(n, 2)", "version 2 of the protocol.*skyrange install gazebo"),
        ("k, n, b = receive(); ready(n + 1)", "READY 1 to request 0"),
        ("k, n, b = receive(); send(255, n, text('the world has no model named blue.1'))", "no model named blue.1"),
        ("peer.sendall(b'GET / HTTP/1.1' * 9); time.sleep(60)", "sent a header of"),
        ("time.sleep(60)", "did not start its world within 1 s"),
    ],
)
def test_one_that_does_not_start_is_named(
    body: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "within 1 s" in told:
        monkeypatch.setattr(gazebo, "START_S", 1.0)
    with pytest.raises(ComponentError, match=f"(?s)engine gazebo.*{told}"):
        start(tmp_path, body)
    assert not _running(str(tmp_path / "fake.py")), "a process was left behind"


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("sys.exit(1)", r"ended \(exit 1\)"),
        ("stepped(n, b, float('nan'))", "not a number"),
        ("stepped(n, struct.pack('<q', 7))", "the tick 7, expected 0"),
        ("send(130, n, b'')", "a STEPPED of 0 bytes"),
        ("send(255, n, text('the model blue.1 was removed'))", "failed: the model blue.1 was removed"),
        ("time.sleep(60)", "did not answer for 0.5 s"),
    ],
)
def test_one_that_fails_in_flight_is_named(body: str, told: str, tmp_path: Path) -> None:
    one = start(tmp_path, f"k, n, b = receive(); ready(n); k, n, b = receive(); {body}; time.sleep(60)")
    with pytest.raises(ComponentError, match=f"engine gazebo.*{told}"):
        step(one, deadline_s=0.5 if "0.5" in told else 20.0)
    one.close()
    assert not _running(str(tmp_path / "fake.py")), "a process was left behind"


def test_a_wrapper_leaves_nothing_behind(tmp_path: Path) -> None:
    wrapper = tmp_path / "wrapper.sh"
    wrapper.write_text(f'#!/bin/sh\nexec 3<&0\n"{sys.executable}" "$@" <&3 &\nwait\n')
    wrapper.chmod(0o755)
    script = tmp_path / "fake.py"
    script.write_text(PROLOGUE + "k, n, b = receive(); ready(n); time.sleep(60)")
    hello = encode_hello([IRIS], [], 0.0025, 1, 4)
    one = GazeboSimulator("engine gazebo", [str(wrapper), str(script)], hello, (1, 0))
    one.close()
    until = time.monotonic() + 5.0
    while _running(str(script)) and time.monotonic() < until:
        time.sleep(0.02)
    assert not _running(str(script))


def _running(word: str) -> list[str]:
    """Processes of ours with this word in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
                if word.encode() in (entry / "cmdline").read_bytes() and state != "Z":
                    found.append(entry.name)
            except OSError:
                continue
    return found
