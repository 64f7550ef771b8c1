"""A browser for all tests of this folder, and the reports that several of them open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from skyrange.report import write_report
from skyrange.scenario.shipped import load
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair
from tests.browser import chromium
from tests.unit.study_sample import squares

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Playwright


@pytest.fixture(scope="module")
def driver() -> Iterator[Playwright]:
    """Playwright; tests are skipped with the reason where it or Chromium is missing.

    Of a module, not of a session: while it is there, `asyncio.run` of other tests would find a running loop.
    """
    if reason := chromium.missing():
        pytest.skip(reason)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as found:
        yield found


@pytest.fixture(scope="module")
def browser(driver: Playwright) -> Iterator[Browser]:
    """Chromium with WebGL in software."""
    with chromium.launched(driver) as found:
        yield found


@pytest.fixture(scope="session")
def run_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of five aircraft between six buildings, a link of one of which is attacked."""
    folder = tmp_path_factory.mktemp("run")
    return write_report(squares(folder, hostile=True), folder / "report.html")


@pytest.fixture(scope="session")
def spoofed(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """A pair with a forged Remote ID: three arms, two seeds, receptions."""
    folder = tmp_path_factory.mktemp("spoofed") / "pair"
    return pair("rid-spoofing", folder, seeds=2, changes=["duration_s=75"])


@pytest.fixture(scope="session")
def drifted(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """A pair with false GNSS: belief beside truth, innovations."""
    return pair(load("gnss-drift"), tmp_path_factory.mktemp("drifted") / "pair")
