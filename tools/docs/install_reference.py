"""Tables of the installation: the extras, and what the base install costs."""

from __future__ import annotations

import tomllib

from tools.docs.markdown_tables import table
from tools.measure_install import ROOT, read_results

_STARTS = {
    "python": "Python alone",
    "import": "`import skyrange`",
    "help": "`skyrange --help`",
    "run": "loading what `skyrange run squares` uses",
}
_LARGE = 10_000_000


def extras() -> str:
    """Every extra: what it is for, what it adds to the base install, and what ends with an error without it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    sizes = read_results()["extras"]
    return table(
        ("extra", "for", "size", "needed by"),
        (
            (f"`{name}`", purpose, _megabytes(sum(sizes[name].values())) if name in sizes else "not measured", needed)
            for name, (purpose, needed) in project["tool"]["skyrange"]["extras"].items()
        ),
    )


def install_sizes() -> str:
    """The base install of each revision measured: packages and size, and the largest packages."""
    revisions = read_results()["revisions"]
    packages = [one["packages"] for one in revisions]
    times = [one["cpu_s"] for one in revisions]
    newest = packages[-1]
    large = sorted((name for name in newest if newest[name] >= _LARGE), key=lambda name: -newest[name])
    rows = [
        ("packages", *(str(len(one)) for one in packages)),
        ("size", *(_megabytes(sum(one.values())) for one in packages)),
        *((f"of it `{name}`", *(_megabytes(one.get(name, 0)) for one in packages)) for name in large),
        *((f"CPU time: {words}", *(f"{one[key]:.2f} s" for one in times)) for key, words in _STARTS.items()),
    ]
    return table(("", *(f"`{one['revision']}`" for one in revisions)), rows)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.0f} MB" if size >= 1e6 else f"{size / 1e6:.1f} MB"
