"""A classifier or a detector in a separate process, asked over a socket."""

from __future__ import annotations

import hashlib
from typing import Any

from sada_gym.agents.remote.client import RemotePeer
from sada_gym.agents.remote.messages import Actions, HelloImages, Look, Welcome
from sada_gym.agents.remote.places import Address, Program
from sada_gym.envs.images.answers import Found, classified, detected
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes


class RemoteModel(RemotePeer):
    """Sends images to a model's process, one at a time, and checks what it tells of them.

    Args:
        place: Where the process is.
        hello: What the model should do, and how its server should use it.
        timeout_s: How long to wait for the program's start, and for each whole answer.

    Raises:
        UserError: If nobody is there, the server refuses, or nobody says what the model does.
    """

    wanted = "answers"

    def __init__(self, place: Address | Program, hello: HelloImages, timeout_s: float) -> None:
        super().__init__(place, timeout_s)
        self._hello, task = hello, hello.task
        told = self._first()
        if (told.task or task) is None:
            raise UserError(
                f"Expected task='classify' or task='detect' for the agent in {place}, got none. "
                "Say what it does."
            )
        self.task, self.names = told.task or task, told.classes or {}

    def _connect(self) -> Welcome:
        return self._greeted(self._hello, {})

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the agent's identity and how it is used; None where that is unknown."""
        if (told := super().fingerprint) is None:
            return None
        return hashlib.sha256(f"{told} {self._hello.model_dump_json()}".encode()).hexdigest()

    def found(self, image: Bytes) -> Found:
        """Tell what is in an image, see `Model.found`.

        It raises `AgentLost` if the process died, stalled or answered nonsense, and `UserError` if
        the model itself raised an error.
        """
        self._again()
        arrays: Any = self._exchange(Look(number=0), {"image": image}, Actions)[1]
        try:
            if self.task == "classify":
                return classified(arrays.get("scores", ()))
            return detected([arrays])
        except UserError as error:
            self._lose(f"what is no answer: {error}")
