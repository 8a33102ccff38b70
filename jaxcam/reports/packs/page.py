"""The leaderboard's page.

The page is one file, reads nothing from the network, and runs no script but its own: texts in packs
are somebody else's, so they are escaped, and the browser is told the digest of that script.
"""

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from jaxcam.files.paths import read_text
from jaxcam.files.whole import check_free, write_atomically
from jaxcam.reports.html import render
from jaxcam.reports.packs.boards import boards_of, over_tasks, pack_names
from jaxcam.reports.packs.pack import Pack

_SCRIPT = Path(__file__).parents[1] / "templates" / "leaderboard.js"


def write_leaderboard(page: Path, packs: Sequence[Pack], split: str = "test") -> int:
    """Write a leaderboard.

    Args:
        page: The HTML file.
        packs: From `read_packs`.
        split: Which pairs.

    Returns:
        How many settings are on it.

    Raises:
        ConfigError: No pack has rollouts of such pairs, or the page is there and not ours.
    """
    check_free(page, flag="--leaderboard")
    boards = boards_of(packs, split)
    script = read_text(_SCRIPT)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    pairs = "held-out pairs" if split == "test" else f"{split} pairs"
    subtitle = (
        f"Success of {sum(len(board.lines) for board in boards)} settings from {len(packs)} packs "
        f"on {pairs} of an initial state and a camera pose."
    )
    text = render(
        "leaderboard.html",
        "Leaderboard",
        subtitle,
        boards=boards,
        over=over_tasks(boards),
        tasks=list(dict.fromkeys(board.task for board in boards)),
        packs=list(zip(pack_names(packs), packs, strict=True)),
        script=script,
        digest=digest,
    )
    write_atomically(page, text)
    return sum(len(board.lines) for board in boards)
