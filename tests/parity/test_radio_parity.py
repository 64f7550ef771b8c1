"""How far network simulators agree with the builtin medium, on a sample of what `skyrange parity radio` runs."""

from __future__ import annotations

import pytest

from skyrange.study.compare.radio.agreement import BUILTIN, PARTIAL, WITHIN
from skyrange.study.compare.radio.experiments import contention_trials, hidden_trials
from skyrange.study.compare.radio.setups import SWAPS
from skyrange.study.compare.radio.trials import run_trial
from tests.radio_engines import needs_ns3

ALIKE = SWAPS["ns3"][-1]
"""ns-3 with the builtin's error model, and preambles from the same signal."""


@needs_ns3
@pytest.mark.parametrize("name", ["contention", "hidden terminals"])
def test_ns3_with_equal_thresholds_agrees(name: str) -> None:
    """Nine of ten cells within five points: those of windows from 10 ms on, where channel access decides. Bursts within
    1 ms end in collisions of preambles, after which the builtin waits for EIFS and ns-3 does not.
    """
    trials = [*contention_trials()] if name == "contention" else [*hidden_trials()]
    chosen = [trial for trial in trials if trial.cells[0].facts["window_ms"] >= 10][::2]
    alike, counted = 0, 0
    for trial in chosen:
        if trial.cells[0].facts["nodes"] > 100:
            continue
        shares = [
            (found.decoded / found.offered).item()
            for found in (run_trial(trial, one, None) for one in (BUILTIN, ALIKE))
        ]
        if any(PARTIAL[0] <= share <= PARTIAL[1] for share in shares):
            counted += 1
            alike += abs(shares[0] - shares[1]) <= WITHIN
    assert counted >= 3
    assert alike >= 0.75 * counted
