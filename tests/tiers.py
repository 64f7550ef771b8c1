"""The tiers of the tests: programs that tests of the external tier need, and the examples that property tests try."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import settings

FULL = 100
"""The examples of the profile `full`."""

# no deadlines: how long an example takes depends on what else the machine does
settings.register_profile("full", max_examples=FULL, deadline=None)
settings.register_profile("quick", max_examples=FULL // 4, deadline=None)
settings.register_profile("fuzz", max_examples=FULL // 4, deadline=None, derandomize=False, print_blob=True)
settings.load_profile("full")


def needs(program: str, hint: str = "") -> pytest.MarkDecorator:
    """The mark of tests that run `program`: of the external tier, and skipped where it is not on `PATH`.

    `hint` says how to install it.
    """
    missing = "" if shutil.which(program) else f"{program} is not on PATH" + (f" ({hint})" if hint else "")
    return pytest.mark.external(missing=missing)


def needs_folder(variable: str, file: str, hint: str) -> pytest.MarkDecorator:
    """The mark of tests that need a folder with a `file`, named by an environment variable; external as `needs`."""
    folder = os.environ.get(variable, "")
    missing = "" if folder and (Path(folder) / file).is_file() else f"{variable} names no folder with {file} ({hint})"
    return pytest.mark.external(missing=missing)


needs_tshark = needs("tshark", "apt-get install tshark")
needs_opendroneid = needs_folder(
    "OPENDRONEID", "libopendroneid/opendroneid.c", "git clone https://github.com/opendroneid/opendroneid-core-c"
)
needs_mavproxy = needs("mavproxy.py", "pip install MAVProxy")


def is_fuzzing() -> bool:
    """Whether property tests are repeated with new examples, as `make fuzz` does."""
    return settings.get_current_profile_name() == "fuzz"


def examples(count: int) -> int:
    """How many examples a property test tries whose full number is `count`: in `quick` and `fuzz`, a quarter."""
    return max(1, count * settings().max_examples // FULL)
