# SPDX-License-Identifier: BSD-3-Clause
"""The deviation of the response between the frequencies of the coupling is that of drawn models."""

from dataclasses import replace

import numpy as np

from piezo_models import CoupledModel, Coupling, IdentifiedAxes

PERIOD_S = 1e-3
POLES = np.array([-4.0 + 600.0j, -30.0 + 1200.0j, -200.0 + 0.0j])
POLE_DEVIATIONS = np.array([0.3 + 0.5j, 1.0 + 2.0j, 5.0 + 0.0j])
RESIDUES = np.array([[[0.01 - 0.05j, 0.002j], [0.001, -0.04j]], [[0.002, 0.01], [0.01j, 0.02]],
                     [[0.03, 0.0], [0.001, 0.02]]])
RESIDUE_DEVIATIONS = np.where(np.arange(3)[:, None, None] < 2, 1e-4 + 2e-4j, 1e-4)
DRAWN = 400


def test_the_deviation_follows_that_of_drawn_models():
    model = CoupledModel(("x", "y"), PERIOD_S, POLES, RESIDUES, np.zeros((1, 2, 2)),
                         np.zeros(2, int), np.zeros(2), np.zeros(2))
    rng = np.random.default_rng(1)

    def normal(deviations):
        return (deviations.real * rng.normal(size=deviations.shape)
                + 1j * deviations.imag * rng.normal(size=deviations.shape))

    frequency_hz = np.array([0.0, 20.0, 94.5, 95.5, 130.0, 191.0, 400.0])
    drawn = np.array([
        replace(model, poles_rad_per_s=POLES + normal(POLE_DEVIATIONS),
                residues_um_per_v=RESIDUES + normal(RESIDUE_DEVIATIONS)).response(frequency_hz)
        for _ in range(DRAWN)])
    spread = np.sqrt(np.mean(np.abs(drawn - model.response(frequency_hz)) ** 2, axis=0))
    unscaled = IdentifiedAxes(
        model, np.zeros((2, 2)), Coupling(np.array([1.0, 450.0]), np.ones((2, 2, 2), complex),
                                          np.zeros((2, 2, 2), complex)),
        POLE_DEVIATIONS, RESIDUE_DEVIATIONS, np.zeros(2), np.zeros(2))
    found = unscaled._deviation_of_modes(frequency_hz)
    np.testing.assert_allclose(found, spread, rtol=0.2)
    # The coupling says at some frequencies that it is half as much; so it is between them.
    known_hz = np.array([10.0, 95.0, 300.0])
    halved = replace(unscaled, coupling=Coupling(
        known_hz, model.response(known_hz), 0.5 * unscaled._deviation_of_modes(known_hz) + 0.0j))
    np.testing.assert_allclose(
        halved.response_deviation_um_per_v(frequency_hz), 0.5 * found, rtol=1e-9)
