"""Settings of the policy server."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from jaxcam.config.fields import check_least, check_most, check_types
from jaxcam.config.flags import default
from jaxcam.errors import ConfigError


@dataclass(frozen=True)
class ServeConfig:
    """Let robots and others ask a run's policy over a socket, by openpi's protocol.

    Ctrl-C ends the server.
    """

    run: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="RUN")]]
    """Folder of the run."""
    step: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("newest whole one")] = None
    """Checkpoint to serve."""
    host: str = "127.0.0.1"
    """Address to listen at; others than this machine's own need --key or --key-file."""
    port: int = 8000
    """Port to listen at; 0 takes one that is free and tells which."""
    key: Annotated[str, default("none")] = ""
    """What clients must know. Others on this machine can see it among its processes."""
    key_file: Annotated[str, default("none")] = ""
    """File whose first line is the key."""
    cameras: Annotated[str, default("each request's")] = ""
    """JSON file that says where the cameras stand, if they do: requests may then leave it out."""
    ensemble: float = 0.0
    """Rate of temporal ensembling, such as ACT's 0.01: clients ask at every step, and get the mean
    of all that was ever predicted for it; 0 is off."""
    width: int = 1
    """Requests that are computed at once, of those that arrive together; policies see batches of
    exactly this many, since that can change a result's last digits."""
    clients: int = 64
    """Clients at once; more are turned away."""
    largest_mb: int = 32
    """Largest message (MB)."""
    per_second: int = 500
    """Requests a second that a client may make."""

    def __post_init__(self) -> None:
        check_types(self)
        if not self.run:
            raise ConfigError("No run is given. Name a run's folder.")
        check_least(self, 0, "step port")
        check_most(self, 65535, "port")
        check_least(self, -1, "ensemble")
        check_least(self, 1, "width clients largest_mb per_second")
        check_most(self, 1000, "width clients largest_mb")
        check_most(self, 1_000_000, "per_second")
        if self.key and self.key_file:
            raise ConfigError("Give --key or --key-file, not both.")
