"""No text can control the terminal, no reader that goes away ends a command, and no failure exits with 0."""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any
from unicodedata import category

import pytest
from hypothesis import given
from hypothesis import strategies as st

import skyrange.cli
from skyrange.cli.output import console, run_summary
from skyrange.cli.output.escaping import escape
from skyrange.runtime.interrupt import Interruptible

MAIN = [sys.executable, "-c", "from skyrange.cli import main; main()"]
HOSTILE = "\x1b]0;owned\x07 \x9b31m \x7f \u202egnp.exe \ud800 \udcff \u2028 [red]x[/] :bomb:"
texts = st.text(st.characters(blacklist_categories=()))


def controls(text: str) -> list[str]:
    """The characters in a text that are no text, but for line breaks and the joiners of some scripts."""
    return [one for one in text if category(one) in ("Cc", "Cf", "Cs", "Zl", "Zp") and one not in "\n\t\u200c\u200d"]


@given(texts)
def test_escaped_text_controls_nothing_and_plain_text_stays(text: str) -> None:
    escaped = escape(text)
    assert controls(escaped) == []
    assert escape(escaped) == escaped
    if not controls(text):
        assert escaped == text


@given(st.dictionaries(texts, st.lists(texts)))
def test_json_stays_valid_and_controls_nothing(data: dict[str, Any]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        printed: list[str] = []
        patch.setattr("builtins.print", lambda text, **_: printed.append(text))
        console.print_json(data)
    assert controls(printed[0]) == []
    assert json.loads(printed[0]) == json.loads(json.dumps(data))


def test_a_table_shows_hostile_names_as_they_are(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    row = {
        "id": HOSTILE, "operator": HOSTILE, "outcome": HOSTILE, "reason": HOSTILE, "mishap": None, "finished_s": None,
        "landed_s": None, "distance_m": 1.0, "highest_m": 2.0, "frames_sent": 9, "frames_received": 9,
    }  # fmt: skip
    facts = {
        "name": HOSTILE, "status": HOSTILE, "vehicles": [row], "mishaps": [{"words": HOSTILE}], "timings": {},
        "simulated_s": 60.0, "frames": 9, "seed": HOSTILE, "fingerprint": HOSTILE, "path": HOSTILE, "report": HOSTILE,
        "equivocators": [HOSTILE], "disk": {HOSTILE: 5},
    }  # fmt: skip
    run_summary.print_summary(facts)
    run_summary.print_disk(facts)
    facts["vehicles"] = [row] * (run_summary.MAX_AIRCRAFT + 1)
    run_summary.print_summary(facts)
    out = capsys.readouterr().out
    assert controls(out) == []
    assert out.count("[red]x[/] :bomb:") > 10
    assert "\\x1b]0;owned" in out


def test_all_output_of_commands_passes_the_console() -> None:
    """Nothing else prints: no `print`, no `echo`, no writing to a stream, no console of rich's own."""
    folder = Path(skyrange.cli.__file__).parent
    own = {"console.py", "escaping_console.py", "standard_streams.py"}
    for path in (*folder.rglob("*.py"), *(folder.parent / "runtime").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())) if path.name not in own else ():
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            forbidden = {"print", "typer.echo", "typer.secho", "Console", "sys.stdout.write", "sys.stderr.write"}
            assert called not in forbidden, f"{path}:{getattr(node, 'lineno', 0)}"


def run_command(*arguments: str, redirect: str = "", **more: Any) -> subprocess.CompletedProcess[bytes]:
    script = f'exec "$@" {redirect}'
    return subprocess.run(["bash", "-c", script, "bash", *MAIN, *arguments], capture_output=True, check=False, **more)


REDIRECTS = (">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-", "2>/dev/full")
COMMANDS: tuple[tuple[list[str], int], ...] = ((["scenarios"], 0), (["show", "nowhere"], 2), (["shwo"], 2))


@pytest.mark.parametrize(
    ("redirect", "arguments", "code"),
    [
        pytest.param(redirect, *command, marks=() if (place + number) % 3 == 0 else pytest.mark.slow)
        for place, redirect in enumerate(REDIRECTS)
        for number, command in enumerate(COMMANDS)
    ],
)
def test_closed_streams_change_no_exit_code(redirect: str, arguments: list[str], code: int, tmp_path: Path) -> None:
    done = run_command(*arguments, redirect=redirect, cwd=tmp_path)
    assert done.returncode == code
    assert b"Traceback" not in done.stdout + done.stderr


def test_a_full_disk_behind_the_output_is_an_error() -> None:
    done = run_command("scenarios", redirect=">/dev/full")
    assert done.returncode == 2
    assert done.stderr == b"skyrange: No space left on device\n"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [pytest.param(["schema"], 0, marks=pytest.mark.slow), (["--help"], 0), (["show", "nowhere"], 2)],
)
def test_a_reader_that_goes_away_costs_its_output_alone(arguments: list[str], code: int) -> None:
    inlet, outlet = os.pipe()
    os.close(inlet)
    done = subprocess.run([*MAIN, *arguments], stdout=outlet, stderr=outlet, check=False)
    os.close(outlet)
    assert done.returncode == code


@pytest.mark.rotating
def test_errors_and_usage_escape_what_they_quote(tmp_path: Path) -> None:
    name = "\x1b]0;owned\x07\udcff"
    for arguments in (["show", name], ["run", name], ["scenarios", name], [name], ["diff", name, name, "--json"]):
        done = run_command(*(os.fsencode(one).decode(errors="surrogateescape") for one in arguments), cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.startswith((b"skyrange: ", b"Usage: "))
        assert b"\\x1b]0;owned\\x07" in done.stderr
        assert controls(done.stderr.decode()) == []
        assert b"Traceback" not in done.stderr


@pytest.mark.rotating
def test_a_wrong_choice_is_told_with_the_right_ones(tmp_path: Path) -> None:
    done = run_command("detect", "some.tlog", "--end", "moon", cwd=tmp_path)
    assert b"Invalid value for '--end': 'moon' is not one of 'gcs', 'companion'." in done.stderr


@pytest.mark.parametrize(
    "command", ["run", pytest.param("pair", marks=pytest.mark.slow), pytest.param("live", marks=pytest.mark.slow)]
)
@pytest.mark.rotating
def test_a_folder_whose_name_is_no_utf_8_is_refused_before_anything_flies(command: str, tmp_path: Path) -> None:
    done = run_command(command, "rid-spoofing", "--out", "bad\udcff", cwd=tmp_path)
    assert done.returncode == 2
    assert b"bad\\xff" in done.stderr
    assert b"a name in UTF-8" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_unforeseen_error_is_one_line_unless_asked_for_more(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import skyrange.cli.app as a; a.app = lambda **_: 1 // 0; from skyrange.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert done.stderr.startswith("skyrange: ZeroDivisionError: ")
    assert done.stderr.count("\n") == 1
    monkeypatch.setenv("SKYRANGE_TRACEBACK", "1")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" in done.stderr


@pytest.mark.parametrize("megabytes", [60, 200, 400])
def test_too_little_memory_is_said_so(megabytes: int, tmp_path: Path) -> None:
    limit = f"ulimit -v {megabytes * 1024}; exec python3 -c 'pass'"
    if subprocess.run(["bash", "-c", limit], capture_output=True, check=False).returncode:
        pytest.skip("Python itself does not start")
    script = f'ulimit -v {megabytes * 1024}; exec "$@"'
    arguments = ["bash", "-c", script, "bash", *MAIN, "run", "squares", "--set", "duration_s=1"]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode != 0
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
def test_each_signal_that_ends_a_session_is_a_request_to_end(number: signal.Signals) -> None:
    outer = signal.signal(number, signal.SIG_DFL)  # under nohup, SIGHUP is ignored
    try:
        with Interruptible() as interrupt:
            os.kill(os.getpid(), number)
            assert interrupt.requested
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, outer)


def test_an_ignored_hang_up_stays_ignored() -> None:
    assert threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interruptible() as interrupt:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not interrupt.requested
    finally:
        signal.signal(signal.SIGHUP, before)
