"""The environments: Gymnasium's own checker, its rules of resets, and rewards and episodes by hand."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

from mjx_fit.config.files import read_config  # noqa: E402
from mjx_fit.envs import InsertionEnv, InsertionVectorEnv, reward  # noqa: E402
from mjx_fit.envs.insertion_worlds import Transition  # noqa: E402
from mjx_fit.utils.errors import RequestError  # noqa: E402

ACTIONS, N = 4, 3
CONFIG = read_config(None, [f"task.attempt_actions={ACTIONS}"])
DOWN = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (N, 1))


def batch(mode: AutoresetMode = AutoresetMode.NEXT_STEP, n: int = N, **changes: Any) -> InsertionVectorEnv:
    return InsertionVectorEnv(n, config=changes.pop("config", CONFIG), autoreset_mode=mode, **changes)


@pytest.mark.parametrize("engine", ["native", pytest.param("mjx", marks=pytest.mark.slow)])
def test_gymnasiums_checker_finds_nothing(engine):
    env = gymnasium.make("mjx_fit/Insertion-v0", config=CONFIG, engine=engine)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*render.*")
        warnings.filterwarnings("ignore", ".*not within the observation space bounds.*|.*infinity.*")
        check_env(env.unwrapped, skip_render_check=True)


def test_make_vec_makes_a_batch():
    env = gymnasium.make_vec("mjx_fit/Insertion-v0", num_envs=2, config=CONFIG)
    assert isinstance(env.unwrapped, InsertionVectorEnv)
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    observation, earned, ended, cut, _ = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert earned.shape == ended.shape == cut.shape == (2,)


def test_a_single_world_is_one_of_a_batch():
    alone, among = InsertionEnv(config=CONFIG), batch(n=1)
    first, _ = alone.reset(seed=3)
    firsts, _ = among.reset(seed=3)
    np.testing.assert_array_equal(first, firsts[0])
    for _ in range(ACTIONS):
        one, more = alone.step(DOWN[0]), among.step(DOWN[:1])
        for part, parts in zip(one[:4], more[:4], strict=True):
            np.testing.assert_array_equal(part, parts[0])
    assert one[3]
    assert one[4]["inserted"] == more[4]["inserted"][0]


def test_equal_seeds_give_equal_episodes_and_others_do_not():
    env = batch()
    starts = [env.reset(seed=seed)[0] for seed in (5, 5, 6)]
    steps = [env.step(DOWN)[0] for _ in range(2)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert np.abs(starts[0] - starts[2]).max() > 0
    env.reset(seed=6)
    np.testing.assert_array_equal(env.step(DOWN)[0], steps[0])


def played(mode: AutoresetMode, steps: int) -> list[tuple]:
    env = batch(mode)
    first, _ = env.reset(seed=2)
    return [(first,), *(env.step(DOWN) for _ in range(steps))]


def test_an_episode_begins_by_gymnasiums_rules():
    """Next step: one more step, whose action is ignored. Same step: the last observation is in the info."""
    later = played(AutoresetMode.NEXT_STEP, ACTIONS + 2)
    at_once = played(AutoresetMode.SAME_STEP, ACTIONS + 1)
    assert later[ACTIONS][3].all()
    assert at_once[ACTIONS][3].all()
    last = np.stack(list(at_once[ACTIONS][4]["final_obs"]))
    np.testing.assert_array_equal(later[ACTIONS][0], last)
    ends, told = at_once[ACTIONS][4]["final_info"], later[ACTIONS][4]
    np.testing.assert_array_equal(ends["largest_n"], told["largest_n"])
    assert ends["_inserted"].all()
    begun = at_once[ACTIONS][0]
    np.testing.assert_array_equal(later[ACTIONS + 1][0], begun)
    assert not later[ACTIONS + 1][2].any() | later[ACTIONS + 1][3].any()
    np.testing.assert_array_equal(later[ACTIONS + 1][1], 0)
    np.testing.assert_array_equal(later[ACTIONS + 2][0], at_once[ACTIONS + 1][0])
    assert np.abs(begun - later[0][0]).max() > 0  # another hole


def test_without_automatic_resets_a_world_waits_for_its_own():
    env = batch(AutoresetMode.DISABLED)
    env.reset(seed=2)
    done = [env.step(DOWN) for _ in range(ACTIONS + 1)]
    assert done[ACTIONS - 1][3].all()
    assert not done[ACTIONS][3].any()
    np.testing.assert_array_equal(done[ACTIONS][1], 0)
    env.reset(options={"reset_mask": np.array([True, False, False])})
    after = env.step(DOWN)
    assert after[1][0] != 0
    np.testing.assert_array_equal(after[1][1:], 0)


def test_episodes_of_a_world_do_not_depend_on_what_others_do(monkeypatch):
    """World 0 ends early in one run: the second episodes of the others stay the same."""
    starts = []
    for early in (False, True):
        env = batch(AutoresetMode.SAME_STEP)
        env.reset(seed=4)
        step = env._worlds.step

        def cut(action, step=step, early=early, worlds=env._worlds) -> Transition:
            done = step(action)
            ends = done.terminated | (np.arange(N) == 0) & early & (worlds._length == 2)
            return replace(done, terminated=ends)

        monkeypatch.setattr(env._worlds, "step", cut)
        starts.append([env.step(DOWN)[0] for _ in range(ACTIONS)][-1])
    np.testing.assert_array_equal(starts[0][1:], starts[1][1:])
    assert np.abs(starts[0][0] - starts[1][0]).max() > 0


def test_an_inserted_peg_ends_its_episode_and_earns_what_it_gained():
    """Straight down from a perfect detection; the sum of the gains is the difference of the potentials."""
    config = read_config(None, ["detector.half_width_m=0.00001", "task.attempt_actions=40"])
    env, sparse = (batch(AutoresetMode.SAME_STEP, config=config, reward=kind) for kind in ("dense", "sparse"))
    totals = {}
    for name, one in (("dense", env), ("sparse", sparse)):
        one.reset(seed=0)
        total, over, count = np.zeros(N), np.zeros(N, bool), np.zeros(N)
        for _ in range(40):
            _, earned, ended, cut, info = one.step(DOWN)
            total += np.where(over, 0, earned)
            count += ~over
            if "inserted" in info:
                assert info["inserted"][ended].all()
            over |= ended | cut
        totals[name] = total
        assert over.all()
    np.testing.assert_array_equal(totals["sparse"], 1)
    depth_cm = 100 * config.task.insertion_depth_m
    want = reward.INSERTED + depth_cm + reward.PER_ACTION * count
    np.testing.assert_allclose(totals["dense"], want, atol=0.3)


def test_observations_hold_no_truth():
    """Two holes with the same detection look alike before the first contact."""
    env = batch(n=1)
    env.reset(seed=7)
    before = env._worlds.observation()
    env._worlds._hole += 0.01
    np.testing.assert_array_equal(env._worlds.observation(), before)


OWN_GAP = read_config(
    None,
    [
        "scene.shapes=[{name: square, rectangles: [[-0.015, -0.015, 0.015, 0.015]], clearance_m: 0.001}]",
        "randomize.clearance_m={uniform: [0.0008, 0.0012]}",
    ],
)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"num_envs": 0}, "num_envs: 0 is out of range"),
        ({"reward": "big"}, "reward: 'big' is invalid: expected one of dense, sparse"),
        ({"autoreset_mode": "Never"}, "autoreset_mode: 'Never' is invalid: expected one of NextStep"),
        ({"config": read_config(None, ["placement.grip_n=9"])}, r"placement\.grip_n: 9 is invalid"),
        ({"config": read_config(None, ["task.success=sensed"])}, r"task\.success: sensed is invalid"),
        ({"config": "gentle.yaml"}, "config: 'gentle.yaml' is invalid: expected a Config"),
        ({"config": OWN_GAP}, r"randomize\.clearance_m cannot be drawn: square"),
        ({"engine": "cuda"}, "engine: 'cuda' is invalid: expected one of native, mjx"),
        ({"world": "home", "config": CONFIG}, "world: it cannot be used beside config"),
    ],
)
def test_what_cannot_be_made_is_refused(wanted, message):
    with pytest.raises(RequestError, match=message):
        InsertionVectorEnv(**wanted)


def test_a_step_before_the_reset_and_unknown_options_are_refused():
    with pytest.raises(RequestError, match="reset: it has to come before the first step"):
        batch().step(DOWN)
    with pytest.raises(RequestError, match="options: 'mask' is unknown: expected reset_mask"):
        batch().reset(options={"mask": 1})


def test_what_is_no_action_or_no_mask_is_refused_and_nothing_moves():
    env = batch(AutoresetMode.DISABLED)
    with pytest.raises(RequestError, match="reset: it has to come before"):
        env.reset(options={"reset_mask": np.ones(N, bool)})
    start, _ = env.reset(seed=0)
    wrong: Any
    for wrong, message in (
        (DOWN[:2], r"actions: \(2, 3\) is invalid: expected \(3, 3\)"),
        (np.full((N, 3), np.nan), "actions: a value is not finite"),
        ([["down"] * 3] * N, r"actions: .* is invalid: expected numbers \(3, 3\)"),
    ):
        with pytest.raises(RequestError, match=message):
            env.step(wrong)
    with pytest.raises(RequestError, match="seed: it cannot be used with reset_mask"):
        env.reset(seed=1, options={"reset_mask": np.ones(N, bool)})
    wrong_seed: Any = [1, 2]
    with pytest.raises(RequestError, match=r"seed: \[1, 2\] is invalid: expected one integer"):
        env.reset(seed=wrong_seed)
    with pytest.raises(RequestError, match=r"reset_mask: int64 \(2,\) is invalid: expected bool \(3,\)"):
        env.reset(options={"reset_mask": np.array([1, 0])})
    np.testing.assert_array_equal(env._worlds.observation(), start)
    with pytest.raises(RequestError, match="reset_mask cannot be used with NextStep resets"):
        batch().reset(options={"reset_mask": np.ones(N, bool)})


def test_a_world_that_diverged_shows_what_was_seen_before_and_begins_anew():
    env = batch(AutoresetMode.SAME_STEP)
    before, _ = env.reset(seed=0)
    worlds = env._worlds._stepped()
    broken = int(worlds._ids[0][0])
    worlds._parts[0]._block.qvel[0] = np.nan
    seen, earned, ended, _, info = env.step(DOWN)
    assert np.flatnonzero(ended).tolist() == [broken]
    assert earned[broken] == reward.BROKEN
    np.testing.assert_array_equal(info["final_obs"][broken][:2], before[broken][:2])
    assert np.isfinite(seen).all()
    assert np.isfinite(env.step(DOWN)[0]).all()
