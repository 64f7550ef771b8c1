"""`python -m tests.parity FOLDER`: the missions under both autopilots, and the tables of docs/data/parity.json.

The runs stay in FOLDER. It takes some minutes. `python -m tools.docs.generate` then puts the tables into the pages.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tests.parity import tables
from tests.parity.hover import hovered
from tests.parity.missions import DEPART_S, WATCHED, WINDS, flown, flown_at

DATA = Path(__file__).parents[2] / "docs" / "data" / "parity.json"


def main(folder: Path) -> None:
    """Fly, and write the tables."""
    made: dict[str, tables.Table] = {}
    for wind_mps, names in WINDS.items():
        parity = flown(wind_mps, folder / f"wind-{wind_mps:g}", names)
        kind = "wind" if wind_mps else "calm"
        made[f"missions-{kind}"] = tables.missions(parity)
        made[f"measures-{kind}"] = tables.measures(parity, DEPART_S)
        if wind_mps == 0.0:
            made["messages-light"] = tables.messages(parity, "blue/speed")
            made["messages-operator"] = tables.messages(parity, f"green/{WATCHED}")
    made["hover"] = tables.hover(*hovered(folder / "hover", "full"))
    cheaper = {
        rates: {
            wind_mps: flown_at(rates, wind_mps, folder / f"{rates}-{wind_mps:g}", names)
            for wind_mps, names in WINDS.items()
        }
        for rates in ("single", "reduced")
    }
    made["rates"] = tables.rates(cheaper, DEPART_S)
    DATA.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
