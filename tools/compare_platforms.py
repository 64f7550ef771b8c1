"""Comparison of digests of shipped scenarios between kinds of processor and library, as one machine can pretend to be.

`python -m tools.compare_platforms [--kinds native,old-libraries] [NAME …]` flies shipped scenarios, all of them unless
named, once for each kind, each in a process of its own, and prints which of the three digests of a run agree. It exits
with 1 if any differ. `--write FILE` writes the digests as JSON, to compare with those of another machine by
`--with FILE`.

A kind is a set of environment variables. Those of numba choose what LLVM compiles for and need their own kernels, which
take minutes; the others choose the code of numpy, of the C library and of OpenBLAS.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

KINDS: dict[str, dict[str, str]] = {
    "native": {},
    "other-interpreter": {},
    "old-libraries": {
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2_Usable,-AVX2,-FMA_Usable,-FMA,-FMA4",
        "OPENBLAS_CORETYPE": "Nehalem",
    },
    "avx2": {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": "+avx2,+fma,+sse4.2",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Haswell",
    },
    "sse2": {
        "NUMBA_CPU_NAME": "x86-64",
        "NUMBA_CPU_FEATURES": "+sse2",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2_Usable,-AVX2,-FMA_Usable,-FMA,-FMA4",
        "OPENBLAS_CORETYPE": "Nehalem",
    },
}
"""Environment variables by kind. `--python` names the interpreter of all kinds but `native`."""

FLY = """
import json, sys
from pathlib import Path
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
name, folder, *changes = sys.argv[1:]
record = fly(load(name, changes), Path(folder) / "run", report=False)
print(json.dumps(record.manifest["digests"]))
"""

Digests = dict[str, dict[str, str]]


def main(
    names: Annotated[list[str] | None, typer.Argument(help="Shipped scenarios.")] = None,
    kinds: Annotated[str, typer.Option(help=f"Of {', '.join(KINDS)}.")] = "native,old-libraries",
    python: Annotated[str, typer.Option(help="Another interpreter with skyrange, for all kinds but native.")] = "",
    change: Annotated[list[str] | None, typer.Option(help="A change of the scenarios.")] = None,
    write: Annotated[Path | None, typer.Option(help="Write the digests of the first kind.")] = None,
    compare_with: Annotated[Path | None, typer.Option("--with", help="Compare with these digests too.")] = None,
) -> None:
    """Fly shipped scenarios on several kinds of processor and library, and compare their digests."""
    from skyrange.scenario.shipped import SHIPPED

    chosen = kinds.split(",")
    if wrong := [kind for kind in chosen if kind not in KINDS]:
        raise typer.BadParameter(f"{wrong[0]}: expected one of {', '.join(KINDS)}", param_hint="--kinds")
    if wrong := [name for name in names or () if name not in SHIPPED]:
        raise typer.BadParameter(f"{wrong[0]}: expected a shipped scenario", param_hint="NAMES")
    found: dict[str, Digests] = {kind: {} for kind in chosen}
    if compare_with is not None:
        found[str(compare_with)] = json.loads(compare_with.read_text())
    differing = 0
    for name in names or sorted(SHIPPED):
        for kind in chosen:
            interpreter = python if python and kind != "native" else sys.executable
            found[kind][name] = _fly(name, kind, interpreter, change or [])
        wrong = [what for what in ("events", "frames", "truth") if len({one[name][what] for one in found.values()}) > 1]
        differing += bool(wrong)
        print(f"{name}: {'differs in ' + ', '.join(wrong) if wrong else 'the same'}", flush=True)
        if wrong:
            for kind, digests in found.items():
                print(f"    {kind}: {digests[name]}")
    if write is not None:
        write.write_text(json.dumps(found[chosen[0]], indent=1) + "\n")
    print(f"{platform.machine()}, {', '.join(found)}: {differing} differ")
    raise typer.Exit(1 if differing else 0)


def _fly(name: str, kind: str, python: str, changes: list[str]) -> dict[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [python, "-c", FLY, name, folder, *changes],
            env={**os.environ, **KINDS[kind]},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    digests: Any = json.loads(done.stdout.splitlines()[-1])
    return {what: str(digests[what]) for what in ("events", "frames", "truth")}


if __name__ == "__main__":
    typer.run(main)
