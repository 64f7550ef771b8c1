"""How far network simulators agree with the builtin medium, on a sample of what `skyrange parity radio` runs."""

from __future__ import annotations

from skyrange.contracts.medium import Waveform
from skyrange.core.time import NS_PER_MS
from skyrange.radio.phy.waveforms import airtime_ns
from skyrange.study.compare.radio.agreement import BUILTIN, PARTIAL, WITHIN
from skyrange.study.compare.radio.experiments import contention_trials, hidden_trials
from skyrange.study.compare.radio.setups import SWAPS
from skyrange.study.compare.radio.trials import FRAME_BYTES, Trial, run_trial
from tests.radio_engines import needs_ns3

ALIKE = SWAPS["ns3"][-1]
"""ns-3 with the builtin's error model, and preambles from the same signal."""


def _load(trial: Trial) -> float:
    """Airtime of the frames that all senders offer within a window, over the window."""
    senders = len(trial.places_m) - len(trial.cells)
    window_ns = trial.cells[0].facts["window_ms"] * NS_PER_MS
    return float(senders * airtime_ns(int(Waveform.OFDM_6M), FRAME_BYTES) / window_ns)


def _shares(trial: Trial) -> tuple[float, float]:
    """What the builtin and ns-3 decode."""
    builtin, ns3 = (run_trial(trial, one, None) for one in (BUILTIN, ALIKE))
    return (builtin.decoded / builtin.offered).item(), (ns3.decoded / ns3.offered).item()


@needs_ns3
def test_ns3_with_equal_thresholds_agrees_where_the_channel_carries_the_load() -> None:
    """Nine of ten cells within five points, of contention and hidden terminals."""
    alike, counted = 0, 0
    for trial in [*contention_trials(), *hidden_trials()][::2]:
        if _load(trial) > 1.0 or len(trial.places_m) > 60:
            continue
        shares = _shares(trial)
        if any(PARTIAL[0] <= share <= PARTIAL[1] for share in shares):
            counted += 1
            alike += abs(shares[0] - shares[1]) <= WITHIN
    assert counted >= 8
    assert alike >= 0.9 * counted


@needs_ns3
def test_the_builtin_hears_more_of_an_overload_than_ns3() -> None:
    """After a reception that failed it waits for EIFS (IEEE 802.11-2020 10.3.2.3.7), where ns-3 collides again."""
    overloads = [trial for trial in contention_trials() if _load(trial) > 10.0 and len(trial.places_m) <= 110]
    assert len(overloads) >= 3
    for trial in overloads:
        builtin, ns3 = _shares(trial)
        assert ns3 < builtin < ns3 + 0.15
