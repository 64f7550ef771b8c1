"""Which radio engines are there to test with? Without one its mark skips a test."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.core.errors import SkyrangeError
from skyrange.radio.external import ns3, omnetpp
from skyrange.radio.external.engine import find_engine


def _find(name: str, title: str, variable: str, install: str) -> tuple[Path | None, str]:
    try:
        return find_engine(name, title, variable, install), ""
    except SkyrangeError as error:
        return None, str(error)


NS3, WHY_NO_NS3 = _find("ns3", "ns-3", ns3.VARIABLE, ns3.INSTALL)
"""The compiled engine, and why there is none."""

needs_ns3 = pytest.mark.external(missing=WHY_NO_NS3)

OMNETPP, WHY_NO_OMNETPP = _find("omnetpp", "OMNeT++", omnetpp.VARIABLE, omnetpp.INSTALL)
"""The compiled engine, and why there is none."""

needs_omnetpp = pytest.mark.external(missing=WHY_NO_OMNETPP)
