"""Linear recursions with a transition of their own at every step, without a Python loop over the steps."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_AT_ONCE = 1 << 16  # rows: what a pass needs stays in the processor's cache, and memory bounded


def linear_recursion(transition: Floats, forcing: Floats, initial: Floats) -> Floats:
    """x[k] = transition[k] x[k-1] + forcing[k] for all k, x[-1] = initial.

    Blocks of steps are run side by side from rest, each with the product of its transitions; a pass over the blocks
    then adds what each inherits. Nothing is divided, so stable transitions give rounding errors only.

    Parameters
    ----------
    transition : array, (k, n, n)
    forcing : array, (k, n)
    initial : array, (n,)

    Returns
    -------
    array, (k, n)
    """
    out = np.empty_like(forcing)
    state = initial
    for first in range(0, len(forcing), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        out[part] = _in_blocks(transition[part], forcing[part], state)
        state = out[part][-1]
    return out


def _in_blocks(transition: Floats, forcing: Floats, initial: Floats) -> Floats:
    rows, n = forcing.shape
    length = math.isqrt(rows)
    blocks = -(-rows // length)
    padded = np.zeros((blocks * length, n, n + 1))  # the last block is filled up with zeros, cut off at the end
    padded[:rows, :, :n], padded[:rows, :, n] = transition, forcing
    steps = padded.reshape(blocks, length, n, n + 1).swapaxes(0, 1).copy()  # by step, then by block
    passed = np.empty_like(steps)  # the product of a block's transitions up to a step, and its response from rest
    passed[0] = steps[0]
    for j in range(1, length):
        np.matmul(steps[j, ..., :n], passed[j - 1], out=passed[j])
        passed[j, ..., n] += steps[j, ..., n]
    inherited = np.empty((blocks, n))
    state = initial
    for i in range(blocks):
        inherited[i] = state
        state = passed[-1, i, :, :n] @ state + passed[-1, i, :, n]
    out = np.einsum("jbik,bk->bji", passed[..., :n], inherited) + passed[..., n].swapaxes(0, 1)
    return np.asarray(out.reshape(blocks * length, n)[:rows])
