"""An attempt as a robot performs it: samples come one at a time, beliefs while it lasts, and advice.

Adding a sample stores it, in memory that is reserved once. ``belief`` reads all actions that are complete;
it answers what the same log, cut there, gives at once. Everything is compiled when the object is made.
"""

from copy import copy
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from mjx_fit.scene.parts import plate_top_m
from mjx_fit.task.advice import Advice, Adviser, Elsewhere, Searched
from mjx_fit.task.attempt_samples import REST_S, AttemptSamples
from mjx_fit.task.hole_choice import Situation, rates_per_s
from mjx_fit.task.logged_attempt import padded
from mjx_fit.task.progress import progress_update
from mjx_fit.task.tracker import BeliefTracker
from mjx_fit.types import Belief
from mjx_fit.utils import numerics
from mjx_fit.utils.arrays import with_row
from mjx_fit.utils.errors import RequestError
from mjx_fit.utils.rates import ACTION_S

_DOWN = np.array([0.0, 1.0, 0.0, 0.0])


class OnlineTracker:
    """Beliefs about holes, sample by sample.

    Example:
        >>> import numpy as np, mjx_fit as mf
        >>> tracker = mf.BeliefTracker(mf.load_sensor(), np.array([[0.45, 0.10], [0.50, -0.12]]))
        >>> online = mf.OnlineTracker(tracker)  # compiles
        >>> online.begin(tracker.choose("cross"))
        >>> for i in range(301):  # at rest above the hole, then pressing down
        ...     if i == 250:
        ...         online.add_command(0.5, np.array([0, 0, -0.002]))
        ...     online.add_wrench(0.002 * i, np.array([0, 0, 5.0 * (i > 260), 0, 0, 0]))
        ...     online.add_pose(0.002 * i, np.array([0.45, 0.10, 0.0252]), np.array([0.0, 1, 0, 0]))
        >>> online.belief().mean_world.shape
        (2,)
        >>> advice = online.advise()

    Attributes:
        tracker: Beliefs between attempts.
        samples: Samples of the attempt.
    """

    def __init__(self, tracker: BeliefTracker, most_n: float = 60.0):
        """Reserve memory and compile.

        Args:
            tracker: Beliefs about the holes; its sensor reads attempts in progress.
            most_n: Force at which the advice is to stop, N.

        Raises:
            RequestError: The tracker has no sensor: the geometry of the parts takes seconds for an attempt.
        """
        if tracker.sensor is None:
            raise RequestError(
                "online: a tracker without a sensor cannot be used: expected a trained sensor, since the "
                "geometry of the parts takes longer than an action"
            )
        self.tracker = tracker
        self._progress = progress_update(tracker.config, tracker.sensor.network)
        self._adviser = Adviser(tracker.config, most_n)
        self._most_actions = tracker.config.task.attempt_actions
        self.samples = AttemptSamples(self._most_actions)
        self._hole: int | None = None
        self._rehearse()

    def begin(self, hole: int) -> None:
        """Begin an attempt at a hole, from ``tracker.estimate(hole)``, at rest in free space."""
        self._prior = self.tracker.prior(hole)
        self._belief = jax.tree.map(lambda leaf: leaf[0], replace(self._prior, memory=None))
        self._hole, self._read = hole, 0
        self._centre, self._path_m = self.tracker.estimate(hole)[:2], 0.0
        self.samples.clear()

    def add_wrench(self, time_s: float, wrench_sensor: Float[np.ndarray, "6"]) -> None:
        """Add a wrench, 100 Hz to 1 kHz, as in ``SensorLog``; what comes late is left out."""
        self.samples.add_wrench(time_s, wrench_sensor)

    def add_pose(
        self,
        time_s: float,
        tip_pos_world: Float[np.ndarray, "3"],
        tip_quat_world: Float[np.ndarray, "4"],
        tip_twist_world: Float[np.ndarray, "6"] | None = None,
    ) -> None:
        """Add a pose of the TCP, 10 Hz or more, as in ``SensorLog``; what comes late is left out.

        Args:
            time_s: Time, s.
            tip_pos_world: Position, m.
            tip_quat_world: Orientation, w x y z.
            tip_twist_world: Linear (m/s) and angular (rad/s) velocity; None, for all poses of an attempt:
                it is differentiated from them.
        """
        before = self.samples.place_world
        self.samples.add_pose(time_s, np.concatenate([tip_pos_world, tip_quat_world]), tip_twist_world)
        after = self.samples.place_world
        touches = self.samples.force_n > self.tracker.config.wrist.contact_force_n
        if before is not None and after is not None and touches:
            self._path_m += float(np.hypot(*(after - before)[:2]))

    def add_command(self, time_s: float, displacement_world: Float[np.ndarray, "3"]) -> None:
        """Add the command of the action that begins now; those after ``task.attempt_actions`` are not read.

        Raises:
            RequestError: There are fewer wrenches before the first command than a tare needs.
        """
        self.samples.add_command(time_s, displacement_world)

    def belief(self) -> Belief:
        """Return the belief about the hole after the actions that are complete, without batch axes.

        Raises:
            RequestError: Samples are missing for longer than 0.1 s, or a pose is impossible.
        """
        hole, n = self._require_hole(), self.samples.actions
        if n != self._read:
            felt = padded(self.tracker.read(hole, self.samples.log()), self._most_actions)
            batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], felt)
            after = self._progress(self._prior, batch, numerics.key(0)[None])
            self._belief = jax.tree.map(lambda leaf: np.asarray(leaf)[0], replace(after, memory=None))
            self._read = n
        return self._belief

    def advise(self) -> Advice:
        """Say what to do, by the belief after the actions that are complete.

        Raises:
            RequestError: As in ``belief``.
        """
        hole, belief, here = self._require_hole(), self.belief(), self.samples.place_world
        if here is None:
            return Advice("go on", "no pose is known")
        searched = Searched(self._centre, self._path_m, here, self.samples.force_n)
        advice = self._adviser.advise(belief, searched, self.tracker.peg, self._elsewhere(hole, belief, here))
        if advice.place_world is not None:
            self._centre, self._path_m = np.array(advice.place_world), 0.0
        return advice

    def end(self) -> Belief:
        """End an attempt that failed, and return the posterior (``BeliefTracker.update``)."""
        return self.tracker.update(self._require_hole(), self.samples.log())

    def judge_insertion(self) -> bool:
        """End an attempt whose peg went in; tell whether it is the peg's own hole."""
        return self.tracker.judge_insertion(self._require_hole(), self.samples.log())

    def _elsewhere(self, hole: int, belief: Belief, here_world: Float[np.ndarray, "3"]) -> Elsewhere | None:
        """Return the best of the other empty holes, with this belief about the one that is tried."""
        own = self.tracker
        if own.peg is None:
            return None
        now = jax.tree.map(lambda leaf, new: with_row(leaf, hole, new)[None], own.belief, belief)
        place = here_world[None, :2]
        situation = Situation(now, np.array([own.peg]), own.filled[None], own.tries[None], place)
        rates = np.where(own.filled, 0.0, rates_per_s(situation, place, own.config)[0])
        rates[hole] = 0.0
        best = int(rates.argmax())
        return Elsewhere(best, float(rates[best])) if rates[best] > 0 else None

    def _require_hole(self) -> int:
        if self._hole is None:
            raise RequestError("online: no attempt has begun: call begin(hole)")
        return self._hole

    def _rehearse(self) -> None:
        """Run through an attempt with another tracker, so that everything is compiled."""
        own, config = self.tracker, self.tracker.config
        self.tracker = copy(own)
        self.tracker.filled, self.tracker.tries = np.zeros_like(own.filled), own.tries.copy()
        self.tracker.choose(config.scene.names[0])
        self.begin(0)
        here = np.append(self.tracker.estimate(0)[:2], plate_top_m(config.scene) + 0.002)
        first, period_s = round(REST_S / 0.01), round(ACTION_S / 0.01)
        for i in range(first + 3 * period_s + 2):
            if i >= first and (i - first) % period_s == 0 and i < first + 3 * period_s:
                self.add_command(0.01 * i, np.array([0.0, 0.0, -0.001]))
            self.add_wrench(0.01 * i, np.array([0.0, 0.0, 0.01 * i, 0.0, 0.0, 0.0]))
            self.add_pose(0.01 * i, here, _DOWN)
        self.advise()
        self.end()
        self.judge_insertion()
        self.tracker, self._hole = own, None
