"""Where foreign policies are: servers behind a socket, and functions in Python.

A source gives each episode somebody to talk to of its own, since policies may remember what they
saw.
"""

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

from jaxcam.client import Client
from jaxcam.errors import ConfigError, NoServerError, PortError, RefusedError, closest
from jaxcam.runs.foreign import as_json, digest


class FailedError(Exception):
    """A policy gave no actions to one episode, which fails; in words.

    Args:
        words: Why.
        refused: Whether it said itself that it will not, as it does of what it cannot read.
    """

    def __init__(self, words: str, *, refused: bool = False) -> None:
        super().__init__(words)
        self.refused = refused


class Talk(Protocol):
    """Whom one episode asks."""

    def ask(self, observation: Mapping[str, Any]) -> Any:
        """The answer: a chunk of actions, or a dict with it.

        Raises:
            FailedError: There is none, and that is the policy's failure.
            NoServerError: There is nobody any more.
        """
        ...

    def close(self) -> None:
        """It is over."""
        ...


class PolicySource(Protocol):
    """Somebody else's policy.

    Attributes:
        address: Where it is.
        metadata: What it says of itself, as JSON has it.
        sha: Digest of what is known of it.
        at_once: Questions that it is asked at once.
    """

    address: str
    metadata: dict[str, Any]
    sha: str
    at_once: int

    def talk(self, answer: str) -> Talk:
        """Somebody to talk to, for one episode.

        Args:
            answer: Their name for the actions.
        """
        ...


@dataclass
class PolicyServer:
    """A policy behind a socket; each episode has a connection of its own.

    Args:
        address: Such as "ws://localhost:8000".
        key: What the server asks for; none if empty.
        timeout: Seconds to wait for an answer.
        at_once: Questions that are sent at once; 0 is one, and to servers of ours as many as they
            answer in one go.
        patience: Seconds to wait for a server that is not there.

    Raises:
        NoServerError: There is no such server.
    """

    address: str
    key: str = ""
    timeout: float = 30.0
    at_once: int = 0
    patience: float = 10.0

    def __post_init__(self) -> None:
        client = self._connect()
        self.metadata = as_json(dict(client.metadata))
        client.close()
        self.sha = digest(self.metadata)
        together = self.metadata.get("width")
        if not self.at_once:
            self.at_once = together if isinstance(together, int) and 1 <= together <= 1000 else 1

    def talk(self, answer: str) -> Talk:
        """A connection for one episode.

        Raises:
            FailedError: It does not begin an episode.
            NoServerError: There is no such server any more, or another one.
        """
        client = self._connect(answer)
        if digest(as_json(dict(client.metadata))) != self.sha:
            client.close()
            raise NoServerError(
                f"{self.address} says something else of itself than when this evaluation began, "
                "so another policy is served there now, whose rows would be mixed with those "
                "before."
            )
        try:
            client.reset()
        except NoServerError:
            raise
        except PortError as error:
            client.close()
            self._connect().close()  # sees that it is still there
            raise FailedError(str(error), refused=isinstance(error, RefusedError)) from error
        return _Connection(client, lambda: self._connect().close())

    def _connect(self, answer: str = "actions") -> Client:
        return Client(
            self.address,
            key=self.key or None,
            timeout=self.timeout,
            patience=self.patience,
            answer=answer,
        )


@dataclass
class _Connection:
    """A connection, for one episode."""

    client: Client
    look: Callable[[], None]
    """Sees that the server is still there: one rollout has failed, and if all others will, that is
    not the policy's failure."""

    def ask(self, observation: Mapping[str, Any]) -> Any:
        before = self.client.reconnects
        try:
            answer = self.client.infer(observation)
        except NoServerError:
            raise
        except RefusedError as error:
            raise FailedError(str(error), refused=True) from error
        except PortError as error:
            self.client.close()
            self.look()
            raise FailedError(str(error)) from error
        if self.client.reconnects > before:  # what it remembered of the episode may be gone
            raise FailedError(f"The connection to {self.client.url} was lost, and made again.")
        return answer

    def close(self) -> None:
        self.client.close()


class PolicyFunction:
    """A policy in Python, NumPy in and NumPy out.

    It is a function of an observation; or an object with `infer(observation)` and perhaps
    `reset()`; or a class of such, of which each episode has an object of its own; or an object with
    `infer_batch(observations)`. Its `metadata`, if it has any, says what a server's would.

    Args:
        address: "module:name"; the module is looked for where the command was started, too.

    Raises:
        ConfigError: There is no such module or name, or it is none of these.
    """

    at_once = 1

    def __init__(self, address: str) -> None:
        self.address = address
        module, self._target = _imported(address)
        try:
            said = getattr(self._target, "metadata", None)
        except Exception as error:
            raise ConfigError(
                f"--policy {address}: its metadata cannot be read: {error}"
            ) from error
        said = {} if said is None else said
        if not isinstance(said, Mapping):
            raise ConfigError(f"--policy {address}: its metadata is no dict.")
        self.metadata: dict[str, Any] = as_json(dict(cast("Mapping[Any, Any]", said)))
        file = Path(getattr(module, "__file__", None) or "")
        code = file.read_bytes().hex() if file.is_file() else ""
        self.sha = digest(self.metadata, address, code)
        self._idle: list[Any] = []

    @property
    def remembers(self) -> bool:
        """Whether one object serves all episodes and says that it remembers them."""
        return not inspect.isclass(self._target) and hasattr(self._target, "reset")

    @property
    def batched(self) -> Callable[[Sequence[Mapping[str, Any]]], Sequence[Any]] | None:
        """What answers several observations at once, if it does."""
        return None if inspect.isclass(self._target) else getattr(self._target, "infer_batch", None)

    def talk(self, answer: str) -> Talk:
        """An object for one episode, told that an episode begins.

        Raises:
            ConfigError: The class gives no object.
            FailedError: It raised an exception when it was told.
        """
        if not inspect.isclass(self._target):
            own = self._target
        else:
            own = self._idle.pop() if self._idle else _made(self._target, self.address)
        if hasattr(own, "reset"):
            answered(lambda _: own.reset(), None)
        given_back = self._idle if inspect.isclass(self._target) else []
        return _Call(getattr(own, "infer", own), lambda: given_back.append(own))


@dataclass
class _Call:
    """A function, for one episode."""

    infer: Callable[[Mapping[str, Any]], Any]
    close: Callable[[], None]

    def ask(self, observation: Mapping[str, Any]) -> Any:
        return answered(self.infer, observation)


def answered(function: Callable[[Any], Any], question: Any) -> Any:
    """What somebody else's function answers.

    Raises:
        FailedError: It raised an exception.
    """
    try:
        return function(question)
    except (Exception, SystemExit) as error:  # whatever it is, it is theirs
        raise FailedError(f"{type(error).__name__}: {error}", refused=True) from error


def _imported(address: str) -> tuple[Any, Any]:
    """A module, and what has the name in it."""
    module_name, _, name = address.partition(":")
    if not (name.isidentifier() and all(p.isidentifier() for p in module_name.split("."))):
        hint = f" Did you mean ws://{address}?" if name.isdecimal() else ""
        raise ConfigError(
            f"--policy {address}: expected ws://HOST:PORT of a server, or module:function.{hint}"
        )
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        where = "" if error.name == module_name else f", which {module_name} imports"
        raise ConfigError(
            f"--policy {address}: no module {error.name!r}{where}. It is looked for where the "
            "command is started, in PYTHONPATH, and among what is installed."
        ) from error
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"--policy {address}: {module_name} cannot be imported: {type(error).__name__}: {error}"
        ) from error
    if not hasattr(module, name):
        known = [n for n in vars(module) if not n.startswith("_")]
        raise ConfigError(
            f"--policy {address}: {module_name} has no {name!r}{closest(name, known)}"
        )
    target = getattr(module, name)
    asks = ("infer", "infer_batch")
    if not (callable(target) or any(hasattr(target, ask) for ask in asks)):
        raise ConfigError(
            f"--policy {address}: {name} is {type(target).__name__}; expected a function of an "
            "observation, or an object with infer(observation)."
        )
    if inspect.isclass(target) and not hasattr(target, "infer"):
        raise ConfigError(f"--policy {address}: the class {name} has no infer(observation).")
    return module, target


def _made(target: type, address: str) -> Any:
    try:
        return target()
    except Exception as error:
        raise ConfigError(
            f"--policy {address}: {target.__name__}() failed: {type(error).__name__}: {error}"
        ) from error
