"""Types of numpy arrays by their elements, whose shapes docstrings say; and views that cannot be written to."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Words = NDArray[np.uint64]

A = TypeVar("A", bound=NDArray[Any])


def as_read_only(array: A) -> A:
    """A view of an array that cannot be written to, for those who are handed what belongs to the simulation."""
    view = array.view()
    view.flags.writeable = False
    return view
