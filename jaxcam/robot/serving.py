"""`python -m jaxcam.serve RUN`: a run's policy, warm, behind a socket."""

import asyncio
import errno
import ipaddress
import socket
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from rich.console import Console

from jaxcam.config.serve import ServeConfig
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.evaluation.evaluator import Candidate
from jaxcam.files.keys import check_key, read_key
from jaxcam.files.paths import absolute
from jaxcam.interrupts import interrupts
from jaxcam.robot.asked import AskedPolicy, load_run
from jaxcam.robot.averaging import Averaging, check_averages
from jaxcam.robot.requests import RequestReader
from jaxcam.robot.rig import Rig, read_rig
from jaxcam.robot.server import Desk, Limits, Server
from jaxcam.robot.session import CONTROLS, Session
from jaxcam.runs.interface import Interface, read_interface
from jaxcam.training.side import CONVENTION

CONVENTIONS = {
    "number": CONVENTION,
    "images": "uint8 [rows, columns, 3], RGB, top row first; of any size, K is for what is sent",
    "intrinsics": "pixels; the picture's corner is (0, 0), its first pixel's centre (0.5, 0.5)",
    "base_from_camera": "p_base = base_from_camera @ p_camera, metres; axes x right, y down, "
    "z forward (OpenCV)",
    "actions": "the first is for the newest observation's step",
}


@dataclass(frozen=True)
class Service:
    """A run's policy, ready to be asked: all of a server but its socket.

    Attributes:
        config: The settings that the run was trained with.
        interface: Names of what its policy is shown and answers.
        policy: The policy.
        rig: Cameras that stand.
        ensemble: Rate of temporal ensembling, 0 is off.
    """

    config: TrainConfig
    interface: Interface
    policy: AskedPolicy
    rig: Rig
    ensemble: float = 0.0

    @classmethod
    def open(cls, settings: ServeConfig) -> "Service":
        """Reads a run and compiles its policy.

        Args:
            settings: Which run, and how it is asked.

        Raises:
            ConfigError: The run, the cameras or the settings do not go together.
            CheckpointError: There is no such checkpoint.
        """
        folder = absolute(settings.run)
        if not folder.is_dir():
            raise ConfigError(f"There is no run {folder}: no such folder. Check the path.")
        config, candidate = load_run(folder, settings.step)
        interface = read_interface(folder, config, candidate.policy.spec)
        rig = Rig({})
        if settings.cameras:
            rig = read_rig(absolute(settings.cameras), interface.views)
        if settings.ensemble:
            check_averages(config)
        policy = AskedPolicy(candidate, config.seed, settings.width)
        return cls(config, interface, policy, rig, settings.ensemble)

    @property
    def candidate(self) -> Candidate:
        """The policy and where it is from."""
        return self.policy.candidate

    @property
    def needs_cameras(self) -> bool:
        """Whether the policy is told where its cameras are."""
        return self.config.conditioning != "none" or self.config.action_frame == "camera"

    def session(self, row: int) -> Session:
        """What is known of a client that comes.

        Args:
            row: Of the batch, for policies with chance.
        """
        spec = self.candidate.policy.spec
        reader = RequestReader(
            self.interface,
            spec,
            width=self.policy.width,
            needs_cameras=self.needs_cameras,
            rig=self.rig,
            prompts=self.candidate.policy.prompts,
        )
        averaging = None
        if self.ensemble:
            averaging = Averaging(check_averages(self.config), self.ensemble)
        return Session(reader, spec.obs_steps, row, averaging)

    def metadata(self) -> dict[str, Any]:
        """What clients are told first."""
        config, policy = self.config, self.candidate.policy
        spec, views = policy.spec, self.interface.views
        ahead = spec.chunk - spec.obs_steps + 1
        return {
            "server": "jaxcam",
            "version": version("jaxcam"),
            "run": self.candidate.folder.name,
            "step": self.candidate.step,
            "weights_sha": self.candidate.weights_sha,
            "task": config.task,
            "scene": config.scene,
            "policy": config.policy,
            "conditioning": config.conditioning,
            "seed": config.seed,
            "prompt": self.interface.prompt,
            "prompts": list(policy.prompts),
            "views": list(views),
            "views_at_once": spec.views,
            "image_size": [spec.height, spec.width],
            "state_names": list(self.interface.state_names),
            "action_names": list(self.interface.action_names),
            "action_space": _space(config),
            "rotations": config.rotations,
            "rate": self.interface.rate,
            "chunk": 1 if self.ensemble else ahead,
            "execute": 1 if self.ensemble else policy.execute,
            "ensemble": self.ensemble,
            "observation_steps": spec.obs_steps,
            "needs_cameras": self.needs_cameras,
            "cameras_given": self.rig.says_all_of(views),
            "width": self.policy.width,
            "draws": self.policy.draws,
            "controls": list(CONTROLS),
            "conventions": CONVENTIONS,
        }


def _space(config: TrainConfig) -> str:
    """What the run's actions are; of a recorded dataset's own, what is known of those."""
    known = config.action_space == "native" and config.action_is != "unknown"
    return config.action_is if known else config.action_space


def key_of(settings: ServeConfig) -> str:
    """What clients must know; empty where they need not know anything.

    Raises:
        ConfigError: The file of the key cannot be read or is empty, or the key is no single word.
    """
    if settings.key_file:
        return read_key(absolute(settings.key_file), "--key-file")
    check_key(settings.key)
    return settings.key


def listen(host: str, port: int, *, has_key: bool) -> socket.socket:
    """A socket where clients come.

    Args:
        host: Address or name of this machine.
        port: Its port; 0 takes a free one.
        has_key: Whether clients need a key, without which only this machine's are let in.

    Raises:
        ConfigError: There is no such address, others may come without a key, or the port is taken.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:  # the last is of a name that none can have
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"--host {host!r}: no such address: {why}.") from error
    if not (has_key or ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback):
        raise ConfigError(
            f"--host {host}: others than this machine could ask the policy. Give --key-file (or "
            "--key), which clients then need, or leave --host out."
        )
    try:
        return socket.create_server(address, family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(
                f"Port {port} of {host} is taken, perhaps by another server. Stop it, or choose "
                "another --port; 0 takes a free one."
            ) from error
        raise ConfigError(f"Cannot listen at {host}, port {port}: {error.strerror}.") from error


def address_of(listening: socket.socket) -> str:
    """The address that clients are given."""
    host, port = listening.getsockname()[:2]
    return f"ws://[{host}]:{port}" if ":" in host else f"ws://{host}:{port}"


def main(settings: ServeConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    key = key_of(settings)
    with (
        interrupts("Stopping the server.", raises=False) as stop,
        listen(settings.host, settings.port, has_key=bool(key)) as listening,
    ):
        service = Service.open(settings)
        if service.needs_cameras:  # any request may come with a lens, which is a program of its own
            service.policy.warm(lens=True)

        def tell(line: str) -> None:
            console.print(line, highlight=False, soft_wrap=True)

        if service.rig.others:
            tell(
                f"{settings.cameras}: {', '.join(service.rig.others)} not used: the policy's views "
                f"are {', '.join(service.interface.views)}."
            )
        limits = Limits(settings.clients, settings.largest_mb * 2**20, settings.per_second)
        desk = Desk(service.metadata(), service.session, tell)
        server = Server(service.policy, desk, key, limits)
        if not stop:
            name = service.candidate.folder.name
            tell(f"Serving {name}, step {service.candidate.step}, on {address_of(listening)}")
            asyncio.run(server.run(listening, lambda: bool(stop)))
        return stop.exit_code
