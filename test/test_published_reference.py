# SPDX-License-Identifier: BSD-3-Clause
"""A stage follows what another node publishes while it does."""

import math
from pathlib import Path

import numpy as np
import pytest
from piezo_interfaces.msg import Reference, ReferenceSamples, SampleBlock
from rosbags.highlevel import AnyReader

from piezo_controller.references import reference as references
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

TICK = 40
PREVIEW = 20
WAY = references.Reference("random", (100.0,), (10.0,), (), 50.0, seed=8)
CENTRE_UM = 50.0
LIVE = Reference(kind="topic", frequency_hz=[100.0], amplitude_um=[10.0], centre_um=CENTRE_UM)


class Publisher:
    """Publishes a way tick by tick, for each tick that the stage has measured."""

    def __init__(self, client):
        self._client = client
        self._way = references.trajectory(WAY)
        self._publisher = client.node.create_publisher(ReferenceSamples, "reference", 2000)
        self.sent = self.ticks = 0
        self.silent_after = self.jumps_after = math.inf
        client.answer = self._on_block

    def publish(self):
        """Publish the next values."""
        self._publisher.publish(ReferenceSamples(
            first_sample=self.sent, preview_samples=PREVIEW,
            displacement_um=[1e308] * TICK if self.ticks > self.jumps_after else
            (self._way.sample(self.sent, TICK) - CENTRE_UM).tolist()))
        self.sent += TICK

    def _on_block(self, block):
        if block.flags & SampleBlock.FLAG_TRACKING:
            for _ in range(len(block.voltage_v) // TICK):  # several where nobody has to answer
                self.ticks += 1
                if self.ticks < self.silent_after:
                    self.publish()
        return None

    def end(self):
        """Publish nothing any more."""
        self._client.node.destroy_publisher(self._publisher)
        self._client.answer = None

    def follow(self, model, directory, mode, duration_s):
        """Send the goal, and publish the first values until the stage moves."""
        self.ticks = 0
        handle = self._client.send("track", reference=LIVE, model=str(model), mode=mode,
                                   duration_s=duration_s, directory=str(directory))
        outcome = handle.get_result_async()
        while not (self.ticks or outcome.done()):
            self.sent = 0
            self.publish()
            self._client.spin_until(lambda: self.ticks or outcome.done(), 0.1)
        return self._client.wait(outcome).result


@pytest.fixture
def model(near_model, tmp_path):
    save_model(tmp_path / "model.json", IdentifiedModel(near_model, (-20.0, 120.0)))
    return tmp_path / "model.json"


@pytest.fixture(scope="module")
def client(nodes):
    """Client of a stage in lockstep, whose reference a test publishes."""
    return nodes.start("recorder", "controller", namespace="/published")


@pytest.fixture
def publisher(client):
    publisher = Publisher(client)
    yield publisher
    publisher.end()


def test_published_reference_beyond_its_declaration_stops_the_stage_at_rest(
        client, publisher, model, tmp_path):
    publisher.jumps_after = 220
    client.forget()
    followed = publisher.follow(model, tmp_path, "feedforward", 0.5)
    assert followed.degraded and not followed.success
    assert "beyond its declared 10 um about 50 um" in followed.degraded_reason
    # Behind it stands what was left out meanwhile, which depends on the speed of the machine.
    assert followed.degraded_reason.startswith(followed.message)
    played = client.samples()
    highest = int(played.displacement_um.argmax())
    assert played.displacement_um[highest] < CENTRE_UM + 6.0, (
        f"at sample {highest} of {played.voltage_v.size}, with "
        f"{played.voltage_v[max(highest - 200, 0) : highest + 10 : 10]} V before it")
    assert played.voltage_v[-1] == 0.0


def test_published_reference_is_followed_and_held_where_its_publisher_falls_silent(
        publisher, model, tmp_path):
    publisher.silent_after = 220
    # Long enough that it is held at the end, however long after its values the stage follows.
    followed = publisher.follow(model, tmp_path, "composite", 0.5)
    # What was held counts as no success, although it was played to its end.
    assert followed.degraded and not followed.success
    assert followed.e_rms_percent < 1.0
    assert "followed the reference" in followed.message
    assert "it was held, as nothing was published" in followed.degraded_reason
    recording = read_recording(followed.recording)
    assert recording.gaps == []
    with AnyReader([Path(followed.recording)]) as reader:
        kept = [reader.deserialize(data, connection.msgtype).first_sample
                for connection, _, data in reader.messages()
                if connection.topic == "/published/reference"]
    # The beginning is published until the stage moves, or the recording begins behind it.
    once = kept[max(kept.count(0) - 1, 0):]
    assert len(once) > 200 and set(np.diff(once)) == {TICK}
    # Means of ticks, whose noise does not count.
    moving_um, held_um = (
        recording.displacement_um[recording.tracking][piece].reshape(-1, TICK).mean(axis=1)
        for piece in (slice(6000, 8000), slice(-2000, None)))
    assert np.ptp(held_um) < 0.1 < 1.0 < np.ptp(moving_um)
