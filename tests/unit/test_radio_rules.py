"""Parameters of the builtin medium: frame capture, preamble choice and EIFS, each on and off."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from pydantic import ValidationError

from skyrange.contracts.medium import ANY_CHANNEL, OnAir, RadioSpec, ReceptionOutcome, TxBatch, Waveform
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_MS, NS_PER_US
from skyrange.radio.builtin.backoff import ERROR_NS
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.builtin.medium import BuiltinMedium, fixed_positions
from skyrange.radio.builtin.params import BuiltinParams, RadioEnvironment
from skyrange.radio.contract import BUILTIN, MediumContext

HORIZON = RadioEnvironment(horizon_m=1_000.0, chance=False)
OUTCOMES = ReceptionOutcome


def _offer(params: BuiltinParams, east_m: dict[str, float], frames: dict[str, int]) -> tuple[BuiltinMedium, OnAir]:
    """Radios on a line, of which some send a frame at the times given, in ns."""
    radios = [RadioSpec(name, (east, 0.0, 30.0), SNIFFER) for name, east in east_m.items()]
    medium = BuiltinMedium(radios, Chance(1), None, HORIZON, every_pair=True, params=params)
    names = [radio.name for radio in medium.radios]
    same = np.zeros(len(frames), dtype=np.int64)
    medium.offer(
        0,
        TxBatch(
            np.array([names.index(name) for name in frames]), np.array(list(frames.values())),
            same + int(Waveform.OFDM_6M), same + ANY_CHANNEL, np.full(len(frames), np.nan), same + 200,
            np.arange(len(frames)),
        ),
    )  # fmt: skip
    return medium, medium.advance(10 * NS_PER_MS, fixed_positions(medium.radios))


def _outcomes(params: BuiltinParams, east_m: dict[str, float], frames: dict[str, int]) -> dict[str, ReceptionOutcome]:
    """What the radio "at" gets of each frame, by sender."""
    medium, answer = _offer(params, east_m, frames)
    heard = answer.heard
    names = [radio.name for radio in medium.radios]
    found = {}
    for key, radio, outcome in zip(heard.key.tolist(), heard.radio.tolist(), heard.outcome.tolist(), strict=True):
        if names[radio] == "at":
            found[list(frames)[key]] = ReceptionOutcome(outcome)
    return found


@pytest.mark.parametrize(
    ("params", "later"),
    [
        (BuiltinParams(), OUTCOMES.DECODED),
        (BuiltinParams(frame_capture=False), OUTCOMES.BUSY),
        (BuiltinParams(capture_margin_db=13.0), OUTCOMES.DECODED),
        (BuiltinParams(capture_margin_db=15.0), OUTCOMES.BUSY),
    ],
)
def test_a_later_frame_is_captured_if_it_is_stronger_by_the_margin(
    params: BuiltinParams, later: ReceptionOutcome
) -> None:
    """14 dB stronger: a fifth of the distance. Both senders are farther apart than the horizon, and so hidden."""
    places = {"at": 0.0, "far": -900.0, "near": 180.0}
    found = _outcomes(params, places, {"far": NS_PER_MS, "near": NS_PER_MS + 100 * NS_PER_US})
    assert found["near"] == later
    assert found["far"] != OUTCOMES.DECODED


@pytest.mark.parametrize(("choice", "outcome"), [("strongest", OUTCOMES.DECODED), ("first", OUTCOMES.BUSY)])
def test_of_frames_within_the_preamble_the_strongest_or_the_first_is_chosen(
    choice: Literal["strongest", "first"], outcome: ReceptionOutcome
) -> None:
    """7 dB stronger, which is less than the margin of capture, and 2 µs later."""
    params = BuiltinParams(preamble_choice=choice)
    places = {"at": 0.0, "far": -450.0, "near": 200.0}
    assert _outcomes(params, places, {"far": NS_PER_MS, "near": NS_PER_MS + 2 * NS_PER_US})["near"] == outcome


def test_the_first_preamble_gives_way_to_frame_capture() -> None:
    params = BuiltinParams(preamble_choice="first")
    places = {"at": 0.0, "far": -450.0, "near": 50.0}
    assert _outcomes(params, places, {"far": NS_PER_MS, "near": NS_PER_MS + 2 * NS_PER_US})["near"] == OUTCOMES.DECODED


def test_without_eifs_a_sender_waits_for_difs_after_an_error() -> None:
    """Two equal frames collide at a radio that has a frame of its own to send."""
    starts = []
    for eifs in (True, False):
        frames = {"left": NS_PER_MS, "right": NS_PER_MS, "at": NS_PER_MS + 100 * NS_PER_US}
        _, answer = _offer(BuiltinParams(eifs=eifs), {"at": 0.0, "left": -600.0, "right": 600.0}, frames)
        starts.append(int(answer.sent.started_ns[answer.sent.key == 2][0]))
    assert starts[0] - starts[1] == ERROR_NS


def test_eifs_does_not_matter_after_a_frame_without_error() -> None:
    starts = set()
    for eifs in (True, False):
        frames = {"left": NS_PER_MS, "at": NS_PER_MS + 100 * NS_PER_US}
        _, answer = _offer(BuiltinParams(eifs=eifs), {"at": 0.0, "left": -600.0}, frames)
        starts.add(int(answer.sent.started_ns[answer.sent.key == 1][0]))
    assert len(starts) == 1


def test_the_plugin_hands_its_parameters_on() -> None:
    context = MediumContext([RadioSpec("a")], Chance(1))
    medium = BUILTIN.make(BuiltinParams(eifs=False, frame_capture=False, preamble_choice="first"), context)
    assert isinstance(medium, BuiltinMedium)
    assert not medium._params.eifs
    assert not medium._params.strongest_preamble
    assert medium._params.capture_db == float("inf")
    default = BUILTIN.make(BuiltinParams(), context)
    assert isinstance(default, BuiltinMedium)
    assert default._params[-3:] == (10.0, True, True)


@pytest.mark.parametrize(
    "wrong",
    [{"eifs": 1}, {"frame_capture": "no"}, {"capture_margin_db": -1.0}, {"preamble_choice": "last"}, {"capture": True}],
)
def test_wrong_parameters_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        BuiltinParams.model_validate(wrong)
