"""Which compiled plugin does a Gazebo get, how is it compiled, and what is said if it cannot be? No real Gazebo."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from skyrange import doctor
from skyrange.core import engine_sources
from skyrange.core.errors import ComponentError, InputError
from skyrange.install import gazebo as installing
from skyrange.install.gazebo import find_headers, find_installed, install
from skyrange.vehicle.gazebo import gazebo_program, plugin_library
from skyrange.vehicle.gazebo.gazebo_program import VARIABLE as GAZEBO_VARIABLE
from skyrange.vehicle.gazebo.gazebo_program import WINDOW_VARIABLE, Flavour, Gazebo
from skyrange.vehicle.gazebo.plugin_library import LIBRARY, LOADED, VARIABLE, find_plugin, plugin_sources, try_plugin

SERVER = """#!/bin/sh
test "$1" = --version && echo "Gazebo multi-robot simulator, version {version}" && exit 255
for world; do :; done
library=$(sed -n 's/.*filename="\\([^"]*\\)".*/\\1/p' "$world")
{loads}
"""
LOADS = f"""test -f "$library" && printf '\\033[1;33m[Wrn] \\033[0m%s\\n' '{LOADED}'; sleep 300"""
PKG_CONFIG = """#!/bin/sh
echo "$PKG_CONFIG_PATH" > "$0.path"
case "$*" in
{cases}
*) echo "Package $2 was not found" >&2; exit 1;;
esac
"""
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
SOURCE = "extern int of_gazebo(); int of_plugin() { return of_gazebo(); }\n"


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of sources of the plugin, small ones, and an empty folder of the user."""
    folder = tmp_path / "engines" / "gazebo"
    folder.mkdir(parents=True)
    (folder.parent / "common").mkdir()
    (folder / "classic_plugin.cc").write_text(SOURCE)
    (folder / "sim_system.cc").write_text(SOURCE)
    (folder / "protocol.h").touch()
    monkeypatch.setattr(engine_sources, "engine_sources", lambda name: folder.parent / name)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "user data"))
    monkeypatch.setattr(gazebo_program, "_seen", {})
    for name in (VARIABLE, GAZEBO_VARIABLE, WINDOW_VARIABLE, "PKG_CONFIG", "PKG_CONFIG_PATH", "CXX"):
        monkeypatch.delenv(name, raising=False)
    return folder


Server = Callable[..., Gazebo]


@pytest.fixture
def server(sources: Path, tmp_path: Path) -> Server:
    """Makes a Gazebo 11 in a prefix of its own, the library that its plugins need, and a pkg-config that knows it."""

    def make(loads: str = LOADS, version: str = "11.1.0", headers: str = "11.1.0", flags: str = "") -> Gazebo:
        root = tmp_path / "gazebo prefix"
        (root / "bin").mkdir(parents=True, exist_ok=True)
        (root / "lib" / "pkgconfig").mkdir(parents=True, exist_ok=True)
        path = root / "bin" / "gzserver"
        path.write_text(SERVER.format(version=version, loads=loads))
        path.chmod(0o755)
        cases = f'"--modversion gazebo") echo {headers};;\n"--cflags --libs gazebo") {flags or "true"};;'
        pkg_config = root / "bin" / "pkg-config"
        pkg_config.write_text(PKG_CONFIG.format(cases=cases))
        pkg_config.chmod(0o755)
        return Gazebo(Flavour.CLASSIC, version, path, "--prefix")

    return make


def _use(monkeypatch: pytest.MonkeyPatch, gazebo: Gazebo) -> Path:
    """Use the pkg-config of `gazebo`; its prefix."""
    monkeypatch.setenv("PKG_CONFIG", str(gazebo.path.with_name("pkg-config")))
    return gazebo.path.parent.parent


def _keep(sources: Path, build: str, digest: str = "") -> Path:
    digest = digest or engine_sources.source_digest("gazebo")[:16]
    folder = engine_sources.engine_folder("gazebo") / f"{digest}-{build}-01234567"
    folder.mkdir(parents=True)
    (folder / LIBRARY).touch()
    return folder / LIBRARY


CLASSIC = Gazebo(Flavour.CLASSIC, "11.1.0", Path("gzserver"))
SIM = Gazebo(Flavour.SIM, "8.9.0", Path("gz"))


def test_each_flavour_and_major_version_has_a_plugin_of_its_own(sources: Path) -> None:
    for_classic, for_sim = _keep(sources, "classic11"), _keep(sources, "sim8")
    assert (find_plugin(CLASSIC), find_plugin(SIM)) == (for_classic, for_sim)
    with pytest.raises(InputError, match=r"compiled for another Gazebo \(classic11, sim8\).*skyrange install gazebo"):
        find_plugin(Gazebo(Flavour.SIM, "10.4.0", Path("gz")))


def test_a_plugin_that_is_missing_is_told_from_one_of_other_sources(sources: Path) -> None:
    with pytest.raises(InputError, match=r"not compiled yet.*skyrange install gazebo"):
        find_plugin(CLASSIC)
    _keep(sources, "classic11", "0" * 16)
    with pytest.raises(InputError, match="compiled from sources of another version of skyrange"):
        find_plugin(CLASSIC)
    with pytest.raises(InputError, match="not compiled yet"):
        find_plugin(SIM)


@pytest.mark.parametrize(
    ("needed", "build"),
    [
        (b"\0libgazebo_physics.so.11\0libc.so.6\0", "classic11"),
        (b"\0libgz-sim8.so.8\0", "sim8"),
        (b"\0libgz-sim.so.10\0", "sim10"),
    ],
)
def test_a_named_plugin_of_another_gazebo_is_refused(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, needed: bytes, build: str
) -> None:
    named = tmp_path / "a plugin.so"
    named.write_bytes(b"\x7fELF" + needed)
    monkeypatch.setenv(VARIABLE, str(named))
    for gazebo in (CLASSIC, SIM):
        if gazebo.build == build:
            assert find_plugin(gazebo) == named
        else:
            with pytest.raises(InputError, match=rf"SKYRANGE_GAZEBO_PLUGIN.*linked with {build}.*{gazebo.build}"):
                find_plugin(gazebo)


def test_a_named_file_that_is_no_library_is_refused(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = tmp_path / "text.so"
    text.write_text("text")
    for named in (text, tmp_path, tmp_path / "nothing"):
        monkeypatch.setenv(VARIABLE, str(named))
        with pytest.raises(InputError, match=r"SKYRANGE_GAZEBO_PLUGIN.*a shared library"):
            find_plugin(CLASSIC)


def test_a_flavour_is_compiled_from_its_own_sources(sources: Path) -> None:
    assert [file.name for file in plugin_sources(Flavour.CLASSIC)] == ["classic_plugin.cc", "protocol.h"]
    assert [file.name for file in plugin_sources(Flavour.SIM)] == ["protocol.h", "sim_system.cc"]


@needs_compiler
def test_a_plugin_is_compiled_tried_and_found(
    sources: Path, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (sources / "classic_plugin.cc").write_text("int of_plugin() { return ONE; }\n")
    prefix = _use(monkeypatch, server(flags="echo -DONE=1"))
    made, gazebo = install(prefix)
    assert made.compiled_now
    assert find_plugin(gazebo) == made.path
    assert made.path.is_relative_to(tmp_path / "user data")
    again, _ = install(prefix)
    assert (again.path, again.compiled_now) == (made.path, False)
    assert [path.name for path in made.path.parent.parent.iterdir()] == [made.path.parent.name]


@needs_compiler
def test_a_plugin_that_does_not_compile_or_link_is_told_in_short(
    sources: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix = _use(monkeypatch, server())
    with pytest.raises(ComponentError, match=r"cannot be compiled.*undefined reference to `of_gazebo"):
        install(prefix)
    (sources / "classic_plugin.cc").write_text("#include <gazebo/gazebo.hh>\n" + SOURCE)
    with pytest.raises(ComponentError, match=r"cannot be compiled.*gazebo/gazebo.hh"):
        install(prefix)
    (sources / "classic_plugin.cc").unlink()
    with pytest.raises(ComponentError, match=r"no sources of a plugin for Gazebo 11\.1\.0"):
        install(prefix)


def test_without_a_compiler_or_pkg_config_it_is_named(
    sources: Path, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gazebo = server()
    prefix = _use(monkeypatch, gazebo)
    env = tmp_path / "env alone"
    env.mkdir()
    for name in ("env", "sh", "sed"):
        (env / name).symlink_to(str(shutil.which(name)))
    monkeypatch.setenv("PATH", str(env))
    with pytest.raises(InputError, match="apt-get install g"):
        install(prefix)
    monkeypatch.delenv("PKG_CONFIG")
    with pytest.raises(InputError, match="apt-get install pkg-config"):
        install(prefix)


def test_headers_of_another_version_or_none_are_named_with_their_package(
    sources: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    gazebo = server(headers="10.2.0")
    prefix = _use(monkeypatch, gazebo)
    with pytest.raises(InputError, match=r"headers of 10\.2\.0.*Gazebo 11\.1\.0.*libgazebo-dev"):
        find_headers(gazebo, prefix)
    with pytest.raises(InputError, match=r"does not know gz-sim8 or gz-sim .*libgz-sim8-dev"):
        find_headers(SIM, prefix)
    gazebo = server(flags="echo \"Package 'sdformat9', required by 'gazebo', not found\"; exit 1")
    with pytest.raises(InputError, match="'sdformat9', required by 'gazebo', not found"):
        find_headers(gazebo, prefix)


def test_flags_are_looked_for_beside_the_program(
    sources: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    gazebo = server(flags="echo -I/a/include -L/a/lib -L/a/lib -lgazebo '-DA=\"b c\"'")
    root = _use(monkeypatch, gazebo)
    found = find_headers(gazebo)
    assert found.flags == ("-I/a/include", "-L/a/lib", "-L/a/lib", "-lgazebo", "-DA=b c", "-Wl,-rpath,/a/lib")
    assert Path(f"{root}/bin/pkg-config.path").read_text().strip() == str(root / "lib" / "pkgconfig")


def test_what_the_headers_of_sim_use_besides_is_added_where_it_is_known(
    sources: Path, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    pkg_config = server().path.with_name("pkg-config")
    monkeypatch.setenv("PKG_CONFIG", str(pkg_config))
    cases = '"--modversion gz-sim8") echo 8.9.0;;\n"--cflags --libs gz-sim8") echo -lgz-sim8;;\n'
    pkg_config.write_text(PKG_CONFIG.format(cases=cases))
    assert find_headers(SIM).flags == ("-lgz-sim8",)
    cases += '"--exists spdlog") exit 0;;\n"--cflags --libs gz-sim8 spdlog") echo -lgz-sim8 -lspdlog;;\n'
    pkg_config.write_text(PKG_CONFIG.format(cases=cases))
    assert find_headers(SIM).flags == ("-lgz-sim8", "-lspdlog")


def test_a_prefix_without_a_gazebo_is_refused(sources: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--prefix.*bin/gz or bin/gzserver"):
        find_installed(tmp_path)


@pytest.mark.parametrize(
    ("loads", "said"),
    [
        ("echo '\033[1;31m[Err] \033[0mFailed to load plugin a: no file'; sleep 300", "Failed to load plugin a"),
        ("echo 'Failed to load system plugin: (Reason: No plugins detected in library)'; sleep 300", "No plugins"),
        ("echo nonsense; exit 3", r"ended \(exit 3\).*nonsense"),
        ("echo gz: error while loading shared libraries: a.so; exit 1", "Set LD_LIBRARY_PATH to the folder"),
        ("exit 0", r"ended \(exit 0\).*printed nothing"),
        ("echo busy; sleep 300", r"not loaded it within 1 s.*busy"),
    ],
)
def test_a_plugin_that_gazebo_does_not_load_is_refused(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loads: str, said: str
) -> None:
    monkeypatch.setattr(plugin_library, "TRIAL_S", 1.0 if "busy" in loads else 60.0)
    gazebo = server(loads)
    with pytest.raises(ComponentError, match=said):
        try_plugin("plugin", gazebo, tmp_path / "a.so")


def test_the_diagnosis_names_gazebo_plugin_and_window(
    sources: Path, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setenv(GAZEBO_VARIABLE, str(tmp_path / "nothing"))
    (found,) = doctor._gazebo()
    assert (found.ok, found.optional) == (False, True)
    assert "apt-get install gz-harmonic" in found.hint

    gazebo = server()
    monkeypatch.setenv(GAZEBO_VARIABLE, str(gazebo.path))
    found, window = doctor._gazebo()
    assert "Gazebo 11.1.0" in found.found
    assert "not compiled yet" in found.found
    assert "skyrange install gazebo" in found.hint
    assert (found.ok, window.ok, window.found) == (False, False, "no gzclient")

    library = _keep(sources, "classic11")
    gazebo.path.with_name("gzclient").write_text("#!/bin/sh\n")
    gazebo.path.with_name("gzclient").chmod(0o755)
    found, window = doctor._gazebo()
    assert (found.ok, window.ok) == (True, True)
    assert str(library) in found.found

    server(loads="exit 1")
    found, _ = doctor._gazebo()
    assert not found.ok
    assert "skyrange install gazebo" in found.hint


def test_the_tested_releases_are_supported() -> None:
    assert installing.TESTED
    assert all(int(release.partition(".")[0]) >= 8 for release in installing.TESTED)
