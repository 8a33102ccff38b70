"""Which pictures a dataset has, and which samples of them a run takes, given its seed."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxcam.data.demos import Demo, Demos
from jaxcam.data.recorded.recording import Episode
from jaxcam.errors import DatasetError

Sample = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Demonstrations [B], time steps [B] and cameras [B, V] of some samples."""


def errors_of(episodes: Sequence[Demo | Episode]) -> np.ndarray | None:
    """Which commands of each demonstration err on purpose, bool [D, T]; None where none does."""
    if not any(demo.errors is not None and demo.errors.any() for demo in episodes):
        return None
    errors = np.zeros((len(episodes), max(demo.length for demo in episodes)), bool)
    for row, demo in zip(errors, episodes, strict=True):
        if demo.errors is not None:
            row[: demo.length] = demo.errors
    return errors


@dataclass(frozen=True)
class Layout:
    """The order of a dataset's pictures: by demonstration, in it by time, in that by camera."""

    lengths: np.ndarray
    """Control steps of each demonstration [D]."""
    cameras: np.ndarray
    """Number of cameras that see each demonstration [D]."""

    @classmethod
    def of(cls, demos: Demos) -> "Layout":
        """The layout of a dataset; training demonstrations come first, validation ones after."""
        episodes = demos.episodes
        return cls(
            np.array([d.length for d in episodes]), np.array([len(d.cameras) for d in episodes])
        )

    @cached_property
    def first(self) -> np.ndarray:
        """First picture of each demonstration, and after the last the number of all [D + 1]."""
        return np.concatenate([[0], np.cumsum(self.lengths * self.cameras)])

    @property
    def total(self) -> int:
        """Number of pictures."""
        return int(self.first[-1])

    def owner(self, picture: np.ndarray) -> np.ndarray:
        """The demonstration that a picture is of."""
        return np.searchsorted(self.first, picture, side="right") - 1

    def at(self, demo: np.ndarray, t: np.ndarray, camera: np.ndarray) -> np.ndarray:
        """Index of a picture; `camera` counts within the demonstration's window."""
        return self.first[demo] + t * self.cameras[demo] + camera

    def where(self, picture: np.ndarray) -> Sample:
        """The inverse of `at`: demonstration, time step and camera of pictures."""
        demo = self.owner(picture)
        return demo, *np.divmod(picture - self.first[demo], self.cameras[demo])


@dataclass(frozen=True)
class Samples:
    """What a run sees of a dataset, step by step."""

    layout: Layout
    train: int
    """Number of training demonstrations; the rest are for validation."""
    ordered: bool = False
    """Whether the cameras of a sample stand in the order of their window."""
    errors: np.ndarray | None = None
    """Which commands err on purpose, bool [D, T]: no sample begins there."""

    def index(self, seed: int, step: int, batch: int, views: int) -> Sample:
        """The samples of one update: demonstrations, time steps and cameras.

        As in the authors' harness an epoch takes every training demonstration once, in random
        order, each at one random time step and from random distinct cameras of its window.
        """
        place = step * batch + np.arange(batch)
        epochs, slots = np.divmod(place, self.train)
        parts = [self._epoch(seed, int(e), views) for e in np.unique(epochs)]
        which = np.searchsorted(np.unique(epochs), epochs)
        pick = [np.stack([p[k] for p in parts])[which, slots] for k in range(3)]
        return pick[0], pick[1], pick[2]

    def _epoch(self, seed: int, epoch: int, views: int) -> Sample:
        rng = np.random.Generator(np.random.Philox(key=[seed, epoch]))
        order = rng.permutation(self.train)
        steps, counts, first = self._steps
        t = steps[first[order] + np.floor(rng.random(self.train) * counts[order]).astype(int)]
        draws = rng.random((self.train, self.layout.cameras.max()))
        cameras = np.stack(
            [
                np.argsort(r[: self.layout.cameras[d]])[:views]
                for r, d in zip(draws, order, strict=True)
            ]
        )
        return order, t, np.sort(cameras, 1) if self.ordered else cameras

    @cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time steps that samples are of, of all demonstrations; each one's number, and first."""
        lengths = self.layout.lengths
        taken = np.arange(lengths.max(initial=0)) < lengths[:, None]
        if self.errors is not None:
            taken &= ~self.errors
        counts = taken.sum(1)
        return np.nonzero(taken)[1], counts, np.cumsum(counts) - counts

    def spread(self, demo: int, count: int) -> np.ndarray:
        """Evenly spaced steps of a demonstration, of those that do not err."""
        steps, counts, first = self._steps
        return steps[first[demo] + np.linspace(0, counts[demo] - 1, count).astype(int)]

    def validation(self, views: int, per_demo: int = 16) -> Sample:
        """Evenly spaced steps of every validation demonstration."""
        held_out = range(self.train, len(self.layout.lengths))
        t = np.concatenate([self.spread(demo, per_demo) for demo in held_out])
        demos = np.repeat(held_out, per_demo)
        return demos, t, np.arange(views) % self.layout.cameras[demos, None]

    def check_views(self, views: int) -> None:
        """Refuses to train on demonstrations that fewer cameras see than a sample has views.

        Raises:
            DatasetError: Naming the first one.
        """
        shown = self.layout.cameras[: self.train]
        if few := np.flatnonzero(shown < views).tolist():
            raise DatasetError(
                f"demo_{few[0]} of the dataset is seen by {shown[few[0]]} of the {views} cameras "
                f"that a sample shows (--views); {len(few)} of {self.train} demonstrations are. "
                "Choose fewer views, or leave them out."
            )

    def wanted(
        self, seeds: Iterable[int], steps: int, batch: int, views: int, obs_steps: int
    ) -> np.ndarray | None:
        """The pictures that runs of some seeds see.

        Args:
            seeds: Of the runs.
            steps: Updates of each.
            batch: Samples an update.
            views: Cameras a sample.
            obs_steps: Observations a sample.

        Returns:
            Bool [pictures]; None when they are more than half of all.
        """
        wanted = np.zeros(self.layout.total, bool)
        if self.train < len(self.layout.lengths):
            self._mark(wanted, self.validation(views), obs_steps)
        for seed in seeds:
            for epoch in range(-(-steps * batch // self.train)):
                self._mark(wanted, self._epoch(seed, epoch, views), obs_steps)
                if epoch % 100 == 0 and wanted.mean() > 0.5:
                    return None
        return wanted if wanted.mean() <= 0.5 else None

    def _mark(self, wanted: np.ndarray, sample: Sample, obs_steps: int) -> None:
        demo, t, cameras = sample
        times = history(t, obs_steps)[..., None]
        wanted[self.layout.at(demo[:, None, None], times, cameras[:, None])] = True


def history(t: np.ndarray, obs_steps: int) -> np.ndarray:
    """The time steps that are seen at each `t` [B], oldest first, [B, S]."""
    return np.maximum(t[:, None] + np.arange(1 - obs_steps, 1), 0)
