# SPDX-License-Identifier: BSD-3-Clause
"""The service ``accept_extended_model``, and the topic with the model that runs use."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from piezo_interfaces.srv import AcceptExtendedModel
from rclpy.node import Node
from std_msgs.msg import String

from piezo_common.regular_file import UnreadableFile
from piezo_common.text_file import read_bounded_text
from piezo_controller.node.present_run import FROM_THE_NEXT, PresentRun
from piezo_controller.tracking.accepted_models import AcceptedModels, CheckFeedback, ModelText
from piezo_models.model_file import LARGEST_FILE_BYTES
from piezo_ros.late_responses import LateResponse, create_late_service
from piezo_ros.quality import DESCRIPTION


class ModelService:
    """Service by which an operator accepts an extended model for the runs.

    `readable` returns the path of a file to read, given the requested one. `check` designs the
    feedback for an extended model, and raises ValueError if it is unstable.
    """

    def __init__(self, node: Node, readable: Callable[[str], str], check: CheckFeedback) -> None:
        self._node, self._readable, self._check = node, readable, check
        self._accepted = AcceptedModels()
        self._present: PresentRun | None = None
        # One model is changed at a time, and none while a run begins or ends.
        self._changing = threading.Lock()
        self._publisher = node.create_publisher(String, "controller/model", DESCRIPTION)
        create_late_service(
            node, AcceptExtendedModel, "controller/accept_extended_model", self._begin)

    def model_for(self, path: str) -> tuple[ModelText, ModelText, str]:
        """Publish and return the model that a run uses, after the one that the goal names.

        The third result is a note for the result; empty if the named model is used. Raises
        ValueError if a file cannot be read, or was changed after it was accepted.
        """
        named = ModelText(path, read_model_text(path))
        used = self._accepted.in_place_of(named, read_model_text)
        self._publish(used)
        return named, used, "" if used is named else (
            f"used {used.path}, which was accepted in place of {path}")

    @contextmanager
    def playing(self, run: PresentRun) -> Iterator[None]:
        """Context in which a run may switch to a model that is accepted meanwhile."""
        self._present = run
        try:
            yield
        finally:
            run.ended = True
            with self._changing:
                self._present = None

    def _publish(self, model: ModelText) -> None:
        self._publisher.publish(String(data=model.path))

    def _begin(self, request: AcceptExtendedModel.Request, late: LateResponse) -> None:
        # A design takes seconds, during which the run continues.
        threading.Thread(target=self._answer, name="accept", args=(request, late)).start()

    def _answer(self, request: AcceptExtendedModel.Request, late: LateResponse) -> None:
        response = late.response
        try:
            with self._changing:
                response.message = self._accept(request)
            response.success = True
            self._node.get_logger().info(response.message)
        except ValueError as error:
            response.message = f"{error}; what was used before stays"
            self._node.get_logger().warning(response.message)
        late.give()

    def _accept(self, request: AcceptExtendedModel.Request) -> str:
        path, extended = map(self._readable, (request.model, request.extended_model))
        model = ModelText(path, read_model_text(path))
        present = self._present

        def go_over(following: ModelText) -> str:
            if present is None or present.named.sha256 != model.sha256:
                return FROM_THE_NEXT
            return present.go_over(following, self._publish)

        if not extended:
            when = go_over(model)
            self._accepted.withdraw(model)
            return f"{path} is used itself {when}"
        when = self._accepted.accept(
            model, ModelText(extended, read_model_text(extended)), self._check, go_over)
        return f"{extended} is used in place of {path} {when}"


def read_model_text(path: str) -> str:
    """Return the text of a model file; raise ValueError if it cannot be read."""
    try:
        return read_bounded_text(path, LARGEST_FILE_BYTES)
    except UnreadableFile as error:
        raise ValueError(f"cannot read the model {path!r}: it {error}; "
                         "identify the stage first, or give the path of its model") from None
