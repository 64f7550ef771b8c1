"""What a release has: archives with all files, one version and address, valid workflows, fragments of changes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from check_jsonschema.builtin_schemas import get_builtin_schema
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import skyrange
from tests.tiers import needs
from tools.check_distributions import (
    check_distributions,
    compare_files,
    files_of_sdist,
    files_of_wheel,
    find_relative_links,
    list_files,
)
from tools.try_distribution import find_differences, read_version

ROOT = Path(__file__).parents[2]
GITHUB = ROOT / ".github"
WORKFLOWS = sorted((GITHUB / "workflows").glob("*.yml"))
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
ADDRESS = PROJECT["project"]["urls"]["Source"]
SCHEMAS = {
    "citation-file-format": ["CITATION.cff"],
    "github-workflows": [f".github/workflows/{one.name}" for one in WORKFLOWS],
    "github-issue-forms": [".github/ISSUE_TEMPLATE/fault.yml", ".github/ISSUE_TEMPLATE/proposal.yml"],
    "github-issue-config": [".github/ISSUE_TEMPLATE/config.yml"],
    "dependabot": [".github/dependabot.yml"],
}


class WithoutDates(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """YAML as JSON: a date is a string, and `on` is no truth value."""


WithoutDates.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if tag not in ("tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:bool")]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
WithoutDates.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("true|false"), list("tf"))


def read_yaml(path: Path) -> Any:
    return yaml.load(path.read_text(encoding="utf-8"), WithoutDates)


def steps_of(workflow: Path) -> list[dict[str, Any]]:
    return [step for job in read_yaml(workflow)["jobs"].values() for step in job["steps"]]


# ---------------------------------------------------------------- archives


@cache
def page() -> str:
    """The README as the archives have it."""
    return str(WheelBuilder(str(ROOT)).metadata.core.readme)


@needs("git")
def test_the_archives_have_all_tracked_files_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    tracked = list_files("--others", "--exclude-standard")
    sdist = {one.distribution_path for one in SdistBuilder(str(ROOT)).recurse_included_files()} | {"PKG-INFO"}
    assert [*compare_files("sdist", sdist, files_of_sdist(tracked))] == []
    wheel = {one.distribution_path for one in WheelBuilder(str(ROOT)).recurse_included_files()}
    assert [*compare_files("wheel", wheel, files_of_wheel(tracked))] == []
    assert {"skyrange/py.typed", "skyrange/_engines/ns3/LICENSE"} <= wheel
    assert not [path for path in wheel if path.startswith(("tests/", "tools/", "docs/"))]


def test_what_is_wrong_with_archives_is_named(tmp_path: Path) -> None:
    assert [*compare_files("sdist", {"a", "b"}, {"b", "c"})] == [
        "sdist: has a, which git does not track; build from a clean checkout",
        "sdist: lacks c",
    ]
    (tmp_path / "skyrange-0.1.0.tar.gz").touch()
    (found,) = check_distributions(tmp_path, [], None)
    assert found.endswith("has skyrange-0.1.0.tar.gz instead of one wheel and one sdist of one version")


def test_the_page_of_the_index_has_absolute_links_to_this_version() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert find_relative_links("[a](b.md) ![c](https://d/e.png) [f](#g)") == ["b.md"]
    assert len(find_relative_links(readme)) > 20
    assert find_relative_links(page()) == []
    targets = re.findall(rf"\]\({re.escape(ADDRESS)}/(blob|raw)/v([^/)]+)/([^)#]+)", page())
    assert len(targets) == len(find_relative_links(readme))
    for kind, said, path in targets:
        assert said == skyrange.__version__
        assert (ROOT / path).exists(), path
        assert (kind == "raw") == path.endswith((".png", ".svg"))


def test_what_is_true_before_the_first_upload_is_in_no_archive() -> None:
    assert "is not on the package index" not in page()


def test_the_metadata_are_whole() -> None:
    core = WheelBuilder(str(ROOT)).metadata.core
    assert core.authors_data["name"] == ["The skyrange developers"]
    assert core.license_expression == "Apache-2.0 AND MIT"
    assert not [one for one in core.classifiers if one.startswith("License ::")]
    assert set(core.urls.values()) == {one for one in core.urls.values() if one.startswith(ADDRESS)}


# ---------------------------------------------------------------- one version, one address


def test_there_is_one_version() -> None:
    said = {
        "metadata": version("skyrange"),
        "build": WheelBuilder(str(ROOT)).metadata.version,
        "CITATION.cff": read_yaml(ROOT / "CITATION.cff")["version"],
        "CHANGELOG.md": re.findall(r"^## \[([^\]]+)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)[0],
    }
    assert find_differences(skyrange.__version__, said) == []


def test_archives_are_known_by_their_names() -> None:
    assert read_version("skyrange-0.1.0-py3-none-any.whl") == read_version("skyrange-0.1.0.tar.gz") == "0.1.0"
    with pytest.raises(SystemExit, match="no wheel and no sdist"):
        read_version("other-0.1.0.tar.gz")
    assert find_differences("1", {"a": "1", "b": "2"}) == ["b says 2, not 1"]


def test_there_is_one_address() -> None:
    """RELEASE.md says how to change it everywhere."""
    pages = [*ROOT.glob("*.*"), *GITHUB.rglob("*.yml"), *(ROOT / "changes").glob("*.md")]
    texts = {one: one.read_text(encoding="utf-8") for one in pages if one.is_file()}
    address = ADDRESS.removeprefix("https://")
    found = {name for text in texts.values() for name in re.findall(r"github\.com/[\w-]+/skyrange\b", text)}
    assert found == {address}
    assert read_yaml(ROOT / "CITATION.cff")["repository-code"] == ADDRESS
    assert ADDRESS in texts[GITHUB / "ISSUE_TEMPLATE" / "config.yml"]


# ---------------------------------------------------------------- workflows and forms


@pytest.mark.parametrize("schema", SCHEMAS)
def test_files_keep_their_schemas(schema: str) -> None:
    check = jsonschema.validators.validator_for(rules := get_builtin_schema(f"vendor.{schema}"))(rules)
    for name in SCHEMAS[schema]:
        content = json.loads(json.dumps(read_yaml(ROOT / name)))
        assert [error.message for error in check.iter_errors(content)] == [], name


def test_all_files_of_the_forge_have_a_schema() -> None:
    checked = {name for names in SCHEMAS.values() for name in names}
    assert {str(one.relative_to(ROOT)) for one in GITHUB.rglob("*.yml")} <= checked


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_make_targets_and_nothing_else(workflow: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):.*## ", MAKEFILE, re.MULTILINE))
    commands = [step["run"] for step in steps_of(workflow) if "run" in step]
    assert commands
    for command in commands:
        make, *made = command.split()
        assert make == "make"
        assert set(made) <= targets, command


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_have_pinned_actions_and_no_more_rights_than_they_use(workflow: Path) -> None:
    lines = re.findall(r"uses: (.*)", workflow.read_text(encoding="utf-8"))
    assert lines
    for line in lines:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line), line
    content = read_yaml(workflow)
    assert content["permissions"] == {}
    rights = {name: job["permissions"] for name, job in content["jobs"].items()}
    publish = rights.pop("publish", {"id-token": "write"})
    assert publish == {"id-token": "write"}
    assert all(one == {"contents": "read"} for one in rights.values())


# ---------------------------------------------------------------- changes


def test_fragments_become_an_entry() -> None:
    types = {one["directory"] for one in PROJECT["tool"]["towncrier"]["type"]}
    for fragment in (ROOT / "changes").iterdir():
        match = re.fullmatch(r"(\d+|\+[\w-]+)\.([a-z]+)\.md", fragment.name)
        assert fragment.name == "README.md" or (match is not None and match[2] in types), fragment.name
    command = [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "9.9.9", "--date", "2000-01-01"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "## [9.9.9] - 2000-01-01" in done.stdout
    assert PROJECT["tool"]["towncrier"]["start_string"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
