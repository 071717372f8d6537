"""Moments of a video from a recording: end-effector position, belief and measurements so far."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mjx_fit.config.schema import Config
from mjx_fit.evaluation.recording import Recording, Step
from mjx_fit.scene.parts import plate_top_m
from mjx_fit.scene.robot import ROBOTS
from mjx_fit.sensors.pose import rotation_from_down, start_pose
from mjx_fit.task.assembly_snapshot import EMPTY
from mjx_fit.types import Belief
from mjx_fit.utils.errors import require
from mjx_fit.utils.rates import ACTION_S

ACTIONS_PER_S = round(1 / ACTION_S)
CLEAR_M = 0.09
"""Height of the end effector above the sockets between attempts, in m."""
HANGING = np.zeros(3)
"""Turn of an end effector that points straight down."""
MOVE_S, LEARN_S, END_S = 0.8, 0.7, 1.2
"""Duration of a movement, a belief update and the end in the video, in s, at any speed."""


@dataclass(frozen=True)
class Moment:
    """Content of one frame.

    Attributes:
        step: Index of the recording's step.
        phase: Motion to the hole, attempt, or belief update.
        actions: Actions of the attempt so far, fractional.
        tip_pos_world: End-effector position, m.
        tip_turn_world: Its rotation vector from straight down, rad.
        belief: Belief about all holes.
        content: Type of the peg in each hole; -1 if empty.
        holding: True while the peg is in the hand.
    """

    step: int
    phase: Literal["move", "attempt", "learn"]
    actions: float
    tip_pos_world: Float[np.ndarray, "3"]
    tip_turn_world: Float[np.ndarray, "3"]
    belief: Belief
    content: Int[np.ndarray, "n"]
    holding: bool

    @property
    def tip_world(self) -> Float[np.ndarray, "6"]:
        """Return position (m) and turn (rad) of the end effector."""
        return np.concatenate([self.tip_pos_world, self.tip_turn_world])

    @property
    def filled(self) -> Bool[np.ndarray, "n"]:
        """Return the mask of the filled holes."""
        return self.content != EMPTY


def require_speed(speed: float) -> None:
    """Check that a playback speed is within its range.

    Raises:
        RequestError: It is invalid.
    """
    require("--speed", speed, 0.1, 100)


def home(recording: Recording) -> Float[np.ndarray, "6"]:
    """Return position (m) and turn (rad) of the end effector before an assembly."""
    return np.concatenate([ROBOTS[recording.config.scene.robot].home_m, HANGING])


def moments(recording: Recording, fps: int, speed: float) -> list[Moment]:
    """Return all moments of a recording.

    Args:
        recording: Recording to show.
        fps: Frames per second of the video.
        speed: Playback speed: seconds of an attempt per second of the video.
    """
    shown: list[Moment] = []
    tip = home(recording)
    for index in range(len(recording.steps)):
        shown += moments_of(recording, index, tip, fps, speed)
        tip = shown[-1].tip_world
    return shown + [shown[-1]] * round(END_S * fps)


def moments_of(
    recording: Recording, index: int, tip: Float[np.ndarray, "6"], fps: int, speed: float
) -> list[Moment]:
    """Return the moments of one step: motion from ``tip`` to the hole, attempt, belief update and lift."""
    step, top = recording.steps[index], plate_top_m(recording.config.scene)
    path, clear = _path(step, recording.config), top + CLEAR_M
    shown = [*_move(index, step, path[0], tip, clear, fps), *_attempt(index, step, path, fps, speed)]
    return [*shown, *_learn(index, step, shown[-1].tip_world, clear, fps)]


def _move(number: int, step: Step, start, tip, clear: float, fps: int) -> Iterator[Moment]:
    over = [*start[:2], clear, *HANGING]
    way = np.stack([tip, [*tip[:2], max(clear, tip[2]), *HANGING], over, start])
    for share in _smooth(round(MOVE_S * fps)):
        tip_world = _along(way, share)
        yield Moment(number, "move", 0.0, *tip_world, step.before, step.content, True)


def _attempt(number: int, step: Step, path, fps: int, speed: float) -> Iterator[Moment]:
    length = int(step.rollout.felt.length)
    frames = max(2, round(length / ACTIONS_PER_S / speed * fps))
    for at in np.linspace(0, length, frames):
        whole, rest = min(int(at), length - 1), at - min(int(at), length - 1)
        place = (1 - rest) * path[whole] + rest * path[whole + 1]
        here, belief = (place[:3], place[3:]), _believed(step, whole)
        yield Moment(number, "attempt", at, *here, belief, step.content, True)


def _learn(number: int, step: Step, tip, clear: float, fps: int) -> Iterator[Moment]:
    content = step.content.copy()
    done = bool(step.rollout.taken) or step.helped is not None
    if done:
        content[step.hole if step.helped is None else step.helped] = int(step.rollout.felt.peg_type)
    up, length = np.stack([tip, [*tip[:2], clear, *HANGING]]), int(step.rollout.felt.length)
    last = _believed(step, length - 1)
    for share in _smooth(round(LEARN_S * fps)):
        belief = jax.tree.map(lambda a, b, share=share: (1 - share) * a + share * b, last, step.after)
        tip_world = _along(up, share)
        yield Moment(number, "learn", float(length), *tip_world, belief, content, not done)


def _believed(step: Step, action: int) -> Belief:
    """Return the belief during an action: as the policy reported it, or that before the attempt."""
    if not isinstance(step.rollout.report, Belief):
        return step.before

    def with_hole(before: np.ndarray, told: np.ndarray) -> np.ndarray:
        now = np.array(before)
        now[step.hole] = told[action]
        return now

    return jax.tree.map(with_hole, step.before, step.rollout.report)


def _path(step: Step, config: Config) -> Float[np.ndarray, "steps 6"]:
    """Return position (m) and turn (rad) of the end effector before the first action and after each."""
    felt = step.rollout.felt
    place, turn = start_pose(felt.estimate_world, config)
    first = np.concatenate([place, HANGING if turn is None else turn])
    turns = rotation_from_down(jnp.asarray(felt.trace.tip_quat_world))
    tips = np.concatenate([felt.trace.tip_pos_world, turns], -1)[: int(felt.length)]
    path = np.concatenate([first[None], tips])
    if not step.rollout.truth.valid:  # the last position of a diverged simulation is invalid
        path[-1] = path[-2]
    return path


def _smooth(frames: int) -> Float[np.ndarray, "frames"]:
    """Return a minimum-jerk profile from 0 to 1: 10 s³ - 15 s⁴ + 6 s⁵."""
    s = np.linspace(0, 1, max(frames, 2))
    return s**3 * (10 - 15 * s + 6 * s**2)


def _along(
    way: Float[np.ndarray, "k 6"], share: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return position and turn at a share of a polyline's length from its beginning."""
    legs = np.linalg.norm(np.diff(way[:, :3], axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(legs)])
    keep = np.concatenate([[True], legs > 0])
    here = np.array([np.interp(share * at[-1], at[keep], way[keep, axis]) for axis in range(6)])
    return here[:3], here[3:]
