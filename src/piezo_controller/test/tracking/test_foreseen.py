# SPDX-License-Identifier: BSD-3-Clause
"""What a mode without an inverse will not follow is known before the stage moves."""

import numpy as np
import pytest

from piezo_controller.feedforward.feasibility import UnreachableReference
from piezo_controller.references.reference import Reference
from piezo_controller.tracking.feedbacks import Feedbacks, FeedbackSettings
from piezo_controller.tracking.foreseen import foreseen_share
from piezo_controller.tracking.track import TrackRequest, prepare
from piezo_controller.tracking.tracking_modes import StageClock

STAGE = StageClock()
PERIOD_S = 25e-6


class Unheard:
    """Nobody is told of the preparation."""

    def begin(self, step):
        pass

    def watch(self, fraction):
        pass


@pytest.fixture(scope="module")
def prepared_in(model_path):
    feedbacks = Feedbacks(FeedbackSettings(), STAGE)

    def prepared_in(mode, frequency_hz, amplitude_um):
        reference = Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0)
        return prepare(TrackRequest(mode, str(model_path), "0" * 64, [reference], [0.1]), STAGE,
                       feedbacks, Unheard())

    return prepared_in


def test_share_is_that_of_a_response_known_in_closed_form():
    # A first-order lag of 100 Hz leaves jw / (jw + w0) of each sine.
    time_s = np.arange(8000) * PERIOD_S
    period_um = 50 + 3 * np.sin(2 * np.pi * 100 * time_s) + 2 * np.cos(2 * np.pi * 500 * time_s)
    share = foreseen_share(period_um, PERIOD_S, lambda hz: 1j * hz / (1j * hz + 100.0))
    powers = {100.0: 9.0, 500.0: 4.0}
    left = sum(power * hz**2 / (hz**2 + 100.0**2) for hz, power in powers.items())
    assert share == pytest.approx(np.sqrt(left / 13.0), rel=1e-9)


def test_reference_that_stands_still_leaves_nothing():
    assert foreseen_share(np.full(400, 50.0), PERIOD_S, lambda hz: np.ones(hz.size)) == 0.0


@pytest.mark.parametrize("mode", ["open_loop", "pid", "pi"])
def test_reference_far_beyond_the_band_is_refused_as_for_composite(prepared_in, mode):
    with pytest.raises(UnreachableReference, match="um peak to peak is within reach") as refused:
        prepared_in(mode, 3000.0, 40.0)
    with pytest.raises(UnreachableReference) as of_composite:
        prepared_in("composite", 3000.0, 40.0)
    assert refused.value.reachable_um == of_composite.value.reachable_um
    assert 0.0 < refused.value.reachable_um < 40.0


@pytest.mark.parametrize("mode", ["open_loop", "pid"])
@pytest.mark.parametrize("frequency_hz", [10.0, 1000.0])
def test_what_the_inverse_follows_is_played_in_every_mode(prepared_in, mode, frequency_hz):
    assert prepared_in(mode, frequency_hz, 10.0).run.total_samples > 0
