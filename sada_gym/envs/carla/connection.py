"""A CARLA server: checked before its first use, and left as it was found."""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sada_gym.errors import (
    MissingExtra,
    ServerLost,
    UserError,
    UserTypeError,
    described,
    install_line,
)

HOST_VARIABLE = "SADA_CARLA_HOST"
STEP_S = 0.05
"""Seconds of simulation in a tick."""
_FIRST_ANSWER_S = 3.0
_ANSWER_S = 120.0  # loading a town takes up to a minute on a slow disk
_RESTORED_S = 10.0  # a server that is lost must not be waited for much longer
_TRAFFIC_PORTS_AHEAD = 6_000  # CARLA's own: 2000 for the server, 8000 for the traffic manager
_POLL_S = 0.2
_ADDRESS = re.compile(r"([^\s:/,]+)(?::(\d{1,5}(?:,\d{1,5})*))?")
_HIGHEST_PORT = 65_535 - _TRAFFIC_PORTS_AHEAD
_INSTALL = (
    f"{install_line('carla')} (CARLA 0.9.16 has wheels for Python 3.10 to 3.12 on Linux and "
    "Windows)"
)


def missing() -> str:
    """Say how to install CARLA's client; empty where it is there."""
    return "" if find_spec("carla") else f"Expected CARLA's client, the package carla. {_INSTALL}"


def client_library() -> Any:
    """Import CARLA's client; raise `MissingExtra` where it is not installed."""
    try:
        import carla
    except ImportError as error:
        raise MissingExtra(f"Expected CARLA's client, got: {error}. {_INSTALL}") from error
    return carla


@dataclass(frozen=True)
class Servers:
    """CARLA servers on one host; each takes one evaluation at a time."""

    host: str
    ports: tuple[int, ...]

    @classmethod
    def named(cls, text: str | None) -> Servers:
        """Read `host:port`, or `host:port,port`; None reads `SADA_CARLA_HOST`.

        Without that variable it is `localhost:2000`, where a CARLA server listens by itself.

        Raises:
            UserError: If the text is something else.
        """
        given = os.environ.get(HOST_VARIABLE) or "localhost:2000" if text is None else text
        if not isinstance(given, str):
            raise UserTypeError(f"Expected host='localhost:2000', say, got {given!r}.")
        match = _ADDRESS.fullmatch(given)
        ports = [int(port) for port in ((match and match[2]) or "2000").split(",")]
        if match is None or not all(0 < port <= _HIGHEST_PORT for port in ports):
            raise UserError(
                f"Expected the host and ports up to {_HIGHEST_PORT} of CARLA servers, such as "
                f"'localhost:2000' or 'localhost:2000,2010', got {given!r}."
            )
        return cls(match[1], tuple(dict.fromkeys(ports)))


@dataclass
class ServerWorld:
    """A fresh synchronous world on one server, until the block of `session` ends.

    Attributes:
        place: The server's host and port, for messages.
        actors: What was spawned and has to be destroyed, in this order of creation.
        lost: Whether the server stopped to answer.
    """

    carla: Any
    place: str
    world: Any
    traffic: Any
    actors: list[Any] = field(default_factory=list)
    lost: bool = False

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Turn what CARLA raises in this block into `ServerLost`."""
        try:
            with _answering(self.place):
                yield
        except ServerLost:
            self.lost = True
            raise

    def destroy(self) -> None:
        """Destroy all that was spawned: sensors before the cars that carry them."""
        while self.actors and not self.lost:  # a lost server must not be waited for again
            actor = self.actors[-1]
            if hasattr(actor, "stop"):
                actor.stop()
            actor.destroy()
            self.actors.pop()


@contextmanager
def session(servers: Servers, town: str) -> Iterator[ServerWorld]:
    """Load a town on a free server, synchronous; leave the server with the settings it had.

    At any end, Ctrl-C included, all that was spawned is destroyed and settings and weather are
    those from before. Where all servers are in use, it waits for one.

    Raises:
        MissingExtra: If CARLA's client is not installed.
        UserError: If no server answers, it has another version, or it has no such town.
        ServerLost: If the server stops to answer later.
    """
    carla = client_library()
    with _free_port(servers) as port, ExitStack() as left:
        place = f"{servers.host}:{port}"
        client = _connect(carla, servers.host, port)
        with _answering(place):
            world = client.get_world()
            before, weather = world.get_settings(), world.get_weather()
            _forget_killed_run(before)
            known = sorted({name.rsplit("/", 1)[-1] for name in client.get_available_maps()})
            if town not in known:
                raise UserError(
                    f"Expected a town that the server at {place} has, one of "
                    f"{', '.join(known)}; got {town!r}."
                )
            # registered before anything is changed, so that no moment is left out
            opened = ServerWorld(carla, place, world, None)
            left.callback(_restore, client, opened, before, weather)
            opened.world = world = client.load_world(town)
            settings = world.get_settings()
            settings.synchronous_mode, settings.fixed_delta_seconds = True, STEP_S
            settings.substepping, settings.max_substeps = True, 10
            settings.max_substep_delta_time = STEP_S / 5
            world.apply_settings(settings)
            opened.traffic = client.get_trafficmanager(port + _TRAFFIC_PORTS_AHEAD)
            opened.traffic.set_synchronous_mode(True)
        yield opened


def _connect(carla: Any, host: str, port: int) -> Any:
    """Return a client of a server that answers and has the client's version."""
    try:
        client = carla.Client(host, port)
        client.set_timeout(_FIRST_ANSWER_S)
        ours, theirs = client.get_client_version(), client.get_server_version()
    except RuntimeError as error:
        raise UserError(
            f"Expected a CARLA server at {host}:{port}, got no answer ({described(error)}). Start "
            f"one, and name another place by host='HOST:PORT' or {HOST_VARIABLE}."
        ) from error
    if ours != theirs:
        raise UserError(
            f"Expected a CARLA server of the client's version {ours} at {host}:{port}, got "
            f"{theirs}. Run: pip install carla=={theirs.split('-')[0]}, or start a server {ours}."
        )
    client.set_timeout(_ANSWER_S)
    return client


@contextmanager
def _answering(place: str) -> Iterator[None]:
    try:
        yield
    except UserError:
        raise
    except RuntimeError as error:
        raise ServerLost(
            f"Expected the CARLA server at {place} to go on, got {described(error)}. Start it "
            "again; the same command with --resume continues the run."
        ) from error


def _forget_killed_run(settings: Any) -> None:
    """Make settings that a killed run of ours left on the server those of a server's start."""
    if settings.synchronous_mode and abs((settings.fixed_delta_seconds or 0.0) - STEP_S) < 1e-6:
        settings.synchronous_mode, settings.fixed_delta_seconds = False, None


def _restore(client: Any, opened: ServerWorld, settings: Any, weather: Any) -> None:
    """Undo what a session changed, each part even where another one fails."""
    client.set_timeout(_RESTORED_S)
    try:
        client.get_server_version()
    except RuntimeError:
        return  # it is gone, and all that was on it
    for actor in reversed(opened.actors):
        for part in ("stop", "destroy"):
            with suppress(RuntimeError, AttributeError):  # cars cannot be stopped
                getattr(actor, part)()
    with suppress(RuntimeError):
        if opened.traffic is not None:
            opened.traffic.set_synchronous_mode(False)
    with suppress(RuntimeError):
        world = client.get_world()
        world.set_weather(weather)
        world.apply_settings(settings)


@contextmanager
def _free_port(servers: Servers) -> Iterator[int]:
    """Hold a port that no other process of this user drives a world on; wait for one."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield servers.ports[0]
        return
    folder = Path(tempfile.gettempdir())
    while True:
        for port in servers.ports:
            path = folder / f"sada-gym-carla-{os.getuid()}-{servers.host}-{port}.lock"
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            else:
                yield port
                return
            finally:
                os.close(lock)  # which frees it
        time.sleep(_POLL_S)
