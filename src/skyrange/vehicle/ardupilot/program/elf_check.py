"""ELF check: whether a file is a program for this machine, and what it is otherwise.

Only the headers are read (System V ABI, "ELF Header" and "Program Header"; machine numbers of its registry); nothing
is run.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

MACHINES: Final = {
    "x86_64": (64, 62), "amd64": (64, 62), "aarch64": (64, 183), "arm64": (64, 183), "armv7l": (32, 40),
    "armv6l": (32, 40), "i686": (32, 3), "i386": (32, 3), "riscv64": (64, 243), "ppc64le": (64, 21), "s390x": (64, 22),
}  # fmt: skip
"""Names that `platform.machine` returns, and the word length and `e_machine` of their programs."""

_OTHER: Final = (
    (b"#!", "a script"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\xfd7zXZ\x00", "an xz archive"),
    (b"BZh", "a bzip2 archive"),
    (b"MZ", "a Windows program"),
    (b"\xcf\xfa\xed\xfe", "a macOS program"),
    (b"\xca\xfe\xba\xbe", "a macOS program"),
    (b"<", "an HTML page or XML text"),
    (b"{", "JSON, as an .apj firmware for flight controllers is"),
    (b":", "an Intel HEX firmware for flight controllers"),
)
"""First bytes of files that are mistaken for programs."""


class _Layout(NamedTuple):
    header: struct.Struct
    """What follows `e_ident`, up to `e_shnum`."""

    segment: struct.Struct
    """One program header, up to `p_filesz`."""

    offset: int
    """Index of `p_offset` among the segment's values; `p_filesz` is three further."""


_LAYOUTS: Final = {
    32: _Layout(struct.Struct("HHIIIIIHHHHH"), struct.Struct("IIIII"), 1),
    64: _Layout(struct.Struct("HHIQQQIHHHHH"), struct.Struct("IIQQQQ"), 2),
}
_BYTE_ORDERS: Final = {1: "<", 2: ">"}
_EXECUTABLE, _SHARED_OBJECT, _CORE = 2, 3, 4
_LOADED: Final = 1


def why_not_executable(data: bytes, machine: str) -> str:
    """Why the file `data` is not a program for `machine`, a name of `MACHINES`; "" if it is one.

    For a machine that is not listed, any word length and type is accepted.
    """
    if not data.startswith(b"\x7fELF"):
        return _file_kind(data)
    bits, order = {1: 32, 2: 64}.get(_at(data, 4)), _BYTE_ORDERS.get(_at(data, 5))
    if bits is None or order is None:
        return "an ELF file with a broken header"
    layout = _LAYOUTS[bits]
    header = struct.Struct(order + layout.header.format)
    if len(data) < 16 + header.size:
        return f"an ELF program cut off after {len(data)} bytes"
    kind, number, _, _, segments_at, sections_at, _, _, step, count, section_size, sections = header.unpack_from(
        data, 16
    )
    wanted = MACHINES.get(machine.lower())
    if wanted is not None and (bits, number) != wanted:
        name = next(
            (name for name, own in MACHINES.items() if own == (bits, number)), f"ELF machine {number}, {bits} bits"
        )
        return f"a program for another machine ({name})"
    if kind not in (_EXECUTABLE, _SHARED_OBJECT):
        return "a core dump" if kind == _CORE else "an object file, not a program"
    segment = struct.Struct(order + layout.segment.format)
    end = sections_at + section_size * sections
    loaded = 0
    for index in range(count):
        at = segments_at + index * step
        if at + segment.size > len(data):
            return f"an ELF program cut off after {len(data):,} bytes"
        values = segment.unpack_from(data, at)
        loaded += values[0] == _LOADED
        end = max(end, values[layout.offset] + values[layout.offset + 3])
    if end > len(data):
        return f"an ELF program cut off after {len(data):,} of at least {end:,} bytes"
    return "" if loaded else "an ELF file with nothing to run"


def _at(data: bytes, index: int) -> int:
    return data[index] if index < len(data) else -1


def _file_kind(data: bytes) -> str:
    """The kind of a file that is not ELF."""
    start = data[:512].lstrip()
    if not data:
        return "an empty file"
    return next((name for magic, name in _OTHER if start.startswith(magic)), "a file that is not a program")
