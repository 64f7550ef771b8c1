"""Figures as PDF: one page of the figure's size, in which text stays text in an embedded font."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.figures.svg import save_pdf
from skyrange.statistics.means import Interval
from skyrange.study.page import draw_curves
from skyrange.study.summary import Curve, Level

LEVELS = [Level("1", 1.0, ("a",)), Level("2", 2.0, ("b",))]
CURVE = Curve("attacked", 0, ((1.0, Interval(5, 3.0, 2.0, 4.0, "t")), (2.0, Interval(5, 6.0, 5.0, 7.0, "t"))))
FIGURE = draw_curves("departure by onset", "onset", "departure (m)", LEVELS, [CURVE], numeric=True)


def read_objects(path: Path) -> str:
    """A PDF's text with all of its streams unpacked."""
    data = path.read_bytes()
    streams = [zlib.decompress(found) for found in re.findall(rb"stream\r?\n(\x78.*?)\r?\nendstream", data, re.DOTALL)]
    return b"\n".join([data, *streams]).decode("latin-1")


def shown_texts(objects: str) -> set[str]:
    """The strings that a page shows, without the kerning inside them."""
    found = set()
    for array in re.findall(r"\[([^\]]*)\]TJ|(\([^\n]*\))Tj", objects):
        parts = re.findall(r"\(((?:\\.|[^\\)])*)\)", "".join(array))
        found.add(re.sub(r"\\(.)", r"\1", "".join(parts)))
    return found


def test_a_pdf_has_one_page_of_the_figures_size_and_text_that_can_be_copied(tmp_path: Path) -> None:
    try:
        import cairosvg  # noqa: F401
    except (ImportError, OSError):
        pytest.skip("CairoSVG is not installed")
    objects = read_objects(save_pdf(FIGURE, tmp_path / "figure.pdf"))
    assert len(re.findall(r"/Type\s*/Page\b", objects)) == 1
    assert re.findall(r"/MediaBox\s*\[\s*0 0 480 240\s*\]", objects)  # 640 x 320 px
    assert "/FontFile" in objects
    texts = shown_texts(objects)
    assert {"onset", "attacked"} <= texts
    assert any(text.startswith("departure") for text in texts)


@pytest.mark.parametrize("error", [ImportError("no cairosvg"), OSError("no library called cairo")])
def test_what_is_missing_is_named(error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find(name: str, *_: object) -> object:
        raise error

    monkeypatch.setattr("skyrange.figures.svg.import_module", find)
    with pytest.raises(InputError, match=r"(?s)no .*skyrange\[study\]"):
        save_pdf(FIGURE, tmp_path / "figure.pdf")
    assert list(tmp_path.iterdir()) == []
