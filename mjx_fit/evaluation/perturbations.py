"""Perturbations of the robustness experiment: a different world, or readings with a constant error.

A perturbation changes the configuration that attempts are simulated and read under, or what was measured
before the sensor reads it; the sensor and the filters stay as they are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mjx_fit.config.schema import Config, config_from_tree, config_to_tree
from mjx_fit.sensors.pose import start_of, turned
from mjx_fit.types import Felt
from mjx_fit.utils.errors import RequestError, shown

Change = Callable[[Felt, Config], Felt]
"""Function that returns changed measurements of n attempts."""
SAMPLES_HELD = 4
"""Samples of 500 Hz per sample of a wrench at 125 Hz."""


@dataclass(frozen=True)
class Perturbation:
    """One perturbation; without any field, the unperturbed world.

    Attributes:
        values: New values of configuration keys, ``section.key``.
        factors: Factors of configuration keys.
        felt: Change of the measurements of n attempts.
        other_engine: True to simulate in the other engine.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    felt: Change | None = None
    other_engine: bool = False

    def applied_to(self, config: Config) -> Config:
        """Return the perturbed configuration.

        Raises:
            RequestError: The perturbed configuration is invalid.
        """
        tree = config_to_tree(config)
        for name in (*self.values, *self.factors):
            section, key = name.split(".")
            given = name in self.values
            tree[section][key] = self.values[name] if given else self.factors[name] * tree[section][key]
            if key in tree["randomize"]:  # constant, at the perturbed value
                tree["randomize"][key] = None
        return config_from_tree(tree)


def _turned_by(axis: int, degrees: float) -> Change:
    """Turn all orientations about an axis of the world, as a wrong calibration of the tool does."""
    rotation = np.zeros(3, np.float32)
    rotation[axis] = np.deg2rad(degrees)

    def change(felt: Felt, config: Config) -> Felt:
        start = start_of(felt, config)
        before, during = (
            np.asarray(turned(jnp.asarray(quat), jnp.asarray(rotation)))
            for quat in (start.quat_world, felt.trace.tip_quat_world)
        )
        trace = replace(felt.trace, tip_quat_world=during)
        return replace(felt, trace=trace, start=replace(start, quat_world=before))

    return change


def _raised_by(height_m: float) -> Change:
    """Shift all heights, as a wrong height of the table does."""
    offset = np.array([0, 0, height_m], np.float32)

    def change(felt: Felt, config: Config) -> Felt:
        start = start_of(felt, config)
        trace = replace(felt.trace, tip_pos_world=felt.trace.tip_pos_world + offset)
        return replace(
            felt, trace=trace, start=replace(start, pos_world=np.asarray(start.pos_world) + offset)
        )

    return change


Wrench = Float[np.ndarray, "n J 50 6"]


def _tared_wrench(change: Callable[[Wrench], Wrench]) -> Change:
    def perturbed(felt: Felt, _: Config) -> Felt:
        tare = np.asarray(felt.tare_sensor)[:, None, None]
        wrench = change(np.asarray(felt.trace.wrench_sensor) - tare) + tare
        return replace(felt, trace=replace(felt.trace, wrench_sensor=wrench.astype(np.float32)))

    return perturbed


def _interpolated(wrench: Wrench) -> Wrench:
    """Sample at 125 Hz and interpolate linearly, as the tracker does with a log of that rate."""
    flat = wrench.reshape(len(wrench), -1, 6)
    step = np.arange(flat.shape[1])
    before = step // SAMPLES_HELD * SAMPLES_HELD
    after = np.minimum(before + SAMPLES_HELD, (flat.shape[1] - 1) // SAMPLES_HELD * SAMPLES_HELD)
    share = ((step - before) / SAMPLES_HELD)[:, None]
    return ((1 - share) * flat[:, before] + share * flat[:, after]).reshape(wrench.shape)


_FORCE_X = np.array([1, 0, 0, 0, 0, 0], np.float32)
_FORCES = np.array([1, 1, 1, 0, 0, 0], np.float32)
_ANGLE = float(np.deg2rad(1))
_GAINS = ("control.kp_position", "control.kp_orientation")

PERTURBATIONS: dict[str, Perturbation] = {
    "home": Perturbation(),
    "tilt_x_0.1deg": Perturbation(felt=_turned_by(0, 0.1)),
    "tilt_y_0.1deg": Perturbation(felt=_turned_by(1, 0.1)),
    "yaw_0.1deg": Perturbation(felt=_turned_by(2, 0.1)),
    "orientation_noise_0.05deg": Perturbation({"pose.orientation_noise_rad": float(np.deg2rad(0.05))}),
    "height_-0.5mm": Perturbation(felt=_raised_by(-0.0005)),
    "height_+0.5mm": Perturbation(felt=_raised_by(0.0005)),
    "position_noise_0.5mm": Perturbation({"pose.position_noise_m": 0.0005}),
    "force_bias_1n": Perturbation(felt=_tared_wrench(lambda wrench: wrench + _FORCE_X)),
    "force_gain_+10%": Perturbation(felt=_tared_wrench(lambda wrench: wrench * (1 + 0.1 * _FORCES))),
    "wrench_125hz": Perturbation(felt=_tared_wrench(_interpolated)),
    "wrench_lowpass_30hz": Perturbation({"wrist.bandwidth_hz": 30.0}),
    "delay_20ms": Perturbation({"pose.delay_s": 0.02}),
    "friction_0.15": Perturbation({"scene.friction": 0.15}),
    "friction_0.6": Perturbation({"scene.friction": 0.6}),
    "friction_0.8": Perturbation({"scene.friction": 0.8}),
    "gains_-40%": Perturbation(factors=dict.fromkeys(_GAINS, 0.6)),
    "gains_+40%": Perturbation(factors=dict.fromkeys(_GAINS, 1.4)),
    "contact_time_x2": Perturbation(factors={"scene.contact_time_s": 2.0}),
    "socket_up_1mm": Perturbation({"placement.socket_z_m": 0.001}),
    "socket_yaw_3deg": Perturbation({"placement.socket_yaw_rad": 3 * _ANGLE}),
    "socket_yaw_10deg": Perturbation({"placement.socket_yaw_rad": 10 * _ANGLE}),
    "socket_tilt_3deg": Perturbation({"placement.socket_pitch_rad": 3 * _ANGLE}),
    "grasp_shift_3mm": Perturbation({"placement.grasp_x_m": 0.003}),
    "grasp_yaw_3deg": Perturbation({"placement.grasp_yaw_rad": 3 * _ANGLE}),
    "grasp_tilt_3deg": Perturbation({"placement.grasp_pitch_rad": 3 * _ANGLE}),
    "other_engine": Perturbation(other_engine=True),
}
"""Perturbations by name; the first is the reference."""


def chosen_perturbations(names: str) -> dict[str, Perturbation]:
    """Return the perturbations with these names, comma-separated, in this order.

    Raises:
        RequestError: A name is unknown or given twice.
    """
    asked = [name.strip() for name in names.split(",")]
    for name in asked:
        if name not in PERTURBATIONS or asked.count(name) > 1:
            raise RequestError(
                f"--perturbations: {shown(name)} is invalid: expected different ones of "
                f"{', '.join(PERTURBATIONS)}"
            )
    return {name: PERTURBATIONS[name] for name in asked}
