"""Does simulated code leave functions to libraries that round as they please? It has those of `core.elementary`."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import skyrange

ROOT = Path(skyrange.__file__).parent
SIMULATED = (
    "assembly", "attack", "codec/f3411", "codec/f3548", "codec/mavlink", "core", "defence", "detect", "fault", "gcs",
    "kernel", "optics", "radio", "remoteid", "runtime/cores", "scenario", "utm", "vehicle/avoidance", "vehicle/builtin",
    "vehicle/claimed_tracks.py", "vehicle/companion", "vehicle/event_detection.py", "vehicle/landing",
    "vehicle/reported_poses.py", "vehicle/sight", "world",
)  # fmt: skip
"""What `frames` and `truth` depend on."""
ROUNDED = frozenset(
    [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "arcsin",
        "arccos",
        "arctan",
        "arctan2",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "exp2",
        "expm1",
        "log",
        "log2",
        "log10",
        "log1p",
        "pow",
        "power",
        "float_power",
        "hypot",
        "dist",
        "erf",
        "erfc",
        "gamma",
        "lgamma",
        "cbrt",
        "logaddexp",
        "dot",
        "vdot",
        "inner",
        "matmul",
        "einsum",
        "tensordot",
        "linalg",
        "interp",
        "convolve",
        "sumprod",
    ]
)
SUSPECT = re.compile(
    rf"\*\*|\b(math|np)\.({'|'.join(ROUNDED)})\b|^from (math|numpy) import| @ | @= |\bsum\(|@compiled|@inlined",
    re.MULTILINE,
)
DELIBERATE = {
    "fault/gnss/multipath.py": {"linalg": "the condition number only says whether directions give a fix at all"},
    "detect/series.py": {"sum": "of arrays, which Python adds in order"},
    "runtime/cores/run.py": {"sum": "of megabytes of memory"},
}  # fmt: skip
"""By file, what it uses nevertheless, and why no bit depends on it."""
WHOLE = frozenset(
    [
        "attack/bases/gnss/takeover.py", "codec/mavlink/frames.py", "codec/mavlink/message_columns.py",
        "defence/gnss/dead_reckoning.py", "gcs/plan/routes.py", "kernel/wiring.py",
        "radio/control_link/channel_changes.py", "radio/control_link/wifi_link.py",
        "radio/propagation/loss_table_file.py", "runtime/cores/division.py", "utm/hashgraph/graph.py",
        "vehicle/builtin/control/motor_control.py",
    ]
)  # fmt: skip
"""Files whose sums are of whole numbers."""


def found_in(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of what a source leaves to a library."""
    if SUSPECT.search(source) is None:
        return
    tree = ast.parse(source)
    compiled = [
        range(node.lineno, (node.end_lineno or node.lineno) + 1)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(isinstance(one, ast.Name) and one.id in {"compiled", "inlined"} for one in node.decorator_list)
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module in {"math", "numpy"}:
            yield from ((node.lineno, name.name) for name in node.names if name.name in ROUNDED)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "sum":
            if not counts(node.args[0]):
                yield node.lineno, "sum"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in {"math", "np"}:
            if node.attr in ROUNDED:
                yield node.lineno, node.attr
        elif isinstance(node, ast.Name) and node.id in {"elementary_python", "elementwise"}:
            if any(node.lineno in lines for lines in compiled):
                yield node.lineno, node.id  # numba cannot compile them
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            yield node.lineno, "@"
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and not is_exact(node, compiled):
            yield node.lineno, "**"


def counts(summed: ast.expr) -> bool:
    """Whether what is summed is evidently whole: lengths, truths, ones and bits."""
    if isinstance(summed, ast.GeneratorExp):
        return is_whole(summed.elt)
    return isinstance(summed, ast.Call) and ast.unparse(summed).startswith("map(len, ")


def is_whole(value: ast.expr) -> bool:
    """Whether a value is evidently whole."""
    match value:
        case ast.Compare() | ast.Constant(value=int()):
            return True
        case ast.BinOp(op=ast.LShift()):
            return True
        case ast.BoolOp():
            return all(map(is_whole, value.values))
        case ast.Call(func=ast.Name(id=name)):
            return name in {"int", "len", "isinstance"}
    return False


def is_exact(node: ast.BinOp, compiled: list[range]) -> bool:
    """Whether a power is one of 2 or of a whole number, or a square or cube in `compiled` lines, which multiply."""
    base = node.left.operand if isinstance(node.left, ast.UnaryOp) else node.left
    if isinstance(base, ast.Constant) and (isinstance(base.value, int) or base.value == 2.0):
        return True
    within = any(node.lineno in lines for lines in compiled)
    return within and isinstance(node.right, ast.Constant) and node.right.value in {2, 3}


def test_simulated_code_uses_functions_with_the_same_bits_everywhere() -> None:
    files = [
        file for part in SIMULATED for file in ([ROOT / part] if part.endswith(".py") else (ROOT / part).rglob("*.py"))
    ]
    assert len(files) > 300
    wrong = [
        f"{file.relative_to(ROOT)}:{line}: {name}"
        for file in files
        for line, name in found_in(file.read_text(encoding="utf-8"))
        if name not in DELIBERATE.get(str(file.relative_to(ROOT)), {})
        if name != "sum" or str(file.relative_to(ROOT)) not in WHOLE
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("math.sin(x)", "sin"), ("np.hypot(x, y)", "hypot"), ("a @ b", "@"), ("x ** 2", "**"), ("x ** 0.4", "**"),
        ("from math import exp", "exp"), ("np.linalg.norm(x)", "linalg"), ("0.5 ** n", "**"),
        ("sum(values)", "sum"), ("sum(x * x for x in values)", "sum"),
        ("@compiled\ndef f(x):\n    return elementwise.sin(x)", "elementwise"),
    ],
)  # fmt: skip
def test_it_finds_them(line: str, name: str) -> None:
    assert [found for _, found in found_in(line)] == [name]


@pytest.mark.parametrize(
    "line",
    [
        "2 ** 31",
        "2.0 ** -23",
        "math.sqrt(x)",
        "x * x",
        "sum(map(len, x))",
        "sum(a < b for a in x)",
        "sum(len(a) for a in x)",
        "@compiled\ndef f(x):\n    return x ** 2",
    ],
)
def test_it_lets_exact_ones_be(line: str) -> None:
    assert list(found_in(line)) == []
