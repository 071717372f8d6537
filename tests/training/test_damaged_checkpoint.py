"""Checkpoints that are damaged, planted, or made before there were digests: never another sensor."""

import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from places import EARLIER_RUN

from mjx_fit.training import checkpoint, step_folder
from mjx_fit.training.checkpoint import BEST, LAST, load, load_sensor, save
from mjx_fit.utils import resources
from mjx_fit.utils.errors import RequestError

EARLIER = EARLIER_RUN
ARRAYS = {
    "weights.kernel": np.linspace(-1, 1, 1200, dtype=np.float32).reshape(30, 40),
    "weights.bias": np.zeros(40, np.float32),
    "step": np.int32(7),
    "best_nll": np.array([np.inf, -3.0]),
    "flag": np.array([True, False]),
}


@pytest.fixture
def folder(tmp_path) -> Path:
    save(tmp_path / LAST, 7, {name: np.asarray(leaf) for name, leaf in ARRAYS.items()})
    return tmp_path / LAST


def files_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def refusal(folder: Path, capfd) -> str:
    """What is said of a checkpoint that is refused: one line, and nothing beside it on stderr."""
    capfd.readouterr()
    with pytest.raises(RequestError) as error:
        load(folder)
    assert capfd.readouterr().err == ""
    words = str(error.value)
    assert words.startswith(f"checkpoint: {folder}")
    assert words.isprintable()
    return words


def test_arrays_come_back_as_they_were(folder):
    step, arrays = load(folder) or (0, {})
    assert step == 7
    assert arrays.keys() == ARRAYS.keys()
    for name, leaf in ARRAYS.items():
        assert arrays[name].dtype == np.asarray(leaf).dtype
        np.testing.assert_array_equal(arrays[name], leaf)


def test_one_checkpoint_is_kept_and_left_overs_go(folder):
    (folder / f"9.{'0' * 16}.tmp" / "default").mkdir(parents=True)
    (folder / "3.orbax-checkpoint-tmp-123").mkdir()
    assert (load(folder) or (0,))[0] == 7
    for step in (8, 8, 12):
        save(folder, step, {"a": np.full(3, step)})
        assert [path.name for path in folder.iterdir()] == [str(step)]
        assert (load(folder) or (0, {}))[1]["a"].tolist() == [step] * 3


def test_what_fails_leaves_the_checkpoint_before(folder, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint.stored_arrays, "write", full)
    with pytest.raises(OSError, match="No space"):
        save(folder, 8, {"a": np.zeros(3)})
    assert [path.name for path in folder.iterdir()] == ["7"]


@pytest.mark.parametrize("source", ["weights", "frame_by_frame", "last"])
def test_a_bit_flipped_is_refused_wherever_it_is(source, folder, tmp_path, capfd):
    if source != "last":
        run = resources.folder("weights") / source.replace("weights", ".")
        shutil.copytree(run / BEST, folder, dirs_exist_ok=True)
        shutil.rmtree(folder / "7")
    rng, places = random.Random(5), files_in(folder)
    assert len(places) > 8
    for i in range(60):
        path = places[i % len(places)]
        content = path.read_bytes()
        damaged = bytearray(content)
        damaged[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        assert path.name in (words := refusal(folder, capfd)) or "digests.json" in words
        path.write_bytes(content)
    load(folder)


def test_a_file_that_is_missing_or_one_too_many_is_named(folder, capfd):
    places = files_in(folder)
    for path in places:
        content = path.read_bytes()
        path.unlink()
        assert path.name in refusal(folder, capfd)
        path.write_bytes(content)
        path.write_bytes(content[:-1])
        assert path.name in refusal(folder, capfd)
        path.write_bytes(content)
    more = folder / "7" / "default" / "more"
    more.write_bytes(b"")
    assert "default/more is not in digests.json" in refusal(folder, capfd)
    more.unlink()
    more.symlink_to("/etc/hostname")
    assert "default/more is not a regular file" in refusal(folder, capfd)
    more.unlink()
    assert load(folder) is not None


@pytest.mark.parametrize(
    "text", ["", "[" * 10_000, "{}", "[]", '{"../../x": "0"}', "{" * 3 + "NaN", '"\ud800"']
)
def test_digests_that_are_none(text, folder, capfd):
    (folder / "7" / "digests.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    assert "7 cannot be read" in refusal(folder, capfd)


@pytest.mark.parametrize(
    "name", ["1" + "0" * 30, "-1", "007", "1e3", "٣", "latest", "7 ", "999\x1b[2J", "0x7"]
)
def test_a_step_that_is_none_is_one_line(name, folder, capfd):
    """Found beside a checkpoint, or in the place of it."""
    (folder / name).mkdir()
    assert "is not a checkpoint" in refusal(folder, capfd)
    shutil.rmtree(folder / "7")
    assert "is not a checkpoint" in refusal(folder, capfd)


def test_an_empty_step_is_one_line_and_a_link_is_none(folder, capfd):
    (folder / "999").mkdir()
    assert "999 cannot be read: it is empty" in refusal(folder, capfd)
    (folder / "999" / "default").mkdir()
    assert "999 cannot be read: it is empty" in refusal(folder, capfd)
    shutil.rmtree(folder / "999")
    (folder / "999").symlink_to(folder / "7")
    assert "'999', which is not a checkpoint" in refusal(folder, capfd)
    (folder / "999").unlink()
    (folder / "999").write_text("a file")
    assert "'999', which is not a checkpoint" in refusal(folder, capfd)
    (folder / "999").unlink()
    assert (load(folder) or (0,))[0] == 7


def test_where_there_is_none_there_is_none(tmp_path):
    assert load(tmp_path / "nowhere") is None
    (tmp_path / "empty").mkdir()
    assert load(tmp_path / "empty") is None


def test_one_of_an_earlier_version_is_read_and_the_user_warned_once(tmp_path, capfd):
    shutil.copytree(EARLIER, tmp_path / "run")
    load_sensor(tmp_path / "run")
    load_sensor(tmp_path / "run")
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1
    assert "has no digests.json" in said[0]
    load_sensor(resources.folder("weights"))
    assert capfd.readouterr().err == ""


def test_one_of_an_earlier_version_that_is_damaged_is_one_line_or_is_read(tmp_path, capfd):
    """Nothing of it is vouched for; what is refused is refused without a word of the storage library."""
    shutil.copytree(EARLIER / BEST, tmp_path / BEST)
    rng, places, refused = random.Random(3), files_in(tmp_path / BEST), 0
    for i in range(80):
        path = places[i % len(places)]
        content = path.read_bytes()
        damaged = bytearray(content)
        damaged[rng.randrange(min(len(content), 400))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged if i % 5 else damaged[: len(damaged) // 2])
        try:
            load(tmp_path / BEST)
        except RequestError as error:
            refused += 1
            assert "\n" not in str(error)  # noqa: PT017
        path.write_bytes(content)
        assert len(capfd.readouterr().err.splitlines()) <= 1
    assert refused > 10


def test_weights_that_are_not_finite_are_no_sensor(tmp_path):
    """Whole by their digests: a training that diverged, or a hand that signed them anew."""
    run = tmp_path / "run"
    shutil.copytree(resources.folder("weights"), run)
    step, arrays = load(run / BEST) or (0, {})
    name = next(name for name, leaf in arrays.items() if leaf.ndim > 1)
    for wrong, word in (
        (np.full_like(arrays[name], np.nan), "non-finite numbers"),
        (np.full_like(arrays[name], -np.inf), "non-finite numbers"),
        (arrays[name][1:], "does not fit the configuration"),
        (arrays[name].astype(np.float64), "type float64 does not fit the configuration"),
        (arrays[name].astype(np.int32), "type int32 does not fit the configuration"),
    ):
        save(run / BEST, step, arrays | {name: wrong})
        with pytest.raises(RequestError, match=word) as error:
            load_sensor(run)
        assert name in str(error.value)
    save(run / BEST, step, {key: leaf for key, leaf in arrays.items() if key != name})
    with pytest.raises(RequestError, match="does not fit the configuration"):
        load_sensor(run)


def test_nothing_in_a_checkpoint_says_where_it_was_made(folder):
    for path in files_in(folder):
        assert str(folder).encode() not in path.read_bytes()
        assert b"/tmp" not in path.read_bytes()
    assert step_folder.DIGESTS in {path.name for path in files_in(folder)}
