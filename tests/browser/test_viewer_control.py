"""A person who starts an attack, pauses the run and changes its speed in the page of `skyrange run --control`."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

from skyrange.metrics.exact_difference import diff
from skyrange.record import load
from skyrange.scenario.toml_files import load_file
from skyrange.study.runs import fly
from tests.browser.axe import find_violations, missing_axe
from tests.browser.chromium import missing, visit

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.external(missing=missing() or missing_axe())

SKYRANGE: Final = (sys.executable, "-c", "from skyrange.cli import main; main()")
CHANGES: Final = ("duration_s=150", "attacks.*.manual=true", "attacks.*.start_s=0")
WAIT_S = 60.0


@contextmanager
def flying(folder: Path, *how: str, changes: Sequence[str] = CHANGES) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The command, with the address that it prints; it is ended if the test does not."""
    command = [
        *SKYRANGE,
        *(how or ("run", "--speed", "2")),
        "rid-spoofing",
        "--view",
        "--control",
        "--out",
        str(folder),
    ]
    for change in changes:
        command += ["--set", change]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "BROWSER": "true"}) as child:
        try:
            assert child.stderr is not None
            for line in child.stderr:
                if (found := re.search(r"http://\S+#token=\S+", line)) is not None:
                    yield found[0], child
                    return
            raise AssertionError("no address was printed")
        finally:
            child.kill()


def clock_s(page: Page) -> float:
    """The time that the run has reached, as the page has it."""
    minutes, _, seconds = page.get_by_label("Time that the run has reached").inner_text().partition(":")
    return 60.0 * float(minutes) + float(seconds)


def await_clock(page: Page, time_s: float) -> None:
    for _ in range(int(WAIT_S * 10)):
        if clock_s(page) >= time_s:
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"the run has not reached {time_s} s")


def test_a_person_plays_and_the_schedule_is_the_same_run(browser: Browser, tmp_path: Path) -> None:
    with flying(tmp_path / "hand") as (url, child):
        opened = visit(browser, url)
        page = opened.page
        page.get_by_role("button", name="Start attack ghost").wait_for()
        assert "token" not in page.url
        await_clock(page, 5.0)

        page.get_by_role("button", name="Pause the run").click()
        page.get_by_role("button", name="Resume the run").wait_for()
        page.wait_for_timeout(600)  # what the page knew of the clock before may be old
        stood_s = clock_s(page)
        page.wait_for_timeout(1500)
        assert clock_s(page) == stood_s
        shown_s = float(page.get_by_role("slider", name="Time", exact=True).get_attribute("max") or 0.0)
        assert abs(shown_s - stood_s) <= 0.2 + 1e-6  # all that has happened is shown

        page.get_by_role("button", name="Start attack ghost").press("Enter")
        page.get_by_text(re.compile(r"ghost starts at 0:\d\d\.\d\d")).wait_for()
        page.get_by_label("Speed of the run").select_option("5")
        page.get_by_role("button", name="Resume the run").click()
        page.get_by_text(re.compile(r"attack, acts since 0:\d\d")).wait_for()
        await_clock(page, stood_s + 15.0)
        page.locator(".sky-timeline").get_by_text("ghost").wait_for()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.wait_for_timeout(400)
            assert find_violations(opened) == []
        page.get_by_role("button", name="Stop attack ghost").click()
        page.get_by_text(re.compile("attack, has ended at")).wait_for()
        page.get_by_label("Speed of the run").select_option("0")
        page.get_by_role("button", name="The run has ended").wait_for()
        assert page.get_by_role("button", name="Stop attack ghost").is_disabled()
        page.wait_for_timeout(500)
        assert opened.messages == []
        assert not [address for address in opened.requests if "token" in address]
        opened.close()
        child.send_signal(signal.SIGINT)
        child.wait(WAIT_S)
    record = load(tmp_path / "hand")
    rows = record.manifest["manual_acts"]
    assert [(row["act"], row["action"], row["by"]) for row in rows] == [
        ("ghost", "start", "viewer"),
        ("ghost", "stop", "viewer"),
    ]
    assert abs(rows[0]["at_s"] - stood_s) <= 0.2  # the page shows tenths
    assert record.rows("labels") > 0
    again = fly(load_file(record.path / "scenario.toml"), tmp_path / "again", report=False)
    assert again.manifest["digests"]["fingerprint"] == record.manifest["digests"]["fingerprint"]
    assert diff(record, again).same


def test_without_the_token_the_page_only_shows(browser: Browser, tmp_path: Path) -> None:
    with flying(tmp_path / "run") as (url, _):
        opened = visit(browser, url.partition("#")[0])
        page = opened.page
        page.get_by_text("open the address that skyrange printed").wait_for()
        page.get_by_text("aircraft · flying").wait_for()
        assert page.get_by_role("button", name="Pause the run").is_disabled()
        assert page.get_by_role("button", name="Start attack ghost").count() == 0
        assert find_violations(opened) == []
        status = page.evaluate(
            "fetch('control', {method: 'POST', body: '{\"do\": \"pause\"}'}).then((one) => one.status)"
        )
        assert status == 401
        opened.close()


@pytest.mark.realtime
def test_a_person_plays_in_a_live_range(browser: Browser, tmp_path: Path) -> None:
    changes = (*CHANGES, "duration_s=30")
    with flying(tmp_path / "live", "live", "--group", "operator", changes=changes) as (url, child):
        opened = visit(browser, url)
        page = opened.page
        page.get_by_role("button", name="Start attack ghost").click()
        page.get_by_text(re.compile(r"attack, acts since 0:\d\d")).wait_for()
        assert page.get_by_role("button", name="Pause the run").count() == 0
        assert page.get_by_label("Speed of the run").is_hidden()
        page.wait_for_timeout(3000)
        page.get_by_role("button", name="Stop attack ghost").click()
        page.get_by_text(re.compile("attack, has ended at")).wait_for()
        page.get_by_text("aircraft · flying").wait_for(state="detached")
        assert page.get_by_role("button", name="Stop attack ghost").is_disabled()
        assert opened.messages == []
        opened.close()
        child.send_signal(signal.SIGINT)
        child.wait(WAIT_S)
    record = load(tmp_path / "live")
    rows = record.manifest["manual_acts"]
    assert [(row["action"], row["by"], row["effective"]) for row in rows] == [
        ("start", "viewer", True),
        ("stop", "viewer", True),
    ]
    times = [row["at_ns"] * 1e-9 for row in record.table("labels").to_pylist() if row["attack"] == "ghost"]
    assert rows[0]["at_s"] <= min(times)
    assert max(times) <= rows[1]["at_s"]
