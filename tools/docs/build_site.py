"""Build the documentation site in `build/site`: flights that it shows, pages, and a check of its links.

`make docs` installs what this needs, and runs it.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build"
SITE = BUILD / "site"
FLIGHTS = BUILD / "site-flights"
SHOWN = ("rid-spoofing", "chain")
"""Scenarios whose pairs are flown: their pages show the reports, and the front page shows the first."""

_SCENE_STYLE = """
.sky-head, .sky-panel, .sky-tools, .sky-timeline, .sky-hint { display: none !important }
.sky-page { height: 100vh; min-height: 0; overflow: hidden }
.sky-page .sky-viewer { display: flex; flex-direction: column; height: 100vh; min-height: 0; gap: 6px; padding: 0 }
.sky-page .sky-viewer .sky-main { display: block; flex: 1; height: auto; min-height: 0 }
.sky-page .sky-viewer .sky-view { height: 100%; min-height: 0 }
@media (max-width: 600px) { .sky-twins { display: none !important } }
"""
"""The front page has the flights and the player alone."""

_SCENE_SCRIPT = """
const calm = matchMedia("(prefers-reduced-motion: reduce)"), { store } = window.skyrangeViewer;
let opened = false;
store.subscribe(() => {
  if (opened || !store.scene) return;
  opened = true;
  store.show({ time: %.2f, speed: 1, playing: !calm.matches });
});
"""

_SCENE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The flights of {name}</title>
<style>{style}</style>
</head>
<body class="sky-page">
<main id="viewer"></main>
<script type="application/octet-stream" id="viewer-stream">{stream}</script>
<script>{script}</script>
</body>
</html>
"""


def fly(name: str) -> Path:
    """The folder of a pair, which is flown again where the sources are newer than its report."""
    folder = FLIGHTS / name
    report = folder / "report.html"
    sources = (path for path in (ROOT / "src").rglob("*") if path.suffix not in ("", ".pyc", ".nbc", ".nbi"))
    newest = max(path.stat().st_mtime for path in sources)
    if not report.exists() or report.stat().st_mtime < newest:
        shutil.rmtree(folder, ignore_errors=True)
        _call("skyrange", "pair", name, "--out", str(folder))
    return folder


def write_scene(folder: Path, page: Path) -> None:
    """Write a page with the viewer of a pair alone; it plays from shortly before an aircraft departs from its twin."""
    from skyrange.analysis import load_pair
    from skyrange.view.folders import read_pair_arms
    from skyrange.view.inline import encode_text, viewer_script, viewer_style
    from skyrange.view.opening import find_opening_s

    pair = load_pair(folder)
    seed = pair.seeds[0]
    opening_s = find_opening_s([pair.run("attacked", seed), pair.run(pair.twin, seed)]) or 0.0
    text = _SCENE.format(
        name=folder.name,
        style=viewer_style() + _SCENE_STYLE,
        script=viewer_script() + _SCENE_SCRIPT % opening_s,
        stream=encode_text(read_pair_arms(pair, seed).encode()),
    )
    page.write_text(text, encoding="utf-8")


class _Page(HTMLParser):
    """Collects the identifiers of a page and the addresses that it names."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.add(value)
            elif name in ("href", "src", "poster") and value:
                self.links.add(value)
                if tag not in ("a", "form"):
                    self.loaded.add(value)


def find_broken_links(site: Path) -> list[str]:
    """Links of built pages to a file or an anchor that is not there, and what is loaded from elsewhere."""
    pages = {}
    for path in sorted(site.rglob("*.html")):
        parser = _Page()
        parser.feed(path.read_text(encoding="utf-8"))
        pages[path] = parser
    wrong = []
    for path, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loaded and parts.scheme != "data":
                    wrong.append(f"{path.relative_to(site)}: loads {link}")
                continue
            there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchor = unquote(parts.fragment)
            known = there.exists() and (not anchor or there not in pages or anchor in pages[there].ids or "=" in anchor)
            if not known:
                wrong.append(f"{path.relative_to(site)}: {link}")
    return wrong


def _call(*command: str) -> None:
    subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=True)


def main() -> int:
    """Build all of it; 1 if a link is broken."""
    pairs = {name: fly(name) for name in SHOWN}
    settings = ("-c", "tools/docs/site", "-d", str(BUILD / "site-cache"))
    _call("sphinx", "--fresh-env", "--fail-on-warning", "--keep-going", "--quiet", *settings, ".", str(SITE))
    reports = SITE / "reports"
    reports.mkdir(exist_ok=True)
    for name, folder in pairs.items():
        shutil.copy(folder / "report.html", reports / f"{name}.html")
    write_scene(pairs[SHOWN[0]], reports / "scene.html")
    wrong = find_broken_links(SITE)
    print("\n".join([*wrong, f"{len(wrong)} broken links"] if wrong else [f"the site is {SITE / 'index.html'}"]))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
