"""The report of a matrix in a real browser: it fits, its cells lead to their words and flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from skyrange.study.matrix.page import write_matrix_report
from tests.browser.axe import find_violations, missing_axe
from tests.browser.chromium import missing, visit
from tests.unit.matrix_sample import make_matrix

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.external(missing=missing())


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_shipped_matrix_fits_and_its_cells_lead_to_their_flights(
    browser: Browser, tmp_path: Path, scheme: str
) -> None:
    for width in (1440, 1280):
        opened = visit(
            browser,
            write_matrix_report(make_matrix(tmp_path)),
            viewport={"width": width, "height": 800},
            color_scheme=scheme,
        )
        page = opened.page
        assert (
            page.evaluate(
                """[document.documentElement, ...document.querySelectorAll(".scroll, .heat")]
              .filter((box) => box.scrollWidth > box.clientWidth + 1).length"""
            )
            == 0
        ), "nothing scrolls sideways"
        assert page.evaluate("document.querySelector('.heat').getBoundingClientRect().right <= innerWidth")
        cut = page.evaluate(
            "[...document.querySelectorAll('.heat td a')].filter((one) => one.scrollWidth > one.clientWidth + 1).length"
        )
        assert cut == 0, "no text of a cell is cut"
        cell = page.locator(".heat td a").nth(17)
        detail = page.locator(f"[id='{(cell.get_attribute('href') or '')[1:]}']")
        assert not detail.is_visible()
        cell.focus()
        page.keyboard.press("Enter")
        detail.wait_for()
        assert detail.locator("a, code").count() == 1
        assert opened.messages == []
        opened.close()


@pytest.mark.skipif(missing_axe() != "", reason=missing_axe())
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_breaks_no_rule_of_wcag(browser: Browser, tmp_path: Path, scheme: str) -> None:
    opened = visit(browser, write_matrix_report(make_matrix(tmp_path)), color_scheme=scheme, bypass_csp=True)
    opened.page.locator("summary").nth(2).click()
    assert find_violations(opened) == []
    opened.close()
