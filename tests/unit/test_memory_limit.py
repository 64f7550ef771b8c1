"""Commands under a limit of their address space end with a message and an exit code, whatever a library does."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys

import pytest

from skyrange.cli.memory_limit import LEAST_BYTES, OUT_OF_MEMORY

CHILD = """
import os, resource, signal, sys, time
from skyrange.cli.memory_limit import run_within_limit
resource.setrlimit(resource.RLIMIT_AS, ({limit}, resource.RLIM_INFINITY))
def command():
    {command}
sys.exit(run_within_limit(command))
"""


def _start(command: str, limit: int = LEAST_BYTES) -> subprocess.Popen[str]:
    code = CHILD.format(limit=limit, command=command)
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("command", ["os.abort()", "os._exit(1)", "os.kill(os.getpid(), signal.SIGSEGV)"])
def test_a_library_that_ends_the_process_is_explained(command: str) -> None:
    """LLVM aborts without memory: `std::bad_alloc`, exit code 134."""
    ended = _start(command)
    _, told = ended.communicate(timeout=30)
    assert (ended.returncode, told) == (3, f"skyrange: {OUT_OF_MEMORY}\n")


@pytest.mark.parametrize("code", [0, 1, 2, 3, 4])
def test_other_exit_codes_are_those_of_the_command(code: int) -> None:
    ended = _start(f"return {code}")
    assert ended.communicate(timeout=30) == ("", "")
    assert ended.returncode == code


def test_a_limit_below_what_libraries_need_is_refused() -> None:
    ended = _start("return 0", 1_000_000_000)
    assert ended.communicate(timeout=30)[1] == (
        "skyrange: memory: limit: 1,000 MB — expected at least 1,500 MB of address space. Raise it (`ulimit -v`).\n"
    )
    assert ended.returncode == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reach_the_command(number: signal.Signals) -> None:
    waiting = f"signal.pthread_sigmask(signal.SIG_BLOCK, {{{int(number)}}}); print('ready', flush=True)"
    started = _start(f"{waiting}; return 7 * (signal.sigwait({{{int(number)}}}) == {int(number)})")
    assert started.stdout is not None
    assert started.stdout.readline() == "ready\n"
    started.send_signal(number)
    started.communicate(timeout=30)
    assert started.returncode == 7


def test_a_command_that_is_killed_is_not_called_out_of_memory() -> None:
    ended = _start("os.kill(os.getpid(), signal.SIGKILL)")
    assert ended.communicate(timeout=30)[1] == ""
    assert ended.returncode == 128 + signal.SIGKILL


def test_a_killed_command_leaves_no_process_behind() -> None:
    started = _start("print('ready', flush=True); time.sleep(300)")
    assert started.stdout is not None
    assert started.stdout.readline() == "ready\n"
    started.kill()
    started.communicate(timeout=30)  # it ends when the child has closed its output too


def test_without_a_limit_nothing_is_forked() -> None:
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY
    code = "import os\nfrom skyrange.cli.memory_limit import run_within_limit\n"
    code += "before = os.getpid()\nassert run_within_limit(lambda: int(os.getpid() != before)) == 0"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=30)
