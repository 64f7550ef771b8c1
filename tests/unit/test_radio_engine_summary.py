"""What a run says of a radio engine that is another program."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.metrics.summary import describe_radio_engine

NS3 = {"engine": "ns-3", "release": "3.44"}


@pytest.mark.parametrize(
    ("manifest", "text"),
    [
        ({}, ""),
        ({"medium": {"kind": "acme.disc"}}, ""),
        (
            {"medium": NS3 | {"builtin_waveforms": ["BLE_1M", "BLE_CODED"]}},
            "ns-3 3.44; Bluetooth by the builtin medium",
        ),
        (
            {"medium": NS3 | {"builtin_waveforms": ["DSSS_1M", "BLE_1M"]}},
            "ns-3 3.44; Bluetooth and DSSS_1M by the builtin medium",
        ),
        ({"medium": NS3 | {"builtin_waveforms": []}}, "ns-3 3.44"),
        ({"medium": "text"}, ""),
    ],
)
def test_the_engine_is_named_with_what_it_leaves_to_the_builtin(manifest: dict[str, Any], text: str) -> None:
    assert describe_radio_engine(manifest) == text
