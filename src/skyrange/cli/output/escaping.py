"""Escapes of characters that control a terminal."""

from __future__ import annotations

from unicodedata import category

_HARMLESS = "\n\t\u200c\u200d"
"""Characters of the categories below that are printed: breaks, and the joiners that some scripts need."""
_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Control, format (such as a change of the writing direction), half characters, line and paragraph separators."""


def escape(text: str) -> str:
    r"""`text` without characters that control a terminal; each is shown as `\xNN`, `\uNNNN` or `\UNNNNNNNN`."""
    if text.isprintable():
        return text
    return "".join(_escape_character(character) if is_control(character) else character for character in text)


def is_control(character: str) -> bool:
    """Whether a character controls the terminal, or is only half of one."""
    return category(character) in _CATEGORIES and character not in _HARMLESS


def _escape_character(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is not UTF-8 (PEP 383)
        code -= 0xDC00
    return f"\\x{code:02x}" if code <= 0xFF else f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"
