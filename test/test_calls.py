# SPDX-License-Identifier: BSD-3-Clause
"""Calls survive a lost answer, and end when a node does."""

import queue
import re
import threading
import time
from contextlib import suppress
from types import SimpleNamespace

import pytest
import rclpy
from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from piezo_interfaces.action import PlayWaveform
from piezo_interfaces.srv import LoadFeedforward, StartRecording, StopRecording
from rclpy.action import ActionServer, CancelResponse
from rclpy.experimental import EventsExecutor
from std_srvs.srv import Trigger

from piezo_client import client as client_module
from piezo_client.client import Client, GoalFailed, ServiceFailed
from piezo_ros import deadlines
from piezo_ros.deadlines import seconds_since, set_deadline, why_too_late
from piezo_ros.late_responses import answer_impossible_transitions, create_late_service
from piezo_ros.leaving import leave
from piezo_ros.requests import calls, servers
from piezo_ros.requests.calls import ActionCaller, CallFailed, call_service, number_request
from piezo_ros.requests.servers import Waiting, server_of
from piezo_ros.stage_runs import described_stage

TIMEOUT_S = 300.0


class Spinning:
    """A node of a context of its own, spun by a thread."""

    def __init__(self, name, namespace):
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(name, namespace=namespace, context=self.context)
        self._executor = EventsExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self):
        while not self._ends.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def make(self, entity, *arguments, **options):
        """Make an entity of the node between two callbacks: a spinning executor may miss others."""
        made = queue.SimpleQueue()
        self._executor.create_task(lambda: made.put(entity(*arguments, **options)))
        return made.get(timeout=TIMEOUT_S)

    def stop_executor(self):
        self._ends.set()
        self._thread.join()

    def close(self):
        if not self.context.ok():
            return
        self.stop_executor()
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        leave(self.node)


def meet(node, service):
    """Wait until a node knows who serves something: names are discovered after services."""
    while not server_of(node, service):
        pass


@pytest.fixture
def namespace(request):
    """A namespace of each test's own: a server that has just ended is still seen for a while."""
    return "/" + re.sub(r"\W+", "_", request.node.name)


@pytest.fixture
def spinning(namespace):
    """Makes nodes that are spun in threads."""
    made = []

    def make(name):
        made.append(Spinning(name, namespace))
        return made[-1]

    yield make
    for one in reversed(made):
        one.close()


def lose_first_response(service):
    send = service.send_response

    def lose(response, header):
        service.send_response = send

    service.send_response = lose


@pytest.fixture
def forgetful(spinning):
    """A server of some services that loses its first response to each; the requests it got."""
    server, requests = spinning("server"), []

    def serve(service_type, name):
        def answer(request, response):
            requests.append(request)
            response.success = True
            return response

        lose_first_response(server.make(server.node.create_service, service_type, name, answer))

    serve(LoadFeedforward, "load_feedforward")
    serve(StopRecording, "recorder/stop_recording")
    serve(StartRecording, "recorder/start_recording")
    return requests


@pytest.fixture
def soon(monkeypatch):
    """Let a lost answer be noticed soon."""
    monkeypatch.setattr(calls, "RESEND_S", 0.2)
    monkeypatch.setattr(client_module, "LOST_RESPONSE_S", 0.2)


def assert_repeated_under_one_number(requests):
    # A busy computer answers so late that it is asked again, too.
    assert len(requests) >= 2
    number, = {request.request_id for request in requests}
    assert number != 0


def test_numbered_request_is_sent_again_under_its_number_by_a_node(spinning, forgetful, soon):
    asking = spinning("asking")
    client = asking.make(
        asking.node.create_client, LoadFeedforward, "load_feedforward")
    assert call_service(asking.node, client, LoadFeedforward.Request(append=True)).success
    assert_repeated_under_one_number(forgetful)


def test_numbered_request_is_sent_again_under_its_number_by_a_client(forgetful, soon, namespace):
    with Client(namespace, "asking") as client:
        assert client.call(LoadFeedforward, "load_feedforward", append=True).success
    assert_repeated_under_one_number(forgetful)


def test_request_that_must_not_act_twice_is_never_sent_twice(
        forgetful, soon, namespace, monkeypatch):
    monkeypatch.setattr(client_module, "CALL_TIMEOUT_S", 3.0)
    with Client(namespace, "asking") as client:
        meet(client.node, "recorder/start_recording")
        with pytest.raises(ServiceFailed, match="/server did not answer .* within 3 s"):
            client.call(StartRecording, "recorder/start_recording")
        assert client.spin_until(lambda: forgetful, TIMEOUT_S)
    assert len(forgetful) == 1


@pytest.mark.parametrize("acts", [True, False])
def test_transition_whose_response_was_lost_succeeds_if_it_took_place(
        acts, spinning, soon, namespace):
    server, requests = spinning("server"), []

    def change_state(request, response):
        requests.append(request.transition.id)
        response.success = acts and len(requests) == 1
        return response

    def get_state(request, response):
        response.current_state.id = (
            State.PRIMARY_STATE_ACTIVE if acts else State.PRIMARY_STATE_INACTIVE)
        return response

    service = server.make(
        server.node.create_service, ChangeState, "stage/change_state", change_state)
    server.make(server.node.create_service, GetState, "stage/get_state", get_state)
    lose_first_response(service)
    with Client(namespace, "asking") as client:
        assert client.call(ChangeState, "stage/change_state", transition=Transition(
            id=Transition.TRANSITION_ACTIVATE)).success == acts
    assert set(requests) == {Transition.TRANSITION_ACTIVATE}
    assert len(requests) >= 2


def test_stop_of_a_recording_is_asked_for_again_by_a_client(forgetful, soon, namespace):
    with Client(namespace, "asking") as client:
        assert client.call(StopRecording, "recorder/stop_recording", last_sample=7).success
    assert_asked_again_for(forgetful, 7)


def test_stop_of_a_recording_is_asked_for_again_by_a_node(spinning, forgetful, soon):
    asking = spinning("asking")
    client = asking.make(asking.node.create_client, StopRecording, "recorder/stop_recording")
    assert call_service(asking.node, client, StopRecording.Request(last_sample=7)).success
    assert_asked_again_for(forgetful, 7)


def assert_asked_again_for(requests, last_sample):
    assert len(requests) >= 2
    assert {request.last_sample for request in requests} == {last_sample}


@pytest.fixture
def forgetful_action(spinning):
    """A server of an action that loses its first answer to a goal; the goals it worked on."""
    server, goals = spinning("server"), []

    def work(handle):
        goals.append(handle.request)
        handle.succeed()
        return PlayWaveform.Result(success=True, last_sample=7)

    action = server.make(ActionServer, server.node, PlayWaveform, "play_waveform", work)
    handle = action._handle
    lost = []

    class Forgetful:
        def send_goal_response(self, header, response):
            lost.append(header) if not lost else handle.send_goal_response(header, response)

        def __getattr__(self, name):
            return getattr(handle, name)

    action._handle = Forgetful()
    yield goals
    action._handle = handle


def test_client_learns_from_the_status_that_its_goal_was_taken(forgetful_action, soon, namespace):
    with Client(namespace, "asking") as client:
        assert client.goal("play_waveform").last_sample == 7
    assert len(forgetful_action) == 1


def test_node_learns_from_the_status_that_its_goal_was_taken(spinning, forgetful_action, soon):
    asking = spinning("asking")
    caller = asking.make(ActionCaller, asking.node, PlayWaveform, "play_waveform")
    assert caller.run(PlayWaveform.Goal()).last_sample == 7
    assert len(forgetful_action) == 1


@pytest.fixture
def talkative_action(spinning):
    """A server whose goals tell how they get on until they are cancelled; those that were."""
    server, cancelled = spinning("server"), []

    def end(handle):
        cancelled.append(handle.request)
        handle.canceled()
        return PlayWaveform.Result(message="cancelled", last_sample=7)

    def work(handle):
        while not handle.is_cancel_requested:
            handle.publish_feedback(PlayWaveform.Feedback(fraction=0.5))
            pause.wait(0.01)
        handle.execute(end)

    pause = threading.Event()
    server.make(ActionServer, server.node, PlayWaveform, "play_waveform", end,
                handle_accepted_callback=lambda handle: threading.Thread(
                    target=work, args=(handle,)).start(),
                cancel_callback=lambda handle: CancelResponse.ACCEPT)
    return cancelled


@pytest.fixture
def deaf_action(spinning, monkeypatch):
    """A server that goes on when its goal is cancelled, until it is allowed to end."""
    monkeypatch.setattr(servers, "WORD_AFTER_S", 0.2)
    server, may_end = spinning("server"), threading.Event()

    def end(handle):
        handle.canceled()
        return PlayWaveform.Result(message="cancelled", last_sample=7)

    def work(handle):
        may_end.wait(TIMEOUT_S)
        handle.execute(end)

    server.make(ActionServer, server.node, PlayWaveform, "play_waveform", end,
                handle_accepted_callback=lambda handle: threading.Thread(
                    target=work, args=(handle,)).start(),
                cancel_callback=lambda handle: CancelResponse.ACCEPT)
    yield may_end
    may_end.set()


class Words(list):
    """What a node logs; the first word lets something happen."""

    def __init__(self, node, may_end, monkeypatch):
        super().__init__()
        self._may_end = may_end
        monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(
            warning=self.say, error=self.say))

    def say(self, text):
        self.append(text)
        self._may_end.set()


def test_node_that_waits_for_a_cancelled_goal_says_for_whom(spinning, deaf_action, monkeypatch):
    asking = spinning("asking")
    caller = asking.make(ActionCaller, asking.node, PlayWaveform, "play_waveform")
    meet(asking.node, "play_waveform")
    words = Words(asking.node, deaf_action, monkeypatch)
    assert caller.run(PlayWaveform.Goal(), cancelled=lambda: True).last_sample == 7
    assert "/server has not answered play_waveform for" in words[0]


def test_client_that_waits_for_a_cancelled_goal_says_for_whom(
        deaf_action, namespace, monkeypatch):
    with Client(namespace, "asking") as client:
        meet(client.node, "play_waveform")
        words = Words(client.node, deaf_action, monkeypatch)
        with pytest.raises(GoalFailed, match="cancelled"):
            client.goal("play_waveform", cancel_after_s=0.0)
    assert "/server has not answered play_waveform for" in words[0]


def test_client_that_gives_a_cancelled_goal_up_says_so(deaf_action, namespace, monkeypatch):
    monkeypatch.setattr(client_module, "CANCEL_TIMEOUT_S", 0.5)

    def interrupt():
        raise KeyboardInterrupt

    with Client(namespace, "asking") as client:
        meet(client.node, "play_waveform")
        words = Words(client.node, threading.Event(), monkeypatch)
        with pytest.raises(KeyboardInterrupt):
            client.goal("play_waveform", why_stop=interrupt)
    assert "/server has not ended the goal within 0.5 s" in words[-1]


def refuse(feedback):
    raise ValueError(f"no more than {feedback.fraction}")


def test_what_a_node_raises_at_feedback_cancels_the_goal_and_reaches_who_waits(
        spinning, talkative_action):
    asking = spinning("asking")
    caller = asking.make(ActionCaller, asking.node, PlayWaveform, "play_waveform")
    with pytest.raises(ValueError, match="no more than 0.5"):
        caller.run(PlayWaveform.Goal(), refuse)
    assert len(talkative_action) == 1
    # Work that is cancelled says so at feedback, too, and gets the result all the same.
    assert caller.run(PlayWaveform.Goal(), refuse, lambda: True).last_sample == 7


def test_what_a_client_raises_at_feedback_cancels_the_goal_and_reaches_its_caller(
        talkative_action, namespace):
    with Client(namespace, "asking") as client:
        with pytest.raises(ValueError, match="no more than 0.5"):
            client.goal("play_waveform", on_feedback=refuse)
        assert len(talkative_action) == 1


def test_each_request_has_a_number_of_its_own():
    requests = [LoadFeedforward.Request() for _ in range(100)]
    assert all(map(number_request, requests))
    assert len({request.request_id for request in requests} - {0}) == 100
    assert not number_request(StopRecording.Request())


def outcome_of(work):
    """Do work in a thread; return the thread, and the list that gets its exception."""
    failures = []

    def run():
        try:
            work()
        except CallFailed as failure:
            failures.append(str(failure))

    thread = threading.Thread(target=run)
    thread.start()
    return thread, failures


@pytest.fixture
def hesitant(spinning):
    """A server that gets round to a request only after it was given up; what it got, and did."""
    server, got, acted = spinning("server"), queue.SimpleQueue(), []

    def serve(service_type, name, is_given_up, **options):
        service = server.make(create_late_service, server.node, service_type, name,
                              lambda request, late: acted.append(request), **options)
        begin = service.send_response

        def hesitate(call, header):
            while not is_given_up(call[0], header):
                time.sleep(0.01)
            begin(call, header)
            got.put(call[0])

        service.send_response = hesitate

    def is_old(request, header):
        return seconds_since(header.source_timestamp) > deadlines.LONGEST_DELAY_S

    serve(LoadFeedforward, "load_feedforward", lambda request, header: why_too_late(request))
    serve(Trigger, "reset", is_old)
    serve(Trigger, "emergency_stop", is_old, acts_late=True)
    return got, acted


@pytest.mark.parametrize(("service_type", "name"), [
    (LoadFeedforward, "load_feedforward"), (Trigger, "reset")])
def test_request_is_not_acted_upon_after_its_client_gave_it_up(
        spinning, hesitant, monkeypatch, service_type, name):
    monkeypatch.setattr(deadlines, "LONGEST_DELAY_S", 0.5)
    got, acted = hesitant
    asking = spinning("asking")
    client = asking.make(asking.node.create_client, service_type, name)
    meet(asking.node, name)
    with pytest.raises(CallFailed, match="/server did not answer|gave this request up|given it up"):
        call_service(asking.node, client, service_type.Request(), timeout_s=0.5)
    assert got.get(timeout=TIMEOUT_S)
    assert not acted


def test_what_leads_to_rest_acts_however_late_it_comes(spinning, hesitant, monkeypatch):
    monkeypatch.setattr(deadlines, "LONGEST_DELAY_S", 0.5)
    got, acted = hesitant
    asking = spinning("asking")
    client = asking.make(asking.node.create_client, Trigger, "emergency_stop")
    with pytest.raises(CallFailed, match="did not answer"):
        call_service(asking.node, client, Trigger.Request(), timeout_s=0.5)
    assert got.get(timeout=TIMEOUT_S)
    assert len(acted) == 1


def test_transition_is_refused_once_its_client_may_have_given_it_up(spinning, monkeypatch):
    monkeypatch.setattr(deadlines, "LONGEST_DELAY_S", -1.0)
    server, asking, acted = spinning("server"), spinning("asking"), []
    server.make(server.node.create_service, ChangeState, "stage/change_state",
                lambda request, response: acted.append(request) or response)
    answer_impossible_transitions(server.node)
    client = asking.make(asking.node.create_client, ChangeState, "stage/change_state")
    while not asking.make(client.service_is_ready):
        pass
    answers, response = queue.SimpleQueue(), None
    while response is None:  # it is lost if the server has not met its client yet
        asking.make(client.call_async, ChangeState.Request()).add_done_callback(answers.put)
        with suppress(queue.Empty):
            response = answers.get(timeout=calls.RESEND_S).result()
    assert not response.success
    assert not acted


def test_request_whose_deadline_was_left_out_may_always_act():
    assert not why_too_late(LoadFeedforward.Request())
    request = LoadFeedforward.Request(deadline=Time(sec=1))
    assert "gave this request up" in why_too_late(request)
    set_deadline(request, 100.0)
    assert request.deadline == Time(sec=1)


def test_node_that_waits_names_the_one_that_it_waits_for(spinning, monkeypatch):
    server, asking = spinning("server"), spinning("asking")
    server.make(server.node.create_service, GetState, "stage/get_state", None)
    words = []
    monkeypatch.setattr(asking.node, "get_logger", lambda: SimpleNamespace(warning=words.append))
    meet(asking.node, "stage/get_state")
    waiting = Waiting(asking.node, "stage/get_state")
    for waited_s in (1.0, 4.9, 5.1, 5.2, 10.1):
        waiting.look(waited_s)
    namespace = asking.node.get_namespace()
    assert words == [f"{namespace}/server has not answered stage/get_state for {waited_s} s: "
                     "waiting" for waited_s in (5, 10)]


def test_node_that_waits_for_one_without_a_name_does_not_say_that_nobody_serves(
        spinning, monkeypatch):
    # As after the middleware took a starved process for dead: its services come back alone.
    monkeypatch.setattr(servers, "server_of", lambda node, service: "")
    server, asking = spinning("server"), spinning("asking")
    words = []
    monkeypatch.setattr(asking.node, "get_logger", lambda: SimpleNamespace(warning=words.append))
    waiting = Waiting(asking.node, "stage/get_state")
    waiting.look(5.0)
    server.make(server.node.create_service, GetState, "stage/get_state", None)
    meet(asking.node, "stage/get_state")
    waiting.look(10.0)
    assert words == ["nobody has served stage/get_state for 5 s: waiting for its node",
                     "the node that serves stage/get_state has not answered stage/get_state for "
                     "10 s: waiting"]


def test_call_ends_when_the_node_that_serves_is_gone(spinning):
    asked = threading.Event()
    server, asking = spinning("server"), spinning("asking")

    def never(request, response):
        asked.set()
        return response

    service = server.make(
        server.node.create_service, LoadFeedforward, "load_feedforward", never)
    service.send_response = lambda *_: None
    client = asking.make(
        asking.node.create_client, LoadFeedforward, "load_feedforward")
    thread, failures = outcome_of(
        lambda: call_service(asking.node, client, LoadFeedforward.Request()))
    assert asked.wait(TIMEOUT_S)
    server.close()
    thread.join(TIMEOUT_S)
    assert failures == ["the node that serves load_feedforward has ended: start it again"]


@pytest.fixture
def silent_stage(spinning):
    """A stage that loses its first answer to who asks for its state; the node, and what it lost."""
    server, lost = spinning("server"), []

    def answer(request, response):
        response.current_state.label = "unconfigured"
        return response

    service = server.make(server.node.create_service, GetState, "stage/get_state", answer)
    send = service.send_response

    def lose_the_first(response, header):
        service.send_response = send
        lost.append(response)

    service.send_response = lose_the_first
    return server, lost


def test_stage_that_does_not_describe_itself_is_asked_again_for_its_state(
        spinning, silent_stage, monkeypatch):
    monkeypatch.setattr(described_stage, "RESEND_S", 0.2)
    asking, (_, lost) = spinning("asking"), silent_stage
    stage = asking.make(described_stage.DescribedStage, asking.node)
    with pytest.raises(CallFailed, match="the stage is unconfigured"):
        stage.wait(lambda: None)
    assert len(lost) == 1


def test_stage_that_goes_away_before_it_tells_its_state_is_not_waited_for(
        spinning, silent_stage, monkeypatch):
    monkeypatch.setattr(described_stage, "APPEARANCE_S", 0.5)
    asking, (server, lost) = spinning("asking"), silent_stage
    stage = asking.make(described_stage.DescribedStage, asking.node)
    while not asking.make(stage._state.service_is_ready):
        pass
    with pytest.raises(CallFailed, match="nobody serves the stage on .*/stage/description"):
        stage.wait(lambda: server.close() if lost else None)


def test_goal_of_a_node_whose_executor_stopped_fails_once_the_node_ends(spinning, monkeypatch):
    asking = spinning("asking")
    caller = asking.make(ActionCaller, asking.node, PlayWaveform, "play_waveform")
    monkeypatch.setattr(caller._client, "wait_for_server", lambda timeout_s: True)
    asking.stop_executor()
    thread, failures = outcome_of(lambda: caller.run(PlayWaveform.Goal()))
    asking.context.try_shutdown()
    thread.join(TIMEOUT_S)
    assert failures == ["this node ended before play_waveform answered: start it again"]
