"""Which OMNeT++ and INET does `skyrange install omnetpp` take, and what does it say of those that it does not?"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from skyrange.core.engine_sources import source_files
from skyrange.core.errors import InputError
from skyrange.install import omnetpp as installing
from skyrange.install.omnetpp import FEATURES, LIBRARIES, find_installation, install
from skyrange.radio.external.omnetpp import VARIABLE, find_command

DEFINES = "#define INET_VERSION        0x0405\n#define INET_PATCH_LEVEL    0x04\n"


def _features(**states: str) -> str:
    lines = "".join(f'    <feature id="{name}" enabled="{states.get(name, "true")}"/>\n' for name in FEATURES)
    return f"<featurestates>\n{lines}</featurestates>\n"


@pytest.fixture
def omnetpp(tmp_path: Path) -> Path:
    """The files of a built OMNeT++ that are looked at."""
    folder = tmp_path / "omnetpp-6.1"
    for name in ("include", "lib"):
        (folder / name).mkdir(parents=True)
    (folder / "Version").write_text("omnetpp-6.1\n")
    (folder / "include" / "omnetpp.h").touch()
    (folder / "Makefile.inc").touch()
    for library in LIBRARIES:
        (folder / "lib" / f"lib{library}.so").touch()
    return folder


@pytest.fixture
def inet(tmp_path: Path) -> Path:
    """The files of a built INET that are looked at."""
    folder = tmp_path / "inet4.5"
    (folder / "src" / "inet" / "common").mkdir(parents=True)
    (folder / "src" / "inet" / "common" / "INETDefs.h").write_text(DEFINES)
    (folder / "src" / "libINET.so").touch()
    (folder / ".oppfeaturestate").write_text(_features())
    return folder


def test_built_ones_are_taken_with_their_versions(omnetpp: Path, inet: Path) -> None:
    found = find_installation(omnetpp, inet)
    assert found.release == "OMNeT++ 6.1, INET 4.5.4"
    assert found.untested == []


def test_folders_are_known_from_setenv(omnetpp: Path, inet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("__omnetpp_root_dir", str(omnetpp))
    monkeypatch.setenv("INET_ROOT", str(inet))
    assert find_installation() == find_installation(omnetpp, inet)


def test_others_are_taken_and_told_of(omnetpp: Path, inet: Path) -> None:
    (omnetpp / "Version").write_text("omnetpp-6.2.0\n")
    (inet / "src" / "inet" / "common" / "INETDefs.h").write_text(DEFINES.replace("0x04\n", "0x05\n"))
    (inet / ".oppfeaturestate").unlink()  # INET without changed features: all that are on by default
    told = find_installation(omnetpp, inet).untested
    assert told == ["OMNeT++ 6.2.0 is not tested; tested: 6.1", "INET 4.5.5 is not tested; tested: 4.5.4"]


def _remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.mark.parametrize(
    ("part", "expected", "hint"),
    [
        ("", "folder in which OMNeT++ was built", ""),
        ("Version", "Version and include/omnetpp.h", "omnetpp.org/download"),
        ("include", "Version and include/omnetpp.h", "omnetpp.org/download"),
        ("Makefile.inc", "configured and built", "./configure WITH_QTENV=no"),
        ("lib/liboppcmdenv.so", "lib/liboppcmdenv.so", "make MODE=release"),
        ("lib/liboppsim.so", "lib/liboppsim.so", "make MODE=release"),
    ],
)
def test_an_omnetpp_that_is_not_whole_is_refused(
    omnetpp: Path, inet: Path, part: str, expected: str, hint: str
) -> None:
    _remove(omnetpp / part)
    with pytest.raises(InputError) as caught:
        find_installation(omnetpp, inet)
    assert str(omnetpp) in str(caught.value)
    assert expected in str(caught.value)
    assert hint in str(caught.value)


@pytest.mark.parametrize(
    ("part", "expected", "hint"),
    [
        ("", "folder in which INET was built", ""),
        ("src/inet", "src/inet/common/INETDefs.h", "inet.omnetpp.org"),
        ("src/libINET.so", "src/libINET.so", "make makefiles && make MODE=release"),
    ],
)
def test_an_inet_that_is_not_whole_is_refused(omnetpp: Path, inet: Path, part: str, expected: str, hint: str) -> None:
    _remove(inet / part)
    with pytest.raises(InputError) as caught:
        find_installation(omnetpp, inet)
    assert str(inet) in str(caught.value)
    assert expected in str(caught.value)
    assert hint in str(caught.value)


@pytest.mark.parametrize("feature", FEATURES)
def test_an_inet_without_a_feature_is_refused(omnetpp: Path, inet: Path, feature: str) -> None:
    (inet / ".oppfeaturestate").write_text(_features(**{feature: "false"}))
    with pytest.raises(InputError, match=f"opp_featuretool enable -f {feature} && make makefiles"):
        find_installation(omnetpp, inet)


def test_old_ones_are_refused(omnetpp: Path, inet: Path) -> None:
    (inet / "src" / "inet" / "common" / "INETDefs.h").write_text(DEFINES.replace("0x0405", "0x0404"))
    with pytest.raises(InputError, match=r"INET 4\.4\.4.*INET 4\.5 or newer"):
        find_installation(omnetpp, inet)
    (omnetpp / "Version").write_text("omnetpp-5.7\n")
    with pytest.raises(InputError, match=r"OMNeT\+\+ 5\.7.*OMNeT\+\+ 6\.0 or newer"):
        find_installation(omnetpp, inet)


def test_without_folders_the_options_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*installing._OMNETPP_ENVIRONMENT, *installing._INET_ENVIRONMENT):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="Add --omnetpp DIR"):
        find_installation()


def test_without_a_compiler_it_is_named(omnetpp: Path, inet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(InputError, match="sudo apt-get install g"):
        install(omnetpp, inet)


def test_an_engine_that_is_not_installed_is_named_with_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with pytest.raises(InputError, match="skyrange install omnetpp --omnetpp DIR --inet DIR"):
        find_command()
    own = tmp_path / "own"
    own.touch(mode=0o755)
    monkeypatch.setenv(VARIABLE, str(own))
    assert find_command() == [str(own)]


def test_the_sources_have_their_licence_and_all_modules_are_declared() -> None:
    sources = source_files("omnetpp")
    assert all("SPDX-License-Identifier: MIT" in file.read_text() for file in sources)
    declared = "".join(file.read_text() for file in sources if file.suffix == ".ned")
    defined = [
        line.partition("(")[2].partition(")")[0]
        for file in sources
        for line in file.read_text().splitlines()
        if line.startswith("Define_Module(")
    ]
    assert len(defined) > 10
    assert [name for name in defined if f"@class({name})" not in declared] == []
