"""`python -m jaxcam.view TARGET…`: what there is, in a browser, or in one file."""

from rich.console import Console

from jaxcam.config.commands import ViewConfig
from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import check_free, write_atomically
from jaxcam.interrupts import interrupts
from jaxcam.viewer.page import render_page
from jaxcam.viewer.server import PageDesk, serve
from jaxcam.viewer.sources import Viewed, open_viewed


def main(config: ViewConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    save = absolute(config.save) if config.save else None
    if save:
        check_free(save, tuple(absolute(target) for target in config.target), "--save")
    shown = open_viewed(config, console)
    number = _chosen(shown, config.episode)
    if save:
        with console.status("drawing"):
            page = render_page(shown.exhibit(number), number=number)
        write_atomically(save, page)
        console.print(f"Page: {save} ({len(page) / 1e6:.1f} MB)", soft_wrap=True, markup=False)
        return 0

    def make(wanted: int) -> str:
        with console.status("drawing"):
            return render_page(shown.exhibit(wanted), shown.episodes, wanted)

    def tell(address: str) -> None:
        console.print(
            f"{shown.name} is at {address} (Ctrl-C ends)", soft_wrap=True, highlight=False,
            markup=False,
        )  # fmt: skip

    with interrupts("Stopping the viewer.") as stop:
        serve(PageDesk(make, shown.episodes, number), config.port, tell, lambda: bool(stop))
        return stop.exit_code


def _chosen(shown: Viewed, episode: int | None) -> int:
    """The number of the episode that is shown first."""
    if episode is None:
        return next(iter(shown.episodes))
    if episode not in shown.episodes:
        numbers = sorted(shown.episodes)
        known = f"{numbers[0]} to {numbers[-1]}"
        if len(numbers) <= numbers[-1] - numbers[0]:
            known = ", ".join(map(str, numbers[:20])) + (", …" if len(numbers) > 20 else "")
        raise ConfigError(f"{shown.name} has no episode {episode}. Known: {known}.")
    return episode
