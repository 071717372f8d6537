"""A trained sensor with the configuration that it was trained with."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mjx_fit.config.quantities import MEASURED, NUMERICAL, QUANTITIES
from mjx_fit.config.randomized import difference, not_covered
from mjx_fit.config.schema import Config, config_differences, shape_differences
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.utils.errors import RequestError

_SECTIONS = ("scene", "control", "arm", "spiral", "random", "detector", "wrist", "pose")
_OF_THE_TASK = ("attempt_actions", "insertion_depth_m")
"""Keys of the section ``task`` that traces depend on, like all keys of ``_SECTIONS``."""


@dataclass(frozen=True)
class TrainedSensor:
    """Contact sensor of a finished training run.

    Example:
        >>> import mjx_fit as mf
        >>> sensor = mf.load_sensor()
        >>> sensor.differences(mf.load_config(None, "scene.friction=0.1"))
        ['scene.friction is 0.25 to 1.25 there and 0.1 here']

    Attributes:
        network: The neural network.
        config: Configuration of the training run.
        fingerprint: Unique identifier of the trained weights.
    """

    network: ContactSensor
    config: Config
    fingerprint: str

    def adapt(self, config: Config) -> Config:
        """Replace the sections ``sensor`` and ``train`` of a configuration by those of the trained sensor.

        Raises:
            RequestError: The configuration sets other values in them, or has other shapes or coordinates.
        """
        trained = self.config
        if trained.scene.shapes != config.scene.shapes:
            difference = shape_differences(trained.scene.shapes, config.scene.shapes)[0]
            raise RequestError(
                f"--run: cannot be used with other scene.shapes than the sensor was trained on: {difference}"
            )
        reads, believed = (", ".join(one.filter.coordinates) for one in (trained, config))
        if reads != believed:
            raise RequestError(
                f"--run: cannot be used: its sensor reads {reads}, and filter.coordinates has {believed}"
            )
        for section in ("sensor", "train"):
            asked, there = getattr(config, section), getattr(trained, section)
            if asked not in (there, getattr(Config(), section)):
                word = config_differences(trained, config, lambda where, _, own=section: where == own)[0]
                raise RequestError(f"config: {word}: it belongs to the trained sensor and cannot be changed")
        return replace(config, sensor=trained.sensor, train=trained.train)

    def differences(self, config: Config) -> list[str]:
        """List what is new to the sensor: ``section.key is A there and B here``.

        These are quantities with values that they never had in training, and other keys of the physics, the
        measurements and the attempt whose values differ. Shorter attempts are not new to a sensor that reads
        attempts in progress.
        """
        new = not_covered(self.config, config, (*QUANTITIES, *MEASURED))
        quantities = [difference(name, self.config, config) for name in new]
        shorter = config.task.attempt_actions < self.config.task.attempt_actions
        known = {"attempt_actions"} if self.config.sensor.causal and shorter else set()
        differs = config_differences(
            self.config, config, lambda *key: _is_constant(*key) and key[1] not in known
        )
        return quantities + differs

    def say_if_away(self, config: Config, doing: str) -> None:
        """Print a note to stderr if a configuration differs from that of training."""
        if note := away_from_training(self.differences(config)):
            print(f"{doing}: {note}", file=sys.stderr)


def _is_constant(section: str, key: str) -> bool:
    """Return True for what traces depend on and what is the same in all worlds and readings."""
    seen = section in _SECTIONS or (section == "task" and key in _OF_THE_TASK)
    return seen and key not in QUANTITIES and key not in MEASURED and key not in NUMERICAL


def away_from_training(differences: Sequence[str]) -> str:
    """Describe in one line how the settings in use differ from those of training; empty if they agree.

    Args:
        differences: Differences between the training configuration and the one in use, from
            ``config_differences``; those in the sections ``sensor`` and ``train`` are ignored.
    """
    words = [" ".join(str(one).split()) for one in differences]
    words = [one for one in words if not one.startswith(("sensor.", "train."))]
    if not words:
        return ""
    more = f" (and {len(words) - 1} more)" if len(words) > 1 else ""
    return f"settings differ from the sensor's training: {words[0]}{more}"
