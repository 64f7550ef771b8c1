"""How far network simulators agree with the builtin medium, on a sample of what `tools.agreement radio` runs."""

from __future__ import annotations

from collections.abc import Iterable

from skyrange.contracts.medium import Waveform
from skyrange.core.time import NS_PER_MS
from skyrange.radio.phy import airtime_ns
from tests.radio_engines import needs_ns3, needs_omnetpp
from tools.agreement.radio.agreement import PARTIAL, WITHIN
from tools.agreement.radio.experiments import FRAME_BYTES, Trial, contention_trials, hidden_trials, run_trial
from tools.agreement.radio.setups import BUILTIN, SWAPS, EngineSetup, Swap


def _swap(engine: str, *models: str) -> Swap:
    return next(swap for swap in SWAPS[engine] if swap.models == models)


def _load(trial: Trial) -> float:
    """Airtime of the frames that all senders offer within a window, over the window."""
    senders = len(trial.places_m) - len(trial.cells)
    window_ns = trial.cells[0].facts["window_ms"] * NS_PER_MS
    return float(senders * airtime_ns(int(Waveform.OFDM_6M), FRAME_BYTES) / window_ns)


def _share(trial: Trial, setup: EngineSetup) -> float:
    found = run_trial(trial, setup, None)
    return float((found.decoded / found.offered).item())


def _agreeing(trials: Iterable[Trial], swap: Swap) -> tuple[int, int]:
    """Cells that agree within five points, and those in which either decodes a part."""
    alike, counted = 0, 0
    for trial in trials:
        shares = _share(trial, swap.builtin), _share(trial, swap.setup)
        if any(PARTIAL[0] <= share <= PARTIAL[1] for share in shares):
            counted += 1
            alike += abs(shares[0] - shares[1]) <= WITHIN
    return alike, counted


@needs_ns3
def test_ns3_with_the_builtins_preambles_and_errors_agrees_where_the_channel_carries_the_load() -> None:
    """Nine of ten cells of contention and hidden terminals."""
    trials = [*contention_trials(), *hidden_trials()][::2]
    carried = [trial for trial in trials if _load(trial) <= 1.0 and len(trial.places_m) <= 60]
    alike, counted = _agreeing(carried, _swap("ns3", "preamble detection", "error rate model"))
    assert counted >= 8
    assert alike >= 0.9 * counted


@needs_ns3
def test_eifs_explains_why_the_builtin_hears_more_of_an_overload_than_ns3() -> None:
    """A sender of the builtin waits for EIFS after any frame with an error (IEEE 802.11-2020 10.3.2.3.7), one of ns-3
    not after an error of the header. Without EIFS both agree.
    """
    overloads = [trial for trial in contention_trials() if _load(trial) > 10.0 and len(trial.places_m) <= 110]
    assert len(overloads) >= 3
    swap = _swap("ns3", "preamble detection", "EIFS")
    for trial in overloads:
        ns3 = _share(trial, swap.setup)
        assert ns3 + WITHIN < _share(trial, BUILTIN) < ns3 + 0.15
        assert abs(_share(trial, swap.builtin) - ns3) <= WITHIN


@needs_omnetpp
def test_inet_with_the_builtins_receiver_thresholds_agrees_on_hidden_terminals() -> None:
    """One model is swapped; nine of ten cells."""
    alike, counted = _agreeing(list(hidden_trials())[::2], _swap("omnetpp", "receiver thresholds"))
    assert counted >= 8
    assert alike >= 0.9 * counted
