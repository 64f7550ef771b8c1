"""Opening of a log by its content, whatever it is called."""

from __future__ import annotations

from pathlib import Path

from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.log_detection.observed_log import ObservedLog


def open_log(file: Path | str) -> ObservedLog:
    """The log in a file or a run's folder. Raises `InputError` for what is missing or is no log."""
    path = expand_user(file)
    if path.is_dir():
        from skyrange.log_detection.run_folder import RunLog

        return RunLog(path)
    raise InputError.one(str(path), "file", "a file", "the folder of a run")
