"""Files that look like programs, made when they are needed: ELF headers with a firmware's name behind them."""

from __future__ import annotations

import struct

HELP_MARK = b"\t--speedup|-s SPEEDUP\0"
X86_64, ARM, AARCH64 = 62, 40, 183


def elf(machine: int = X86_64, *, kind: int = 3, bits: int = 64, body: bytes = b"", loaded: bool = True) -> bytes:
    """An ELF file with one program header that covers the whole of it."""
    ident = b"\x7fELF" + bytes([2 if bits == 64 else 1, 1, 1]) + bytes(9)
    header, segment, size = (64, 56, "<HHIQQQIHHHHHH") if bits == 64 else (52, 32, "<HHIIIIIHHHHHH")
    whole = header + segment + len(body)
    head = ident + struct.pack(size, kind, machine, 1, 0, header, 0, 0, header, segment, 1, 0, 0, 0)
    p_type = 1 if loaded else 2
    if bits == 64:
        program = struct.pack("<IIQQQQQQ", p_type, 5, 0, 0, 0, whole, whole, 4096)
    else:
        program = struct.pack("<IIIIIIII", p_type, 0, 0, 0, whole, whole, 5, 4096)
    return head + program + body


def firmware(name: str = "ArduCopter V4.6.3", mark: bytes = HELP_MARK) -> bytes:
    """What stands in ArduPilot's binaries: the vehicle's name and version, and the help of a build for SITL."""
    return b"\0" + name.encode() + b"\0" + name.encode() + b" (0badc0de)\0" + mark


_BASE = 0x400000


def program(says: bytes, body: bytes = b"", *, code: int = 0, hangs: bool = False) -> bytes:
    """A program for Linux on x86-64 that prints `says` and ends with `code`, or prints nothing and sleeps."""
    print_it = (
        b"\xb8\x01\0\0\0\xbf\x01\0\0\0\x48\x8d\x35\x13\0\0\0"  # mov eax, write; mov edi, 1; lea rsi, [rip + 19]
        + b"\xba" + struct.pack("<I", len(says)) + b"\x0f\x05"  # mov edx, length; syscall
        + b"\xb8\x3c\0\0\0\xbf" + struct.pack("<I", code) + b"\x0f\x05"  # mov eax, exit; mov edi, code; syscall
    )  # fmt: skip
    sleep = b"\xb8\x22\0\0\0\x0f\x05\xeb\xf7"  # mov eax, pause; syscall; again
    text = (sleep if hangs else print_it + says) + b"\0" + body
    whole = bytearray(elf(kind=2, body=text))
    header, segment = 64, 56
    struct.pack_into("<Q", whole, 24, _BASE + header + segment)  # e_entry
    struct.pack_into("<QQ", whole, header + 16, _BASE, _BASE)  # p_vaddr, p_paddr
    return bytes(whole)
