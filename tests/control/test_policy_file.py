"""Policies from a user's file: they run, they are named in what is stored, and what is none is one line."""

import hashlib

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mjx_fit as mf
from mjx_fit.cli.main import main
from mjx_fit.control.policy_file import load_policy, require_policy
from mjx_fit.data import manifest, reader
from mjx_fit.engines import failures
from mjx_fit.evaluation import results
from mjx_fit.utils.errors import RequestError

FILE = """
import jax
import jax.numpy as jnp
from mjx_fit import Policy

def press(seen):
    return jnp.array([0.0, 0.0, -0.003])

jitted = jax.jit(press)

def _act(count, seen):
    return count + 1, jnp.array([0.0, 0.0, -0.001]) * (count + 1)

deeper = Policy(lambda start, key: jnp.float32(0), _act)
not_a_policy = 3
a_class = Policy
two = lambda seen: jnp.zeros(2)
whole = lambda seen: jnp.zeros(3, int)
grows = Policy(lambda start, key: jnp.zeros(1), lambda s, seen: (jnp.zeros(2), jnp.zeros(3)))
fails = lambda seen: seen.hole_pos_world
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def label(file, name):
    return f"{name}@{hashlib.sha256(file.read_bytes()).hexdigest()[:12]}"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("absent", "has no absent"),
        ("not_a_policy", "is 3: expected a Policy"),
        ("a_class", "expected a Policy"),
        ("two", r"float32 \(2,\): expected floats \(3,\), in m"),
        ("whole", r"int32 \(3,\): expected floats"),
        ("grows", r"changes from \['float32\[1\]'\] to \['float32\[2\]'\]"),
        ("fails", "cannot be used: AttributeError"),
    ],
)
def test_what_is_no_policy_is_refused_in_one_line(file, name, why):
    with pytest.raises(RequestError, match=why) as caught:
        mf.make_engine("native", policy=load_policy(f"{file}:{name}"))
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_used_are_refused_in_one_line(tmp_path):
    with pytest.raises(RequestError, match=r"expected FILE\.py:NAME"):
        load_policy("mine.txt:press")
    with pytest.raises(RequestError, match="cannot be read"):
        load_policy(f"{tmp_path / 'nowhere.py'}:press")
    broken = tmp_path / "broken.py"
    broken.write_text("def (:")
    with pytest.raises(RequestError, match="cannot be run: SyntaxError"):
        load_policy(f"{broken}:press")
    broken.write_text("import sys; sys.exit(0)")
    with pytest.raises(RequestError, match="cannot be run: SystemExit: 0"):
        load_policy(f"{broken}:press")
    with pytest.raises(RequestError, match="name 'a b' is invalid"):
        require_policy(mf.stateless_policy(lambda seen: jnp.zeros(3), "a b"))


def test_collected_data_say_whose_they_are(file, tmp_path, capsys):
    def collect(name, *more):
        asked = [
            "collect",
            "--policy",
            f"{file}:{name}",
            "--episodes",
            "4",
            "--actions",
            "3",
            "--engine",
            "native",
        ]
        return main([*asked, "--out", str(tmp_path / "data"), *more])

    assert collect("press") == 0
    assert manifest.read_manifest(tmp_path / "data").request["policy"] == label(file, "press")
    data = reader.load(tmp_path / "data")
    assert np.asarray(data.rollout.felt.trace.action_world) == pytest.approx(
        np.tile([0, 0, -0.003], (4, 3, 1))
    )
    assert data.policy.tolist() == [2] * 4
    assert main(["data", "check", str(tmp_path / "data")]) == 0
    assert main(["data", "export", str(tmp_path / "data"), "--out", str(tmp_path / "out.hdf5")]) == 0
    with h5py.File(tmp_path / "data" / "shard-00000000.h5") as shard:
        assert np.asarray(shard.attrs["policies"]).tolist() == ["spiral", "random", label(file, "press")]
    with h5py.File(tmp_path / "out.hdf5") as exported:
        assert exported["data/demo_0"].attrs["policy"] == label(file, "press")  # pyright: ignore
    capsys.readouterr()
    assert collect("deeper") == 2
    assert "another run (its policy differs" in capsys.readouterr().err
    file.write_text(FILE.replace("-0.003", "-0.002"))
    assert collect("press") == 2
    assert "another run (its policy differs" in capsys.readouterr().err


def test_a_jitted_function_is_a_policy(file):
    engine = mf.make_engine("native", policy=load_policy(f"{file}:jitted"))
    done = engine.run(mf.draw_attempts(jax.random.key(0), 2), actions=2)
    assert done.felt.trace.action_world[..., 2] == pytest.approx(-0.003)


def test_a_state_goes_from_action_to_action(file):
    engine = mf.make_engine("native", policy=load_policy(f"{file}:deeper"))
    done = engine.run(mf.draw_attempts(jax.random.key(0), 2), actions=3)
    assert done.felt.trace.action_world[0, :, 2] == pytest.approx([-0.001, -0.002, -0.003])


def test_results_say_whose_they_are_and_are_not_replayed(file, tmp_path, capsys):
    own = ["--policy", f"{file}:press", "--engine", "native", "--set", "task.attempt_actions=3"]
    out = tmp_path / "attempt.json"
    assert main(["evaluate", "attempt", "--trials", "2", "--out", str(out), *own]) == 0
    result = results.read(out)
    assert result.request["policy"] == label(file, "press")
    assert {row.method for row in result.summary} == {"press"}
    assembly = [
        "evaluate",
        "assembly",
        "--trials",
        "1",
        "--methods",
        "oracle",
        "--out",
        str(tmp_path / "a.json"),
    ]
    small = ["--set", "task.max_attempts=1", "--set", "task.n_holes=1"]
    assert main([*assembly, *own, *small]) == 0
    assert results.read(tmp_path / "a.json").request["policy"] == label(file, "press")
    capsys.readouterr()
    assert (
        main(["render", str(tmp_path / "a.json"), "--method", "oracle", "--out", str(tmp_path / "a.gif")])
        == 2
    )
    assert "a result does not hold it" in capsys.readouterr().err
    assert main(["evaluate", "attempt", "--out", str(tmp_path / "b.json"), "--policy", "random"]) == 2
    assert "'random' is invalid: choose spiral, raster, tilt, seek or FILE.py:NAME" in capsys.readouterr().err


def test_python_needs_a_name_to_store_a_policy(tmp_path):
    unnamed = mf.make_engine("native", policy=mf.stateless_policy(lambda seen: jnp.zeros(3)))
    plan = mf.CollectionPlan(episodes=2, actions=2, engine="native")
    with pytest.raises(RequestError, match="its custom policy has no name"):
        mf.collect_dataset(tmp_path / "a", plan, engine=unnamed)
    named = mf.make_engine("native", policy=mf.stateless_policy(lambda seen: jnp.zeros(3), "still"))
    with pytest.raises(RequestError, match="'spiral' does not match the engine's custom policy, 'still'"):
        mf.collect_dataset(tmp_path / "a", plan, engine=named)
    assert not (tmp_path / "a").exists()


def test_a_diverged_simulation_names_its_policy(tmp_path):
    def wild(seen):
        return jnp.full(3, jnp.nan)

    policy = mf.stateless_policy(wild, "wild")
    engine = mf.make_engine("native", policy=policy)
    attempts = mf.draw_attempts(jax.random.key(0), 2)
    reporting = failures.Reporting(engine, mf.Config(), tmp_path / "broken")
    assert not reporting.run(attempts, actions=2).truth.valid.any()
    kept = sorted((tmp_path / "broken").iterdir())
    with pytest.raises(RequestError, match="needs the custom policy of its engine"):
        failures.replay(kept[0])
    assert not failures.replay(kept[0], policy).truth.valid[0]
