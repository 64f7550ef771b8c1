"""The image `base`, built on a Debian 12 that mmdebstrap made, flies `squares` where only its volumes can be written.

What this machine refuses skips the test, with what it said. The build sees pip's settings and the certificates of this
machine, and they are no part of the image.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from skyrange.metrics.summary import summary
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly

ROOT = Path(__file__).parents[2]
NAME = f"localhost/skyrange-test-{os.getpid()}"
PROGRAMS = ("buildah", "podman", "mmdebstrap")
CERTIFICATES = ("PIP_CERT", "REQUESTS_CA_BUNDLE", "SSL_CERT_FILE")
ISOLATION = ("--isolation", "chroot", "--network", "host")


def _run(*command: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s)


def _missing() -> str:
    """Why images cannot be built here, "" if they can."""
    lacking = [name for name in PROGRAMS if shutil.which(name) is None]
    if lacking:
        return f"{', '.join(lacking)} not on PATH (apt-get install {' '.join(lacking)})"
    try:
        made = _run("buildah", "from", "scratch")
        if made.returncode == 0:
            _run("buildah", "rm", made.stdout.strip())
            return ""
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"buildah: {error}"
    return f"buildah: {made.stderr.strip()[-200:]}"


needs_buildah = pytest.mark.external(missing=_missing())


def _shown() -> list[str]:
    """Arguments of buildah that show pip's settings and certificates of this machine to the build."""
    files = [Path("/etc/pip.conf"), *(Path(os.environ[name]) for name in CERTIFICATES if os.environ.get(name))]
    return [f"--volume={path}:{path}:ro" for path in dict.fromkeys(files) if path.is_file()]


SHUT = ("--read-only", "--cap-drop=all", "--security-opt=no-new-privileges", "--network=none", "--rm")
"""Arguments of podman for a container with a read-only root file system, without rights and networks."""
REFUSED = (125, 126, 127)
"""Exit codes with which podman or its runtime say that they cannot run a container."""


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The name of the image."""
    root = tmp_path_factory.mktemp("debian") / "debian.tar"
    # with certificates: installing them during the build would replace the file that `_shown` puts in their place
    packages = "--include=ca-certificates"
    made = _run("mmdebstrap", "--variant=minbase", packages, "bookworm", str(root), timeout_s=600.0)
    if made.returncode:
        pytest.skip(f"mmdebstrap: {made.stderr.strip()[-300:]}")
    try:
        imported = _run("podman", "import", "--quiet", str(root), f"{NAME}:debian", timeout_s=300.0)
        assert imported.returncode == 0, imported.stderr
        tried = _run("podman", "run", *SHUT, f"{NAME}:debian", "true")
        if tried.returncode in REFUSED:
            pytest.skip(f"podman: {tried.stderr.strip()[-300:]}")
        build = ("buildah", "build", "--format", "docker", *ISOLATION, "--build-arg", f"BASE={NAME}:debian", *_shown())
        built = _run(*build, "--target", "base", "--tag", f"{NAME}:base", str(ROOT), timeout_s=1_400.0)
        assert built.returncode == 0, built.stdout[-2000:] + built.stderr[-2000:]
        yield f"{NAME}:base"
    finally:
        _run("podman", "rmi", "--force", f"{NAME}:base", f"{NAME}:debian", timeout_s=120.0)


@needs_buildah
@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_squares_flies_in_the_image_as_it_does_here(base: str, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    runs.mkdir()
    runs.chmod(0o777)
    done = _run(
        "podman", "run", *SHUT, f"--volume={runs}:/work/runs", base, "run", "squares", "--json", timeout_s=600.0
    )
    assert done.returncode == 0, done.stderr
    assert os.geteuid() != 0 or (runs / "squares" / "report.html").stat().st_uid == 10_001
    here = fly(load("squares"), tmp_path / "here", report=False)
    assert json.loads(done.stdout)["fingerprint"] == summary(here)["fingerprint"]
    inspected = json.loads(_run("podman", "inspect", "--type=image", base).stdout)[0]
    assert inspected["User"] == "10001:10001"
    assert inspected["HealthCheck" if "HealthCheck" in inspected else "Healthcheck"]["Test"][-1] == "busy"
    assert inspected["Labels"]["org.opencontainers.image.title"] == "skyrange"
