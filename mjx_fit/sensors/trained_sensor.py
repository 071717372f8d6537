"""A trained sensor with the configuration that it was trained with."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mjx_fit.config.quantities import MEASURED, QUANTITIES
from mjx_fit.config.randomized import difference, not_covered
from mjx_fit.config.schema import Config, config_differences
from mjx_fit.sensors.contact_sensor import ContactSensor
from mjx_fit.utils.errors import RequestError

_SEEN = (
    *(
        f"{section}."
        for section in ("scene", "control", "arm", "spiral", "random", "detector", "wrist", "pose")
    ),
    "task.attempt_actions ",
    "task.insertion_depth_m ",
)
"""What a sensor's traces depend on."""


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
            RequestError: The configuration sets other values in them, or has shapes unknown to the sensor.
        """
        trained = self.config
        if trained.scene.shapes != config.scene.shapes:
            there, here = (", ".join(one.scene.names) for one in (trained, config))
            raise RequestError(
                f"--run: cannot be used with scene.shapes ({here}): the sensor was trained on ({there})"
            )
        for section in ("sensor", "train"):
            asked, there = getattr(config, section), getattr(trained, section)
            if asked not in (there, getattr(Config(), section)):
                word = next(
                    word for word in config_differences(trained, config) if word.startswith(f"{section}.")
                )
                raise RequestError(f"config: {word}: it belongs to the trained sensor and cannot be changed")
        return replace(config, sensor=trained.sensor, train=trained.train)

    def differences(self, config: Config) -> list[str]:
        """List what is new to the sensor: ``section.key is A there and B here``.

        These are quantities with values that they never had in training, and other keys of the physics, the
        measurements and the attempt whose values differ.
        """
        quantities = (*QUANTITIES, *MEASURED)
        new = not_covered(self.config, config, quantities)
        return [difference(name, self.config, config) for name in new] + [
            words
            for words in config_differences(self.config, config)
            if words.startswith(_SEEN) and words.partition(".")[2].partition(" ")[0] not in quantities
        ]

    def say_if_away(self, config: Config, doing: str) -> None:
        """Print a note to stderr if a configuration differs from that of training."""
        if note := away_from_training(self.differences(config)):
            print(f"{doing}: {note}", file=sys.stderr)


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
