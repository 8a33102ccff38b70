"""Demonstrations that somebody recorded: read, decoded, and judged on what training did not see."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from rich.console import Console

from jaxcam.config.fields import overrides
from jaxcam.config.names import ActionMeaning
from jaxcam.config.sizes import rows_and_columns, size_name
from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset, seen_by_cameras
from jaxcam.data.recorded.fitting import keeping_shape
from jaxcam.data.recorded.parts import HeldOut, Meaning, Parts, make_recorded, meaning_of, parts_of
from jaxcam.data.recorded.pictures import load_recorded_pictures
from jaxcam.data.recorded.recording import Recording
from jaxcam.data.recorded.spaces import as_learned
from jaxcam.data.splits import NO_VALIDATION
from jaxcam.devices import has_accelerator, own
from jaxcam.errors import ConfigError
from jaxcam.evaluation.grip_ways import grip_ways
from jaxcam.evaluation.recorded import action_errors
from jaxcam.files.jsonl import append_jsonl
from jaxcam.files.paths import absolute
from jaxcam.interop.calibrations import require_calibrated
from jaxcam.interop.recordings import read_recording
from jaxcam.models import Policy, policy_settings
from jaxcam.reports.camera_figures import ways_picture
from jaxcam.reports.run_figures import write_action_figures
from jaxcam.reports.run_page import write_report
from jaxcam.reports.style import save
from jaxcam.results.actions import ActionErrors
from jaxcam.runs.action_errors import errors_file, read_errors
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import RECORDED, policy_preset
from jaxcam.runs.interface import Interface
from jaxcam.runs.metrics import read_metrics
from jaxcam.training.state import TrainState


@dataclass(frozen=True)
class Recorded:
    """The demonstrations of a recorded dataset.

    Attributes:
        recording: The dataset, with where its cameras stood, and its actions in the space that is
            learned.
        action_is: What its own actions are.
    """

    recording: Recording = field(repr=False)
    action_is: ActionMeaning = "unknown"

    @classmethod
    def open(cls, config: TrainConfig, console: Console | None = None) -> "Recorded":
        """Reads the folder that the settings name; pictures are left where they are.

        Args:
            config: Settings with a `dataset`, and perhaps `cameras`.
            console: For progress, and for where calibrations are from; silent when None.

        Raises:
            DatasetError: It is in no format that is known, or damaged.
            CameraError: A calibration is impossible.
            ConfigError: Its actions cannot become those that are asked for.
        """
        cameras = absolute(config.cameras) if config.cameras else None
        recording = read_recording(absolute(config.dataset), cameras, console)
        own = recording.action_is if config.action_is == "unknown" else config.action_is
        return cls(as_learned(recording, config), own)

    @property
    def prompts(self) -> tuple[str, ...]:
        """What is asked in its episodes, in words, each once."""
        return tuple(p or "Do what is shown." for p in self.recording.instructions)

    def complete(self, config: TrainConfig) -> TrainConfig:
        """The settings with the counts, views and shape of this dataset.

        Raises:
            ConfigError: What is asked does not go with it.
        """
        self._check_given(config)
        if overrides(config.model).get("heatmap_weight"):
            raise ConfigError(
                "heatmap_weight is for tasks that are simulated: which numbers of a recorded "
                "dataset say that the gripper is closed is not known well enough. Leave it out."
            )
        name, preset = policy_preset(config, has_accelerator())
        usual = [v for v in self.recording.views if v not in config.hold_out_view]
        given = vars(config)
        views = given["views"] or max(1, len(usual))
        conditioning = given["conditioning"] or preset.conditioning
        require_calibrated(self.recording, conditioning, config.action_frame)
        parts = parts_of(self.recording, _held_out(config), views)
        config = replace(
            config,
            task=RECORDED,
            preset=name,
            action_space=given["action_space"] or "native",
            action_is=self.action_is,
            views=views,
            n=max(len(p.views) for p in parts.all),
            m=0,
            demos=parts.train,
            validation=len({p.episode for p in parts.all[parts.train :]}),
            resolution=self._resolution(config, preset.resolution),
            videos=0,
        )
        meaning = self.meaning(config)
        if config.policy != "smolvla" and None in (meaning.grip, meaning.gripper):
            config = replace(config, model=_without_keyframes(config.model))
        return config

    def _check_given(self, config: TrainConfig) -> None:
        """Refuses settings that only a simulator has a use for."""
        of_simulators = "scene rotations engine ensemble fovy aspect centre lens eval_fovy"
        if simulated := config.given(of_simulators):
            raise ConfigError(
                f"{simulated[0]} is for tasks that are simulated, and this dataset was recorded; "
                "leave it out."
            )
        if config.ray_frame != "base":
            raise ConfigError(
                f"--ray-frame {config.ray_frame} needs to know at each step where the base is in "
                "that frame, and a recorded dataset tells of its cameras in the base alone: leave "
                "it out."
            )
        if config.rays_from != "true":
            raise ConfigError(
                "--rays-from nominal needs a usual K, which recorded cameras have not: leave it "
                "out."
            )
        for name in ("n", "m"):
            if getattr(config, name) is not None and config.task != RECORDED:
                raise ConfigError(f"--{name} is for cameras that are simulated; leave it out.")

    def _resolution(self, config: TrainConfig, preset: int) -> int | str:
        """The size of the pictures: as asked, or with a shorter side and the dataset's shape."""
        asked = vars(config)["resolution"] or preset
        if isinstance(asked, str) and "x" in asked:
            return asked
        if config.policy == "smolvla":  # which takes squares
            return int(asked)
        sight = next(iter(self.recording.episodes[0].sights.values()))
        return size_name(*keeping_shape((sight.height, sight.width), rows_and_columns(asked)[0]))

    def meaning(self, config: TrainConfig) -> Meaning:
        """What is known of the numbers, by their names and by what the settings say."""
        return meaning_of(self.recording, config.grip)

    def sizes(self, config: TrainConfig) -> tuple[int, int]:
        """Numbers of an action, and of what the robot feels."""
        return len(self.recording.action_names), len(self.recording.state_names)

    def base_from_actions(self, config: TrainConfig) -> np.ndarray:
        """The frame that grip poses of the actions are in [4, 4]: the base's, as the state's."""
        del config  # a recording does not say more
        return np.eye(4)

    def interface(self, config: TrainConfig) -> Interface:
        """What a policy of the dataset is shown and answers, in the dataset's words."""
        recording = self.recording
        return Interface(
            tuple(v for v in recording.views if v not in config.hold_out_view),
            recording.state_names,
            recording.action_names,
            recording.rate,
            self.prompts[0],
        )

    def parts(self, config: TrainConfig) -> Parts:
        """Its demonstrations, for training and for validation."""
        return parts_of(self.recording, _held_out(config), config.views)

    def dataset(self, configs: Sequence[TrainConfig], console: Console | None) -> Dataset:
        """What runs that differ in their seed are trained on; pictures are decoded once."""
        config, parts = configs[0], self.parts(configs[0])
        if console and len(parts.all) == parts.train:
            console.print(f"{self.recording.path}: {NO_VALIDATION}", soft_wrap=True)
        obs_steps = policy_settings(config, self.prompts).obs_steps
        seeds = [c.seed for c in configs]
        samples = parts.samples(self.recording)
        wanted = samples.wanted(seeds, config.steps, config.batch, config.views, obs_steps)
        size = rows_and_columns(config.resolution)
        folder = absolute(config.data_dir)
        pictures = load_recorded_pictures(self.recording, parts, size, folder, console, wanted)
        dataset = make_recorded(self.recording, parts, pictures, self.meaning(config))
        return seen_by_cameras(dataset, config, self.base_from_actions(config))

    def conclude(
        self,
        config: TrainConfig,
        run: RunDir | None,
        policy: Policy,
        state: TrainState,
        dataset: Dataset,
        console: Console | None,
    ) -> None:
        """Measure the errors of the actions on what was held out, draw, and write the report."""
        if run is None:
            return
        parts = self.parts(config)
        step, params = int(state.step), own(state.eval_params)
        names = self.recording.action_names
        rows = [row for row in read_errors(run.path) if row.step == step]
        if not rows:
            rows = action_errors(policy, params, dataset, parts, names, step)
            errors_file(run.path).parent.mkdir(exist_ok=True)
            append_jsonl(errors_file(run.path), *(row.to_json() for row in rows))
        write_action_figures(run.path / "plots", read_metrics(run.path), rows)
        if (grip := self.meaning(config).grip) is not None:
            ways = grip_ways(policy, params, dataset, parts, grip, self.recording.action_is)
            if ways:
                save(ways_picture(ways), run.path / "pictures" / "grip_ways.png")
        report = write_report(run.path)
        if console:
            for row in rows:
                console.print(_in_words(row), soft_wrap=True)
            console.print(f"Report: {report}", soft_wrap=True)


def _without_keyframes(model: tuple[str, ...]) -> tuple[str, ...]:
    """Changes to a network that learns no keyframes, since nobody says where they are."""
    weight = overrides(model).get("keyframe_weight")
    if weight is None:
        return (*model, "keyframe_weight=0")
    if weight != 0:
        raise ConfigError(
            f"keyframe_weight={weight} needs to know where the grip is and what opens it: name the "
            "grip's place in the state, --grip observation.state[0:3], and let the dataset name a "
            "number of the action after the gripper. Or leave keyframe_weight out."
        )
    return model


def _held_out(config: TrainConfig) -> HeldOut:
    return HeldOut(config.hold_out_view, config.hold_out_episodes, config.validation)


def _in_words(row: ActionErrors) -> str:
    value, low, high = row.mean()
    poses = ""
    if row.rotation_deg or row.translation:
        poses = f", told poses off by {row.rotation_deg:g}° and {100 * row.translation:g} cm"
    span = f" [{low:.2f}, {high:.2f}]" if np.isfinite(low) else ""
    count = len(row.errors)
    return (
        f"Error of actions on {row.group}{poses}: {value:.2f}{span} deviations "
        f"(n = {count} episode{'' if count == 1 else 's'})"
    )
