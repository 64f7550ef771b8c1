"""Kinds of plugins that a test offers for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from skyrange.contracts.plugins import registry as plugins
from skyrange.contracts.plugins.registry import Plugin


@contextmanager
def registered(*offers: tuple[str, Plugin[Any, Any]]) -> Iterator[None]:
    """Each (kind, plugin) is registered in the plugin's group inside, as are the kinds and files of the body."""
    known, files = plugins._registered, plugins._loaded_files
    before, files_before = dict(known), dict(files)
    try:
        for kind, plugin in offers:
            plugins.register(plugin.group, kind, plugin)
        yield
    finally:
        known.clear()
        known.update(before)
        files.clear()
        files.update(files_before)
