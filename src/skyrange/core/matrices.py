"""Products of matrices, linear equations and Cholesky factors with the same bits on every machine, for small matrices.

numpy leaves them to a BLAS library, which chooses its code, and with it the order of additions, by processor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled


def multiply(first: ArrayLike, *others: ArrayLike) -> Floats:
    """The product of matrices from left to right, as `@`: of vectors too, and of stacks of matrices."""
    product = np.asarray(first, dtype=np.float64)
    for other in others:
        product = _multiply_two(product, np.asarray(other, dtype=np.float64))
    return product


def dot(first: ArrayLike, second: ArrayLike) -> float:
    """The scalar product of two vectors."""
    total = 0.0
    for a, b in zip(np.asarray(first).tolist(), np.asarray(second).tolist(), strict=True):
        total += a * b
    return total


def solve(matrix: ArrayLike, right: ArrayLike) -> Floats:
    """X of `matrix` (n, n) times x = `right`, (n,) or (n, m); infinite or NaN for a singular matrix."""
    both = np.array(matrix, dtype=np.float64)
    columns = np.array(right, dtype=np.float64)
    shape = columns.shape
    columns = np.ascontiguousarray(columns.reshape(len(both), -1))
    _eliminate(both, columns)
    return columns.reshape(shape)


def invert(matrix: ArrayLike) -> Floats:
    """The inverse of a matrix (n, n); infinite or NaN for a singular one."""
    return solve(matrix, np.eye(len(np.asarray(matrix))))


def factor(matrix: ArrayLike) -> Floats:
    """The lower Cholesky factor of a symmetric positive definite matrix (n, n); NaN for another."""
    given = np.array(matrix, dtype=np.float64)
    lower = np.zeros_like(given)
    _factor(given, lower)
    return lower


def _multiply_two(first: Floats, second: Floats) -> Floats:
    one = first[None, :] if first.ndim == 1 else first
    other = second[:, None] if second.ndim == 1 else second
    rows, inner, columns = one.shape[-2], one.shape[-1], other.shape[-1]
    if other.shape[-2] != inner:
        raise ValueError(f"matrices of shapes {first.shape} and {second.shape} have no product")
    stack: tuple[int, ...] = ()
    if one.ndim > 2 or other.ndim > 2:
        stack = np.broadcast_shapes(one.shape[:-2], other.shape[:-2])
        one = np.broadcast_to(one, (*stack, rows, inner))
        other = np.broadcast_to(other, (*stack, inner, columns))
    count = math.prod(stack)
    out = np.empty((count, rows, columns))
    # copies, because a kernel for arrays that are read-only or not contiguous would be another one
    _multiply_all(
        np.array(one, order="C").reshape(count, rows, inner),
        np.array(other, order="C").reshape(count, inner, columns),
        out,
    )
    shape = (*stack, *((rows,) if first.ndim > 1 else ()), *((columns,) if second.ndim > 1 else ()))
    return out.reshape(shape)


@compiled
def _multiply_all(first: Floats, second: Floats, out: Floats) -> None:
    for n in range(out.shape[0]):
        for i in range(out.shape[1]):
            for j in range(out.shape[2]):
                total = 0.0
                for k in range(first.shape[2]):
                    total += first[n, i, k] * second[n, k, j]
                out[n, i, j] = total


@compiled
def _eliminate(matrix: Floats, right: Floats) -> None:
    """Gaussian elimination with partial pivoting; the solution is left in `right`."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(right.shape[1]):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(k + 1, n):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k, n):
                matrix[i, j] -= share * matrix[k, j]
            for j in range(right.shape[1]):
                right[i, j] -= share * right[k, j]
    for i in range(n - 1, -1, -1):
        for j in range(right.shape[1]):
            total = right[i, j]
            for k in range(i + 1, n):
                total -= matrix[i, k] * right[k, j]
            right[i, j] = total / matrix[i, i]


@compiled
def _factor(matrix: Floats, lower: Floats) -> None:
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                lower[i, i] = math.sqrt(total) if total > 0.0 else math.nan
            else:
                lower[i, j] = total / lower[j, j]
