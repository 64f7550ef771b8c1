"""Which radio engines are there to test with? Without one its mark skips a test."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.core.errors import SkyrangeError
from skyrange.radio.external.engine_sources import find_engine
from skyrange.radio.external.ns3 import INSTALL, VARIABLE


def _find(name: str, title: str, variable: str, install: str) -> tuple[Path | None, str]:
    try:
        return find_engine(name, title, variable, install), ""
    except SkyrangeError as error:
        return None, str(error)


NS3, WHY_NO_NS3 = _find("ns3", "ns-3", VARIABLE, INSTALL)
"""The compiled engine, and why there is none."""

needs_ns3 = pytest.mark.external(missing=WHY_NO_NS3)
