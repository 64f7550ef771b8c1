"""What the sdist and the wheel in `dist` have to contain: the tracked files, one version, and absolute links.

`python -m tools.check_distributions` prints what is wrong, and exits with 1 if something is. With `--tag v0.1.0` it
also compares the version with that of a tag.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from email.parser import Parser
from pathlib import Path

DIST = Path("dist")
MAX_SDIST_MB, MAX_WHEEL_MB = 10, 5


def files_of_sdist(tracked: Iterable[str]) -> set[str]:
    """The files that an sdist has: all tracked ones, and the metadata."""
    return {*tracked, "PKG-INFO"}


def files_of_wheel(tracked: Iterable[str]) -> set[str]:
    """The files that a wheel has beside its metadata: the package, and the sources of the engines in it."""
    found = set()
    for path in tracked:
        if path.startswith("src/"):
            found.add(path.removeprefix("src/"))
        elif path.startswith("engines/"):
            found.add(f"skyrange/_{path}")
    return found


def find_relative_links(markdown: str) -> list[str]:
    """The targets of links and pictures that lead nowhere on a page of the package index."""
    return re.findall(r"\]\(((?!https?://|#)[^)]*)\)", markdown)


def compare_files(what: str, found: set[str], expected: set[str]) -> Iterator[str]:
    """What an archive has too much or lacks."""
    for path in sorted(found - expected):
        yield f"{what}: has {path}, which git does not track; build from a clean checkout"
    for path in sorted(expected - found):
        yield f"{what}: lacks {path}"


def check_distributions(folder: Path, tracked: Sequence[str], tag: str | None) -> Iterator[str]:
    """What is wrong with the archives in `folder`."""
    archives = sorted(one.name for one in folder.iterdir())
    match = re.fullmatch(r"skyrange-(\S+)-py3-none-any\.whl skyrange-(\S+)\.tar\.gz", " ".join(archives))
    if match is None or match[1] != match[2]:
        yield f"{folder}: has {', '.join(archives) or 'nothing'} instead of one wheel and one sdist of one version"
        return
    version = match[1]
    if tag is not None and tag != f"v{version}":
        yield f"the tag is {tag}, but the version is {version}"
    sdist, wheel = folder / f"skyrange-{version}.tar.gz", folder / f"skyrange-{version}-py3-none-any.whl"
    with tarfile.open(sdist) as tar:
        members = {one.name.removeprefix(f"skyrange-{version}/") for one in tar.getmembers() if not one.isdir()}
    yield from compare_files(sdist.name, members, files_of_sdist(tracked))
    with zipfile.ZipFile(wheel) as zipped:
        names = {name for name in zipped.namelist() if not name.startswith(f"skyrange-{version}.dist-info/")}
        metadata = Parser().parsestr(zipped.read(f"skyrange-{version}.dist-info/METADATA").decode())
    yield from compare_files(wheel.name, names, files_of_wheel(tracked))
    if metadata["Version"] != version:
        yield f"{wheel.name}: its metadata have the version {metadata['Version']}"
    for link in find_relative_links(str(metadata.get_payload())):
        yield f"{wheel.name}: the page of the package index has the relative link {link}"
    for archive, most_mb in ((sdist, MAX_SDIST_MB), (wheel, MAX_WHEEL_MB)):
        if archive.stat().st_size > most_mb * 1e6:
            yield f"{archive.name}: has {archive.stat().st_size / 1e6:.1f} MB, more than {most_mb}"


def list_files(*options: str) -> list[str]:
    """The files of the checkout: those that git tracks, and by `options` others."""
    command = ["git", "ls-files", "-z", "--cached", *options]
    listed = subprocess.run(command, capture_output=True, check=True, text=True).stdout.split("\0")[:-1]
    return [path for path in listed if Path(path).is_file()]  # git lists a file that was removed until the next commit


def main() -> int:
    """Check the archives in `dist`; an exit code."""
    parser = argparse.ArgumentParser(description="Check the sdist and the wheel in dist.")
    parser.add_argument("--tag", help="the tag of the release, such as v0.1.0")
    wrong = [*check_distributions(DIST, list_files(), parser.parse_args().tag)]
    print("\n".join(wrong) or "distributions: all tracked files, no others; one version; absolute links")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
