# SPDX-License-Identifier: BSD-3-Clause
"""The modes of several axes, sample by sample."""

import numpy as np
from numba import njit

from piezo_common.arrays import ComplexArray, FloatArray


@njit(cache=True, nogil=True)
def run_modes(
    drive_v: FloatArray, strengths: FloatArray, steps: ComplexArray, residues: ComplexArray,
    elongations: ComplexArray, gain: FloatArray, state: ComplexArray, motion_um: FloatArray,
) -> None:
    """Compute the motion of the modes under a drive.

    Parameters
    ----------
    drive_v : (N, n) array
        Drive in V relative to the operating point.
    strengths : (N, P) array
        Strengths of the parts of the softening at each sample.
    steps : (K,) array of complex
        Factor of each mode from one sample to the next.
    residues, elongations : (K, n, n) and (P, K, n, n) array of complex
        Residues of the motion and of the softening; doubled for complex modes, as the real part of
        the sum is taken.
    gain : (P, n, n) array
        Gain of the softening.
    state : (K, n) array of complex
        State at the first sample, one copy of the modes for each driven axis; overwritten.
    motion_um : (N, n) array
        Displacement in um; overwritten.
    """
    samples, axes = drive_v.shape
    force_v = np.empty(axes)
    for sample in range(samples):
        for i in range(axes):
            motion = 0.0
            for mode in range(steps.size):
                for j in range(axes):
                    motion += (residues[mode, i, j] * state[mode, j]).real
            motion_um[sample, i] = motion
        force_v[:] = drive_v[sample]
        for part in range(strengths.shape[1]):
            for i in range(axes):
                back = 0.0
                for j in range(axes):
                    back += gain[part, i, j] * drive_v[sample, j]
                    for mode in range(steps.size):
                        back += (elongations[part, mode, i, j] * state[mode, j]).real
                force_v[i] -= strengths[sample, part] * back
        for mode in range(steps.size):
            for j in range(axes):
                state[mode, j] = steps[mode] * state[mode, j] + force_v[j]
