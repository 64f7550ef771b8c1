"""Trials of a medium: frames of fixed radios, and the share of them that each receiver decodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.contracts.medium import ANY_CHANNEL, Floats, RadioSpec, RadioTable, ReceptionOutcome, TxBatch, Waveform
from skyrange.core.time import NS_PER_S
from skyrange.radio.builtin.listening import SNIFFER
from skyrange.radio.builtin.params import RadioEnvironment
from tools.agreement.radio.setups import EngineSetup

FRAME_BYTES = 250
"""A beacon with a pack of six messages or so."""
STEP_NS = 10 * NS_PER_S
SETTLE_NS = NS_PER_S
"""After the last frame; every frame has been told of then (see `Medium.offer`: 0.5 s of waiting at most)."""


class Cell(NamedTuple):
    """A receiver of a trial, and how the cell is described."""

    receiver: int
    """Row of the trial's places."""
    facts: dict[str, Any]


class Trial(NamedTuple):
    """Frames of radios that stand still."""

    experiment: str
    seed: int
    in_city: bool
    horizon_m: float
    places_m: Floats
    """(n, 3)"""
    sender: NDArray[np.int64]
    """(k,) rows of `places_m`, one for each frame."""
    at_ns: NDArray[np.int64]
    """(k,) ascending."""
    cells: Sequence[Cell]


class Shares(NamedTuple):
    """Results of a trial: for each cell, decoded frames, and frames that were offered."""

    decoded: NDArray[np.int64]
    offered: NDArray[np.int64]


def run_trial(trial: Trial, setup: EngineSetup, city: City | None) -> Shares:
    """Offer the frames of a trial to an engine, with skyrange's path losses, and count what its cells decode."""
    names = [f"r{row:04d}" for row in range(len(trial.places_m))]
    radios = [RadioSpec(name, None, SNIFFER, wifi_dbm=15.0) for name in names]  # senders defer by what they receive
    surroundings = RadioEnvironment(horizon_m=trial.horizon_m)
    medium = setup.make(radios, trial.seed, city if trial.in_city else None, surroundings)
    try:
        table = RadioTable(0, trial.places_m, np.zeros_like(trial.places_m))
        decoded = np.zeros(len(names), dtype=np.int64)
        begin, last = 0, int(trial.at_ns[-1]) + SETTLE_NS
        keys = np.arange(len(trial.at_ns))
        for until in range(STEP_NS, last + STEP_NS, STEP_NS):
            end = int(np.searchsorted(trial.at_ns, until, side="right"))
            if end > begin:
                rows = slice(begin, end)
                same = np.zeros(end - begin, dtype=np.int64)
                medium.offer(
                    until,
                    TxBatch(
                        trial.sender[rows], trial.at_ns[rows], same + int(Waveform.OFDM_6M), same + ANY_CHANNEL,
                        np.full(end - begin, np.nan), same + FRAME_BYTES, keys[rows],
                    ),
                )  # fmt: skip
                begin = end
            heard = medium.advance(until, table).heard
            np.add.at(decoded, heard.radio[heard.outcome == ReceptionOutcome.DECODED], 1)
    finally:
        medium.close()
    offered = np.array([int((trial.sender != cell.receiver).sum()) for cell in trial.cells])
    return Shares(decoded[[cell.receiver for cell in trial.cells]], offered)
