"""Can a scenario name what the radio and Remote ID have, and nothing else?"""

from __future__ import annotations

from typing import get_args

import pytest

from skyrange.core.errors import InputError
from skyrange.radio.receivers import PROFILES
from skyrange.remoteid.profiles import TRANSPORTS
from skyrange.scenario.air import Radio, Receiver, ReceiverKind, RemoteId


def test_every_kind_of_receiver_can_be_named_but_none() -> None:
    """A receiver that hears nothing is left out instead."""
    assert set(get_args(ReceiverKind)) == PROFILES.keys() - {"none"}
    with pytest.raises(InputError, match="sniffer"):
        Radio(aboard="none")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="sniffer"):
        Receiver(id="mast", operator="blue", place=(0, 0, 2), kind="none")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", TRANSPORTS)
def test_every_transport_can_be_named_once(name: str) -> None:
    assert RemoteId(transports=(name,)).transports == (name,)
    with pytest.raises(InputError, match="each way once"):
        RemoteId(transports=(name, name))


def test_bluetooth_is_both_kinds_and_others_are_unknown() -> None:
    with pytest.raises(InputError, match="each way once"):
        RemoteId(transports=("bluetooth", "bt5"))
    with pytest.raises(InputError, match="wifi_nan"):
        RemoteId(transports=("wifi_nann",))
