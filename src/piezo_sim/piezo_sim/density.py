# SPDX-License-Identifier: BSD-3-Clause
"""Continuous Preisach density and its integral over a triangle, in closed form.

With span d = alpha - beta and middle m = (alpha + beta) / 2 the density is

    mu(alpha, beta) = (broad + ridge exp(-d / width)) (1 + modulation cos(k (m - centre))),

a product of a function of the span and a function of the middle, hence not a sum
f(alpha) + g(beta). The integral over the triangle beta <= beta' <= alpha' <= alpha keeps the form:
E = G0(d) + modulation cos(k (m - centre)) G1(d), with G1(d) = 2/k int_0^d g(x) sin(k (d - x)/2) dx
for a density profile g(x) in the span.
"""

import math

from numba import njit


@njit(cache=True)
def density_um_per_v2(alpha_v, beta_v, broad, ridge, width_v, modulation, centre_v, period_v):
    """Preisach density at (alpha, beta), alpha >= beta (mu of thesis eq. (4.2))."""
    span = alpha_v - beta_v
    middle = 0.5 * (alpha_v + beta_v)
    profile = broad + ridge * math.exp(-span / width_v)
    return profile * (1.0 + modulation * math.cos(2.0 * math.pi / period_v * (middle - centre_v)))


@njit(cache=True)
def everett_um(alpha_v, beta_v, broad, ridge, width_v, modulation, centre_v, period_v):
    """Integral of the density over the triangle between beta and alpha, um."""
    span = alpha_v - beta_v
    middle = 0.5 * (alpha_v + beta_v)
    wavenumber = 2.0 * math.pi / period_v
    half = 0.5 * wavenumber
    phase = half * span
    sine = math.sin(phase)
    cosine = math.cos(phase)
    decay_less_one = math.expm1(-span / width_v)
    rate = 1.0 / width_v

    uniform = 0.5 * broad * span * span + ridge * width_v * (span + width_v * decay_less_one)
    broad_wave = broad * (1.0 - cosine) / half
    ridge_wave = (
        ridge
        * (half * (decay_less_one + (1.0 - cosine)) + rate * sine)
        / (half * half + rate * rate)
    )
    wave = (broad_wave + ridge_wave) / half
    return uniform + modulation * math.cos(wavenumber * (middle - centre_v)) * wave
