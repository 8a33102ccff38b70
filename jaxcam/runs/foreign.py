"""The record of a foreign policy's folder: who was evaluated, and what it was sent.

Such a folder has rows and a page as a run's has, and `foreign.json` in place of `config.json`.
"""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxcam.config.fields import check_types, from_json, short, to_json
from jaxcam.config.names import ActionSpace, RayFrame, RaysFrom, Rotations, SceneName, TaskName
from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text
from jaxcam.files.whole import write_atomically
from jaxcam.runs.identity import Settings

FILE = "foreign.json"
NOT_SAID = "not said"
"""The conditioning of a policy that is sent its cameras and does not say what it does with them."""


@dataclass(frozen=True)
class ForeignRecord:
    """Who was evaluated, and how.

    Attributes:
        name: What it is called.
        address: Of the server, or of the function.
        task: What it had to do.
        scene: In which scene.
        conditioning: How it is given its camera, as it says; `NOT_SAID` if it does not.
        views: Cameras that it sees at once.
        resolution: Size of its pictures.
        action_space: What its actions mean.
        rotations: What the rotation vectors of eef_abs are counted from.
        execute: Steps of a chunk that are executed; all of them when None.
        observation_steps: Observations that it sees at once.
        keys: What it is sent under which name, see `jaxcam.config.foreign.ObsMap`.
        answer: Its name for the actions.
        prompt: What it is told to do.
        metadata: What it says of itself.
        weights_sha: Digest of what it says of itself, and of a function's file. It ties rows to
            what acted as far as anybody outside can know.
    """

    name: str
    address: str
    task: TaskName
    scene: SceneName
    conditioning: str
    views: int
    resolution: int | str
    action_space: ActionSpace
    rotations: Rotations
    execute: int | None
    observation_steps: int
    keys: dict[str, Any] | None
    answer: str
    prompt: str
    metadata: dict[str, Any]
    weights_sha: str

    @property
    def policy(self) -> str:
        """Its name, which stands where runs have their kind of policy."""
        return self.name

    @property
    def seed(self) -> int | None:
        """Of its training, which nobody knows."""
        return None

    @property
    def engine(self) -> str:
        """The fastest of those that it can be asked from is the evaluation's to choose."""
        return "auto"

    @property
    def ensemble(self) -> float:
        """Whether it averages is its own affair."""
        return 0.0

    @property
    def rays_from(self) -> RaysFrom:
        """It is told its cameras' own intrinsics."""
        return "true"

    @property
    def ray_frame(self) -> RayFrame:
        """It is told poses in the robot's base frame."""
        return "base"

    @property
    def settings(self) -> Settings:
        """What makes it comparable to others, as `jaxcam.runs.identity.identity` of a run."""
        names = ("task", "scene", "policy", "conditioning", "views", "resolution", "action_space")
        settings = {"preset": None, **{name: getattr(self, name) for name in names}}
        usual = {"rotations": "nominal", "execute": None, "observation_steps": 1}
        unusual = {k: v for k in usual if (v := getattr(self, k)) != usual[k]}
        return settings | unusual

    def __post_init__(self) -> None:
        check_types(self)


def has_foreign(folder: Path) -> bool:
    """Whether a folder is of a foreign policy."""
    return (folder / FILE).is_file()


def read_foreign_record(folder: Path) -> ForeignRecord:
    """The record of a foreign policy's folder.

    Raises:
        ConfigError: It is damaged, or cannot be read.
    """
    try:
        text = read_text(folder / FILE)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{folder / FILE} cannot be read: {error}.") from error
    return from_json(ForeignRecord, text, str(folder / FILE))


def keep_record(folder: Path, record: ForeignRecord) -> None:
    """Makes the folder of a foreign policy, or sees that the one that is there is this policy's.

    A server may have moved, if it says anything by which it is known.

    Args:
        folder: Which.
        record: Of the policy.

    Raises:
        ConfigError: The folder is a run's, or of another policy, or of another way to ask it.
    """
    if (folder / "config.json").exists():
        raise ConfigError(f"{folder} is the folder of a run. Choose another --run-dir.")
    if has_foreign(folder):
        known = read_foreign_record(folder)
        apart = {"weights_sha", "address"} if record.metadata else {"weights_sha"}
        names = [f.name for f in dataclasses.fields(record) if f.name not in apart]
        changed = [name for name in names if getattr(known, name) != getattr(record, name)]
        if changed or known.weights_sha != record.weights_sha:
            raise ConfigError(
                f"{folder} has rows of another policy, or of one that was asked in another way: "
                f"{_differences(known, record, changed)}. Give this one another --name, or move "
                "the folder away."
            )
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / FILE, to_json(record))


def _differences(known: ForeignRecord, record: ForeignRecord, names: list[str]) -> str:
    """What is not as it was, in words; of metadata only the entries that differ."""
    words = []
    for name in names:
        before, now = getattr(known, name), getattr(record, name)
        if name == "metadata":
            keys = sorted(k for k in {*before, *now} if before.get(k) != now.get(k))
            words += [f"metadata {k}: {short(before.get(k))} -> {short(now.get(k))}" for k in keys]
        else:
            words.append(f"{name}: {short(before)} -> {short(now)}")
    return "; ".join(words) or "the function's file has changed"


def as_json(value: Any, depth: int = 0) -> Any:
    """What a policy says of itself as JSON has it: arrays as lists, anything odd as text.

    Args:
        value: What it says.
        depth: In how much else that is.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = cast(Any, value).tolist()
    if isinstance(value, dict | list | tuple) and depth >= _DEEPEST:
        return "…"
    if isinstance(value, dict):
        content = cast("dict[Any, Any]", value)
        return {_text(str(k)): as_json(v, depth + 1) for k, v in content.items()}
    if isinstance(value, list | tuple):
        return [as_json(part, depth + 1) for part in cast("list[Any]", value)]
    if isinstance(value, str):
        return _text(value)
    whole = isinstance(value, int) and abs(value) < 2**63
    if value is None or whole or (isinstance(value, float) and math.isfinite(value)):
        return value
    return repr(value)


_DEEPEST = 50
"""Of what a policy says, what is deeper than this is left out."""


def _text(text: str) -> str:
    """The text without what no file's name can have."""
    return text.encode(errors="backslashreplace").decode().replace("\0", "\\0")


def digest(*parts: Any) -> str:
    """A short digest of what JSON can write."""
    text = json.dumps(parts, sort_keys=True)
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:16]
