"""Draw the picture of the README: one moment of an assembly, with the current beliefs.

    python experiments/scene_picture.py docs/scene.png

Requires offscreen OpenGL, like ``mjx-fit render``.
"""

import sys

import matplotlib.image

from mjx_fit.viz import gl

TRIAL, SHARE = 0, 0.43


def main(path: str) -> None:
    """Play the assembly and save one frame."""
    gl.choose()
    from mjx_fit.config.files import read_config
    from mjx_fit.engines.select import make_engine
    from mjx_fit.evaluation.playback import Pick, record
    from mjx_fit.training.sensor_loader import load_trained_sensor
    from mjx_fit.utils import process_setup, resources
    from mjx_fit.viz.video import still

    process_setup.configure()
    by_covariance = read_config(None, ["task.outcome_model=covariance"])
    engine, sensor = make_engine("auto", by_covariance), load_trained_sensor(resources.folder("weights"))
    *_, recording = record(by_covariance, Pick("full", TRIAL), 0, engine, sensor)
    matplotlib.image.imsave(path, still(recording, SHARE))


if __name__ == "__main__":
    main(sys.argv[1])
