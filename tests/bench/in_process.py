"""Measurements in the process of the test: quicker than in processes of their own, and as good for all but speed."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import pytest


def measure_here(monkeypatch: pytest.MonkeyPatch, *modules: Any) -> None:
    """Let `modules` of `skyrange.bench` call what they would run in a process of its own; that keeps its processors."""
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: None)

    def call(name: str, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        return function(*arguments, **keywords)

    for module in modules:
        monkeypatch.setattr(module, "run_in_process", call)
