"""Radio engines under comparison: as each is by default, and with models swapped on its side or on the builtin's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from skyrange.city.city import City
from skyrange.contracts.medium import Medium, RadioSpec, Waveform
from skyrange.contracts.plugins.registry import MEDIA, kinds
from skyrange.core.chance import Chance
from skyrange.core.errors import SkyrangeError
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.radio.phy import LOCK_SNIR_DB, WIDTH_MHZ
from skyrange.radio.propagation.path_loss import noise_dbm

TITLES: Final = {"builtin": "builtin", "ns3": "ns-3", "omnetpp": "INET"}


@dataclass(frozen=True)
class EngineSetup:
    """An engine with parameters: its defaults but for `params`."""

    engine: str
    """Kind of medium plugin."""
    changes: str = ""
    """How it differs from its defaults, for tables; empty for the defaults."""
    params: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """A name for tables."""
        name = TITLES.get(self.engine, self.engine)
        return f"{name}, {self.changes}" if self.changes else name

    def make(
        self,
        radios: Sequence[RadioSpec],
        seed: int,
        city: City | None,
        surroundings: RadioEnvironment,
        losses: Literal["city", "engine"] = "city",
    ) -> Medium:
        """A medium of these radios. Raises `InputError` if the engine is not installed."""
        plugin = MediumPlugin.find(self.engine)
        context = MediumContext(radios, Chance(seed), city, surroundings, losses)
        return plugin(plugin.params.model_validate(dict(self.params)), context)


BUILTIN: Final = EngineSetup("builtin")


@dataclass(frozen=True)
class Swap:
    """A comparison in which models are swapped in an engine, in the builtin, or in both."""

    models: tuple[str, ...]
    """The models that are not the defaults of their engine."""
    setup: EngineSetup
    builtin: EngineSetup = BUILTIN
    """What `setup` is compared with."""

    @property
    def text(self) -> str:
        """What is swapped, for tables."""
        return "; ".join(filter(None, (self.setup.changes, self.builtin.title if self.builtin.changes else "")))


LOCK_DB: Final = float(LOCK_SNIR_DB[Waveform.OFDM_6M])
"""SNR from which the builtin detects the preamble of the frames that are compared."""
LOCK_DBM: Final = float(noise_dbm(RadioSpec("").noise_figure_db, float(WIDTH_MHZ[Waveform.OFDM_6M]))) + LOCK_DB
"""The same as a power, over the noise of the radios that are compared."""
_NO_FLOOR_DBM: Final = -150.0
_NO_SNIR_DB: Final = -50.0

_NO_EIFS: Final = EngineSetup("builtin", "without EIFS", {"eifs": False})
_NO_CAPTURE: Final = EngineSetup("builtin", "without frame capture", {"frame_capture": False})
_FIRST: Final = EngineSetup("builtin", "first preamble", {"preamble_choice": "first"})
_NS3: Final = EngineSetup("ns3")
_NS3_PREAMBLES: Final = EngineSetup(
    "ns3",
    f"preambles from {LOCK_DB:.1f} dB, no RSSI floor",
    {"preamble_rssi_dbm": _NO_FLOOR_DBM, "preamble_snr_db": LOCK_DB},
)
_INET: Final = EngineSetup("omnetpp")
_INET_RECEIVER: Final = EngineSetup(
    "omnetpp",
    f"receives from {LOCK_DBM:.1f} dBm, no SNIR threshold".replace("-", "−"),
    {"sensitivity_dbm": LOCK_DBM, "snir_threshold_db": _NO_SNIR_DB},
)
_PREAMBLES, _ERRORS, _CAPTURE, _CHOICE = "preamble detection", "error rate model", "frame capture", "preamble choice"
_EIFS, _RECEIVER = "EIFS", "receiver thresholds"

SWAPS: Final[Mapping[str, Sequence[Swap]]] = {
    "ns3": (
        Swap((_PREAMBLES,), _NS3_PREAMBLES),
        Swap((_ERRORS,), EngineSetup("ns3", "Nist error rate model", {"error_model": "nist"})),
        Swap((_CAPTURE,), EngineSetup("ns3", "frame capture at 10 dB", {"capture_margin_db": 10.0})),
        Swap((_EIFS,), _NS3, _NO_EIFS),
        Swap(
            (_PREAMBLES, _ERRORS),
            EngineSetup(
                "ns3",
                f"{_NS3_PREAMBLES.changes}, Nist error rate model",
                {**_NS3_PREAMBLES.params, "error_model": "nist"},
            ),
        ),
        Swap((_PREAMBLES, _EIFS), _NS3_PREAMBLES, _NO_EIFS),
    ),
    "omnetpp": (
        Swap((_RECEIVER,), _INET_RECEIVER),
        Swap((_CAPTURE,), _INET, _NO_CAPTURE),
        Swap((_CHOICE,), _INET, _FIRST),
        Swap((_RECEIVER, _CAPTURE), _INET_RECEIVER, _NO_CAPTURE),
        Swap((_RECEIVER, _CHOICE), _INET_RECEIVER, _FIRST),
    ),
}
"""By engine: comparisons with one model swapped, then with more. Each brings a rule of the engine and of the builtin
together. So INET's `snirMode` is none of them: the builtin takes neither the least nor the mean SNIR of a frame.
"""


def installed_engines() -> dict[str, str]:
    """Kinds of media that can be compared with the builtin, each with "" or the reason why it cannot run."""
    found = {}
    for kind in kinds(MEDIA):
        if kind not in TITLES or kind == "builtin":
            continue
        try:
            EngineSetup(kind).make([RadioSpec("a")], 1, None, RadioEnvironment()).close()
            found[kind] = ""
        except SkyrangeError as error:
            found[kind] = str(error)
    return found
