# SPDX-License-Identifier: BSD-3-Clause
"""Start the real nodes as processes, and talk to them as any client would."""

import array
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import count, pairwise
from multiprocessing import forkserver
from pathlib import Path

import numpy as np
import pytest
from forked_processes import ForkedProcesses
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import LoadFeedforward, StartRecording, StartTracking, StopRecording
from replaced import replaced
from short_design import FEW_SCALINGS
from std_srvs.srv import Trigger

from piezo_bringup.processes import USUAL_NODES, Processes
from piezo_client import client as client_module
from piezo_client import overview
from piezo_client.client import Client, GoalFailed
from piezo_client.stage import Stage
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import RecordingError
from piezo_ros.quality import FEEDBACK, SAMPLES

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from probes import write_endless_probe, write_short_probe

TIMEOUT_S = 300.0
PATIENT = {"lockstep_timeout_s": 60.0, "exchange_timeout_s": 60.0,
           "emergency_stop_timeout_s": 60.0}
"""Parameters of a stage that does not take a busy computer for a client or backend that hangs."""
NEAR_CELLS = 50


class Samples:
    """Published blocks, joined sample by sample."""

    def __init__(self, blocks):
        self.blocks = blocks
        self.first_sample = blocks[0].first_sample
        shape = (-1, len(blocks[0].axes)) if blocks[0].axes else (-1,)
        self.voltage_v, self.displacement_um = (
            np.concatenate([getattr(block, name) for block in blocks]).reshape(shape)
            for name in ("voltage_v", "displacement_um"))
        self.flags = np.repeat([block.flags for block in blocks], list(map(length, blocks)))

    @property
    def gapless(self):
        """Whether every block begins where the one before it ended."""
        return all(end(block) == following.first_sample
                   for block, following in pairwise(self.blocks))

    def since(self, first_sample, count=None):
        """Voltages from a sample of the clock on."""
        begin = first_sample - self.first_sample
        return self.voltage_v[begin:None if count is None else begin + count]

    def flagged(self, flag):
        """Voltages of the blocks that bear a flag."""
        return self.voltage_v[self.flags & flag > 0]


def end(block):
    """The sample of the clock behind a block."""
    return block.first_sample + length(block) * round(block.sample_period_s * 40_000)


def length(block):
    """How many samples a block holds, of all axes."""
    return len(block.voltage_v) // max(1, len(block.axes))


def holds(path, topic, sample):
    """Tell whether a recording holds a sample of a topic."""
    try:
        return sample in read_recording(path, topic=topic, several_axes=True).sample_index
    except RecordingError:  # nothing of the topic
        return False


def at_rest(block):
    return block.flags & ~SampleBlock.FLAG_STOPPED == 0 and block.voltage_v[-1] == 0.0


class RunningGoal:
    """A goal and, asked for at once as clients do, its result to come."""

    def __init__(self, handle):
        self.handle = handle
        self.outcome = handle.get_result_async()


class StageClient(Client):
    """Keep what the stage of a namespace publishes; answer its blocks if told how.

    Attributes
    ----------
    processes : Processes
        The nodes of the namespace.
    axes : tuple of str
        Of a stage that has several.
    blocks : list of SampleBlock
        Since the last `forget`.
    answer : callable or None
        Takes a block, returns the feedback voltage, or None for no answer.
    """

    def __init__(self, namespace, processes, axes=()):
        super().__init__(namespace)
        self.processes, self.axes = processes, axes
        self.blocks = []
        self.answer = None
        self.run = None
        self._early_answers = []
        self._feedback = self.node.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
        self.node.create_subscription(SampleBlock, "samples", self._receive, SAMPLES)

    def _receive(self, block):
        self.blocks.append(block)
        voltage_v = self.answer(block) if self.answer else None
        if voltage_v is not None:
            self.send_feedback(block.tick, voltage_v)

    def send_feedback(self, tick, voltage_v):
        if self.run is None:  # the stage has begun, its response is still to come
            self._early_answers.append((tick, voltage_v))
        else:
            self._feedback.publish(FeedbackVoltage(
                tick=tick, voltage_v=float(voltage_v), run=self.run))

    def node_names(self):
        """The nodes of the namespace."""
        return {name for name, namespace in self.node.get_node_names_and_namespaces()
                if namespace == self.node.get_namespace()}

    def connect(self):
        """Make sure that no block is missed from here on."""
        played = self.play([0.0])
        while not self.spin_until(lambda: self.blocks, 0.2):
            played = self.play([0.0])
        self.samples(played.last_sample)  # none of them is still to come
        self.until(lambda: self._feedback.get_subscription_count() > 0)
        self.forget()

    def connect_recorder(self, directory, sample_period_s=25e-6,
                         topics=("samples", "ground_truth")):
        """Make sure that no block of these topics is missing in recordings from here on."""
        for attempt in count():
            self.call(StartRecording, "recorder/start_recording", directory=str(directory),
                      name=f"connect_{attempt}", client=self.node.get_fully_qualified_name())
            last_sample = self.play([0.0], sample_period_s).last_sample
            stopped = self.call(
                StopRecording, "recorder/stop_recording", last_sample=last_sample,
                client=self.node.get_fully_qualified_name())
            if stopped.success and all(
                    holds(stopped.path, topic, last_sample) for topic in topics):
                break
        self.samples(last_sample)
        self.forget()

    def until(self, condition):
        """Spin until a condition holds; fail with the nodes' logs where it never does."""
        if not self.spin_until(condition, TIMEOUT_S):
            pytest.fail(f"nothing came for {TIMEOUT_S:g} s; the nodes say:\n{self.logs()}")

    def until_any(self, condition, seen=0):
        """Spin until a block fulfils a condition; each is looked at once, as there may be many."""
        def found():
            nonlocal seen
            new, seen = self.blocks[seen:], len(self.blocks)
            return any(map(condition, new))

        self.until(found)

    def until_flagged(self, flag, seen=0):
        """Spin until a block bears a flag; a fast stage may have passed it since."""
        self.until_any(lambda block: block.flags & flag, seen)

    def wait(self, future, waiting=None):
        self.until(future.done)
        return future.result()

    def beside(self, work, *arguments, **options):
        """Do work in a thread while this client reads on; return its result.

        A client that does not read holds the stage back.
        """
        with ThreadPoolExecutor(1) as thread:
            future = thread.submit(work, *arguments, **options)
            while not self.spin_until(future.done, 1.0):
                pass
            return future.result()

    def logs(self):
        """What the nodes printed, each under its name."""
        return "\n".join(f"--- {path.name}\n{path.read_text()}" for path in sorted(
            self.processes.log("stage").parent.glob("*.log")))

    # Goals and services

    def play(self, voltage_v, sample_period_s=25e-6, repeats=1, **options):
        """Play a waveform to its end, that of one axis on all of them; see ``Client.goal``."""
        if self.axes and np.ndim(voltage_v) == 1:
            voltage_v = np.repeat(np.reshape(voltage_v, (-1, 1)), len(self.axes), axis=1)
        return self.goal(
            "play_waveform", voltage_v=array.array("d", np.ravel(voltage_v)),
            sample_period_s=sample_period_s, repeats=repeats, axes=list(self.axes), **options)

    def send_goal(self, name, **fields):
        """Send a goal; return it without waiting."""
        return RunningGoal(self.send(name, **fields))

    def begin(self, name, **fields):
        """Send a goal; return it once the stage moves."""
        seen = len(self.blocks)
        goal = self.send_goal(name, **fields)
        self.until_any(lambda block: np.any(block.voltage_v), seen)
        return goal

    def begin_play(self, voltage_v, sample_period_s=25e-6, repeats=1):
        """Begin a waveform; return the goal once the stage plays it."""
        seen = len(self.blocks)
        goal = self.begin("play_waveform", voltage_v=array.array("d", voltage_v),
                          sample_period_s=sample_period_s, repeats=repeats)
        self.until_flagged(SampleBlock.FLAG_PLAYING, seen)
        return goal

    def result(self, goal):
        """Wait for the end of a goal; return its status and its result."""
        response = self.wait(goal.outcome)
        return response.status, response.result

    def cancel(self, goal):
        """Cancel a goal; return its status and its result."""
        self.wait(goal.handle.cancel_goal_async())
        return self.result(goal)

    def load(self, once_voltage_v, period_voltage_v=(), append=False):
        return self.call(LoadFeedforward, "load_feedforward", append=append,
                         once_voltage_v=array.array("d", once_voltage_v),
                         period_voltage_v=array.array("d", period_voltage_v))

    def start_tracking(self, feedback, ticks=0):
        """Begin a run, whose number the answers then bear."""
        self.run, self._early_answers = None, []
        response = self.call(StartTracking, "start_tracking", feedback=feedback, ticks=ticks)
        self.run, early = response.run, self._early_answers
        for answer in early:
            self.send_feedback(*answer)
        return response

    def trigger(self, name):
        return self.call(Trigger, name)

    def change_state(self, transition):
        """Ask the stage's lifecycle for a transition; return whether it took place."""
        return self.call(ChangeState, "stage/change_state",
                         transition=Transition(id=transition)).success

    def restart(self):
        """Deactivate the stage and activate it again, which starts everything anew."""
        assert self.change_state(Transition.TRANSITION_DEACTIVATE)
        assert self.change_state(Transition.TRANSITION_ACTIVATE)
        self.forget()

    def state(self):
        return self.call(GetState, "stage/get_state").current_state.label

    def another_client(self):
        """Another client of the same stage; a context manager."""
        return StageClient(self.node.get_namespace(), self.processes, self.axes)

    # Samples

    def samples(self, last_sample=None):
        """Everything since the last `forget`, up to a sample, or until all is at rest."""
        if last_sample is None:
            self.until(lambda: self.blocks and at_rest(self.blocks[-1]))
        else:
            self.until(lambda: self.blocks and end(self.blocks[-1]) > last_sample)
        return Samples(list(self.blocks))

    def forget(self):
        self.blocks.clear()


@pytest.fixture(scope="session", autouse=True)
def patient_clients():
    """Let clients wait as long as a busy computer takes: a node may compile its numerics first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(client_module, "SERVER_TIMEOUT_S", TIMEOUT_S)
        patch.setattr(client_module, "CALL_TIMEOUT_S", TIMEOUT_S)
        patch.setattr(client_module, "CANCEL_TIMEOUT_S", TIMEOUT_S)
        for module in client_module, overview:
            patch.setattr(module, "DIAGNOSTICS_S", TIMEOUT_S)
        patch.setattr(client_module, "ACCEPTANCE_TIMEOUT_S", TIMEOUT_S)
        yield


@pytest.fixture(scope="session", autouse=True)
def forks_that_count():
    """Wait for the server of the forks, so that the time of a run has that of its nodes."""
    yield
    forkserver._forkserver._stop()


@pytest.fixture(scope="session")
def stage_client(domain):
    """Makes a client of a stage that a test has started by itself."""
    return StageClient


class Nodes:
    """Starts nodes; ends them together, and looks whether one of them broke.

    They are forks of one process: what is about their end takes their executables instead.
    """

    def __init__(self, directory, kind=ForkedProcesses):
        self._directory = directory
        self._kind = kind
        self._ends = ExitStack()
        self._groups = 0

    def start(self, *names, namespace="", connect=True, node_parameters=None, axes=(),
              **stage_parameters):
        """Start a lockstep stage and other nodes in a namespace; return a client of the stage."""
        self._groups += 1
        directory = self._directory / str(self._groups)
        self._ends.callback(self._assert_no_traceback, directory)
        processes = self._ends.enter_context(self._kind(directory, data_root="/"))
        for name in ("stage", *names):
            parameters = {"timing": "lockstep", "autostart": True, **PATIENT, **stage_parameters}
            processes.start(name, parameters if name == "stage"
                            else (node_parameters or {}).get(name), namespace or None)
        client = self._ends.enter_context(StageClient(namespace, processes, axes))
        client.until(lambda: {"client", "stage", *names} <= client.node_names())
        if connect:
            client.connect()
        if "recorder" in names:
            client.connect_recorder(directory)
        return client

    def stop(self):
        self._ends.close()

    @staticmethod
    def _assert_no_traceback(directory):
        for log in directory.glob("*.log"):
            text = log.read_text()
            assert "Traceback" not in text, f"{log.name}: {text}"


@pytest.fixture(scope="session", autouse=True)
def domain(domain_of_our_own):
    """A ROS domain of our own."""
    return domain_of_our_own


@pytest.fixture
def endless(tmp_path):
    """Directory whose probe lets experiments last longer than a test asks, on any machine."""
    write_endless_probe(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def plain_model():
    """Small model of a stage, without identification."""
    return StageModel(
        PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 0.008)), -9.0),
        CreepDynamics((0.17,), (0.18,)), ElectricVibrationDynamics(5e-4, (2846.0,), (0.7,)))


@pytest.fixture(scope="session")
def near_model():
    """About the simulated stage, without identification."""
    centres_v = -20.0 + (np.arange(NEAR_CELLS) + 0.5) * 140.0 / NEAR_CELLS
    span_v, middle_v = (centres_v[:, None] - centres_v, (centres_v[:, None] + centres_v) / 2)
    density = np.tril(6e-4 + 0.078 * np.exp(-span_v / 12.0)
                      * (1 + 0.1 * np.cos(2 * np.pi * (middle_v - 60.0) / 280.0)))
    return StageModel(
        PreisachModel(-20.0, 120.0, density, -9.7),
        CreepDynamics((0.01419, 0.1684, 0.2402, 1.053, 17.57),
                      (0.01458, 0.1716, 0.241, 1.07, 18.29)),
        ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992)))


@pytest.fixture(scope="session")
def near_controller(near_model):
    """Default feedback for ``near_model``, of few scalings."""
    with replaced(*FEW_SCALINGS):
        return design_feedback(near_model, load_weights())


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    """Starts nodes that live as long as the tests of one module."""
    nodes = Nodes(tmp_path_factory.mktemp("nodes"))
    try:
        yield nodes
    finally:
        nodes.stop()


@pytest.fixture(scope="module")
def executables(tmp_path_factory):
    """As ``nodes``, of their executables."""
    nodes = Nodes(tmp_path_factory.mktemp("executables"), Processes)
    try:
        yield nodes
    finally:
        nodes.stop()


@pytest.fixture(scope="session")
def watched(tmp_path_factory, domain):
    """A stage with the monitor, which the suite does not start."""
    nodes = Nodes(tmp_path_factory.mktemp("watched"))
    try:
        yield nodes.start("monitor", namespace="/watched")
    finally:
        nodes.stop()


@pytest.fixture
def serving(request):
    """Returns the client of the nodes among which one of a name is."""
    return lambda node: request.getfixturevalue("suite" if node in USUAL_NODES else "watched")


@pytest.fixture(scope="session")
def whole_suite(tmp_path_factory, domain):
    nodes = Nodes(tmp_path_factory.mktemp("suite"))
    try:
        yield nodes.start("recorder", "identification", "controller", namespace="/left")
    finally:
        nodes.stop()


@pytest.fixture(scope="session")
def told():
    """What the identification of the session told on its way: (step, fraction, seconds left)."""
    return []


@pytest.fixture(scope="session")
def identification(whole_suite, tmp_path_factory, told, plain_model):
    """Of the stage /left, through the whole sequence; by ``make long`` as a user asks for it.

    It replaces an earlier model.
    """
    directory, orders = tmp_path_factory.mktemp("identification"), {}
    save_model(directory / "model.json", IdentifiedModel(plain_model, (-20.0, 120.0)))
    if not os.environ.get("LONG_TESTS"):
        write_short_probe(directory)
        orders = {"creep_pairs": 4, "modes": 2}
    with Stage("/left", progress=lambda *progress: told.append(progress)) as stage:
        return whole_suite.beside(stage.identify, directory, **orders)


@pytest.fixture(scope="session")
def model(identification):
    """Path of the model file of the stage /left."""
    return identification.path


@pytest.fixture
def suite(whole_suite):
    """Client of all the nodes, which live in the namespace /left as long as the session."""
    whole_suite.forget()
    yield whole_suite
    whole_suite.answer = None
    # Refused if the test left the stage busy or stopped, which is then mended for the next.
    try:
        last_sample = whole_suite.play([0.0]).last_sample
    except GoalFailed:
        whole_suite.call(Trigger, "emergency_stop")
        whole_suite.until(lambda: whole_suite.call(Trigger, "reset").success)
        raise
    assert whole_suite.samples(last_sample).voltage_v[-1] == 0.0
