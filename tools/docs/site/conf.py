"""Settings of the documentation site, as Sphinx reads them: pages, navigation, API reference and theme.

The pages are plain Markdown. Before Sphinx reads a page, `_prepare` adds its navigation, turns the blocks `api` into
entries of the API reference and a notebook into Markdown, and puts the report of a pair on the page of its scenario.
"""

from __future__ import annotations

import sys
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "src")]

import skyrange  # noqa: E402
from tools.docs import api_reference, navigation, notebooks  # noqa: E402
from tools.docs.build_site import SHOWN  # noqa: E402

project = "skyrange"
version = release = skyrange.__version__
html_title = project
author = "the authors of skyrange"
root_doc = "docs/README"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
_SOURCES = {
    "docs",
    "changes",
    *(f"{name}.md" for name in ("CHANGELOG", "CODE_OF_CONDUCT", "CONTRIBUTING", "RELEASE", "SECURITY")),
}
exclude_patterns = [*sorted({path.name for path in ROOT.iterdir()} - _SOURCES), "changes/[!R]*"]
nitpicky = True
suppress_warnings = ["myst.header"]  # a generated part begins with headings of the third level

myst_heading_anchors = 6
python_maximum_signature_line_length = 90
add_module_names = False
smartquotes = False
toc_object_entries = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"

html_theme = "furo"
html_theme_options: dict[str, Any] = {"top_of_page_buttons": []}
html_copy_source = False
html_show_copyright = False
html_permalinks_icon = "#"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
templates_path = ["templates"]
html_additional_pages = {"index": "front.html"}
html_favicon = "static/icon.svg"

_SECTIONS = navigation.read_sections()
_FRAME = """
<iframe class="report" src="{up}reports/{name}.html" title="The report of {name}" loading="lazy"></iframe>
<p><a href="{up}reports/{name}.html">The report alone</a></p>
"""


def _toctree(pages: list[Path] | tuple[Path, ...], caption: str = "") -> str:
    names = "\n".join(f"/{page.relative_to(ROOT).with_suffix('')}" for page in pages)
    options = ":hidden:\n" + (f":caption: {caption}\n" if caption else "")
    return f"\n```{{toctree}}\n{options}\n{names}\n```\n"


def _prepare(app: Any, docname: str, content: list[str]) -> None:
    path = Path(app.env.doc2path(docname))
    text = notebooks.to_markdown(content[0]) if path.suffix == ".ipynb" else content[0]
    text = api_reference.expand_blocks(text)
    if path.stem in SHOWN and path.parent.name == "scenarios":
        head, heading, rest = text.partition("\n## ")
        frame = _FRAME.format(name=path.stem, up="../" * docname.count("/"))
        text = f"{head}\n{frame}{heading}{rest}"
    if path == navigation.INDEX:
        text += "".join(_toctree(pages, title) for title, pages in _SECTIONS)
    elif children := navigation.children_of(path):
        text += _toctree(children)
    content[0] = text


def _navigation(app: Any, docname: str, context: dict[str, Any]) -> str:
    """The side bar: the pages of the index, and those below the page that is open."""
    here = Path(app.env.doc2path(docname)) if docname in app.env.titles else ROOT

    def item(page: Path, level: int) -> str:
        name = str(page.relative_to(ROOT).with_suffix(""))
        below = navigation.children_of(page)
        is_open = page == here or here in below or any(here in navigation.children_of(child) for child in below)
        children = "".join(item(child, level + 1) for child in below) if is_open else ""
        marks = "".join((" current" * is_open, " current-page" * (page == here), " has-children" * bool(children)))
        link = f'<a class="reference internal" href="{context["pathto"](name)}">{_title(app, name)}</a>'
        return f'<li class="toctree-l{level}{marks}">{link}{f"<ul>{children}</ul>" if children else ""}</li>'

    return "".join(
        f'<p class="caption" role="heading"><span class="caption-text">{section.title}</span></p>'
        f"<ul>{''.join(item(page, 1) for page in section.pages)}</ul>"
        for section in _SECTIONS
    )


@cache
def _title(app: Any, docname: str) -> str:
    return escape(app.env.titles[docname].astext())


def _leave_out_tree(app: Any, docname: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Have the theme make no tree of all pages, which would be made anew for each page."""
    context["toctree"] = lambda **_: ""


def _set_navigation(app: Any, docname: str, template: str, context: dict[str, Any], tree: Any) -> None:
    context["furo_navigation_tree"] = _navigation(app, docname, context)


def setup(app: Any) -> None:
    """Connect what prepares pages and the API reference."""
    from pygments.lexers.special import TextLexer

    app.add_lexer("mermaid", TextLexer)  # shown as text
    app.connect("source-read", _prepare)
    app.connect("html-page-context", _leave_out_tree, priority=400)  # the theme has 500
    app.connect("html-page-context", _set_navigation, priority=600)
    api_reference.connect(app)
