# SPDX-License-Identifier: BSD-3-Clause
"""Two stages on one machine, each in its namespace, track side by side."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import pytest

from piezo_client.client import GoalFailed
from piezo_client.references import harmonic
from piezo_client.stage import Stage
from piezo_controller.feedback.controller_file import save_controller
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

ENOUGH = "the other run has ended"
COUNTS_S = 0.3
"""Of stage time: the longer run has an error that means something."""
GOES_ON_S = 3600.0
"""Of stage time: longer than the other run takes on any machine, which ends this one."""


@pytest.fixture(scope="module")
def files(near_model, near_controller, tmp_path_factory):
    """Directory of a model and its law: the other stage moves on while a run is prepared."""
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(near_model, (-20.0, 120.0)))
    save_controller(directory / "law.json", near_controller)
    return directory


@pytest.fixture(scope="module")
def right(nodes):
    """Client of a second stage, with a noise of its own."""
    return nodes.start("recorder", "controller", namespace="/right", seed=2)


def test_two_stages_track_different_references_at_the_same_time(suite, right, files, tmp_path):
    moves, ended = Event(), Event()
    model, law = str(files / "model.json"), str(files / "law.json")

    def track_right(stage):
        def tell(feedback):
            if feedback.stage == "play" and feedback.fraction * GOES_ON_S > COUNTS_S:
                moves.set()

        try:
            with pytest.raises(GoalFailed, match=ENOUGH) as failure:
                stage.client.track(
                    harmonic(200.0, 20.0, 50.0), model, "composite", GOES_ON_S, tmp_path / "right",
                    controller=law, on_feedback=tell,
                    why_stop=lambda: ENOUGH if ended.is_set() else "")
        finally:
            moves.set()  # else the other waits for ever
        return failure.value.result

    def track_left(stage):
        try:
            moves.wait()
            return stage.client.track(
                harmonic(100.0, 20.0, 50.0), model, "composite", 0.25, tmp_path / "left",
                controller=law)
        finally:
            ended.set()

    def track_side_by_side(of_left, of_right):
        with ThreadPoolExecutor() as threads:
            runs = [threads.submit(track_left, of_left), threads.submit(track_right, of_right)]
            return [run.result() for run in runs]

    # Made in the main thread: elsewhere a client takes a busy computer for a standstill.
    with Stage("/left") as of_left, Stage("/right") as of_right:
        runs = suite.beside(right.beside, track_side_by_side, of_left, of_right)
    for side, run in zip(("left", "right"), runs, strict=True):
        assert Path(run.recording).parent == tmp_path / side
        assert read_recording(run.recording).gaps == []
        assert run.e_rms_percent < 0.5
        assert run.missed_feedback == 0
