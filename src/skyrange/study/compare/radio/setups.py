"""Radio engines under comparison: as each is by default, and with single models swapped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from skyrange.city.city import City
from skyrange.contracts.medium import Medium, RadioSpec
from skyrange.contracts.plugins import MEDIA, kinds
from skyrange.core.chance import Chance
from skyrange.core.errors import SkyrangeError
from skyrange.radio.builtin.environment import RadioEnvironment
from skyrange.radio.contract import MediumContext, MediumPlugin

TITLES: Final = {"builtin": "builtin", "ns3": "ns-3", "omnetpp": "INET"}


@dataclass(frozen=True)
class EngineSetup:
    """An engine with parameters: its defaults but for `params`."""

    engine: str
    """Kind of medium plugin."""
    swap: str = ""
    """What was swapped; empty for the defaults."""
    params: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """A name for tables."""
        name = TITLES.get(self.engine, self.engine)
        return f"{name}, {self.swap}" if self.swap else name

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


SWAPS: Final[Mapping[str, Sequence[EngineSetup]]] = {
    "ns3": (
        EngineSetup("ns3", "preambles from −101 dBm", {"preamble_rssi_dbm": -101.0}),
        EngineSetup("ns3", "Nist error model", {"error_model": "nist"}),
        EngineSetup("ns3", "frame capture at 10 dB", {"capture_margin_db": 10.0}),
        EngineSetup("ns3", "preambles from −101 dBm, Nist", {"preamble_rssi_dbm": -101.0, "error_model": "nist"}),
        EngineSetup(
            "ns3",
            "preambles from −101 dBm and 2.3 dB, Nist",
            {"preamble_rssi_dbm": -101.0, "error_model": "nist", "preamble_snr_db": 2.3},
        ),
    ),
    "omnetpp": (
        EngineSetup("omnetpp", "receives from −110 dBm", {"sensitivity_dbm": -110.0}),
        EngineSetup("omnetpp", "decodes from 0 dB", {"snir_threshold_db": 0.0}),
        EngineSetup(
            "omnetpp",
            "receives from −110 dBm, decodes from 0 dB",
            {"sensitivity_dbm": -110.0, "snir_threshold_db": 0.0},
        ),
        EngineSetup(
            "omnetpp",
            "receives from −110 dBm, decodes from 0 dB, senses from −92 dBm",
            {"sensitivity_dbm": -110.0, "snir_threshold_db": 0.0, "energy_detection_dbm": -92.0},
        ),
    ),
}
"""By engine: setups in which models differ from its defaults."""


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
