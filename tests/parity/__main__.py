"""`python -m tests.parity FOLDER`: the missions under both autopilots, and the tables of docs/explanation/parity.md.

The runs stay in FOLDER. It takes some minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.parity import tables
from tests.parity.hover import hovered
from tests.parity.missions import DEPART_S, WATCHED, WINDS, flown, flown_at


def main(folder: Path) -> None:
    """Fly, and print Markdown."""
    for wind_mps, names in WINDS.items():
        parity = flown(wind_mps, folder / f"wind-{wind_mps:g}", names)
        print(f"\n## Wind {wind_mps:g} m/s\n")
        print("\n".join(tables.missions(parity)), end="\n\n")
        print("\n".join(tables.measures(parity, DEPART_S)), end="\n\n")
        if wind_mps == 0.0:
            print("### Light load\n", *tables.messages(parity, "blue/speed"), sep="\n", end="\n\n")
            print("### Operator load\n", *tables.messages(parity, f"green/{WATCHED}"), sep="\n", end="\n\n", flush=True)
    print("\n## Real sensors\n\n| measure | builtin | ArduPilot | difference |\n|---|---|---|---|")
    builtin, ardupilot = hovered(folder / "hover", "full")
    for name, value in ardupilot.items():
        print(f"| {name} | {builtin[name]:.3f} | {value:.3f} | {builtin[name] / value - 1.0:+.1%} |", flush=True)
    for rates in ("single", "reduced"):
        for wind_mps, names in WINDS.items():
            parity = flown_at(rates, wind_mps, folder / f"{rates}-{wind_mps:g}", names)
            print(f"\n## Rates {rates}, wind {wind_mps:g} m/s\n")
            print("\n".join(tables.missions(parity, ("full", rates))), end="\n\n")
            print("\n".join(tables.measures(parity, DEPART_S, ("full", rates))), end="\n\n", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
