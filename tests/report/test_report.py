import json
import re
import shutil
import xml.etree.ElementTree as ET
from contextlib import suppress
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from faults import NO_ROOM, Faults, Killed

from mjx_fit.config.schema import Config, config_to_tree
from mjx_fit.data.episode import Episode
from mjx_fit.data.hdf5 import encode
from mjx_fit.data.plan import Plan
from mjx_fit.data.writer import Writer, new_manifest, new_shard
from mjx_fit.evaluation import results
from mjx_fit.evaluation.results import Result, summarise_assembly, summarise_attempt
from mjx_fit.report import build as building
from mjx_fit.report import descriptions
from mjx_fit.report.build import build
from mjx_fit.task.methods import ASSEMBLY, INSERTION, POSITION
from mjx_fit.types import Felt, Rollout, Trace, Truth
from mjx_fit.utils.errors import RequestError

EVIL = "<script>alert('$x$')</script>"
VOID = {"meta", "wbr", "br", "img", "link"}


def assembly(methods: dict[str, float], n_trials: int) -> Result:
    """A result in which every attempt of a method succeeds with its probability; the cap is 30."""
    rng = np.random.default_rng(0)
    trials = []
    for method, probability in methods.items():
        for i in range(n_trials):
            needed = rng.geometric(probability, 5)
            trials.append(
                {"trial": i, "method": method, "pegs": ["cross"] * 5,
                 "holes": ["cross"] * 5, "tried": [[0] * min(count, 30) for count in needed.tolist()],
                 "attempts": np.minimum(needed, 30).tolist(), "human": (needed > 30).tolist()}
            )  # fmt: skip
    tree = config_to_tree(Config())
    return Result("assembly", tree, 0, "native", "cpu", {"jax": "0.10"}, summarise_assembly(trials), trials)


def attempt() -> Result:
    rng = np.random.default_rng(1)
    pairs = [["cross", "cross"], ["square", "square"], ["cross", "square"]]
    trials = [
        {"trial": i, "pair": pairs[i % 3], "matched": i % 3 < 2, "inserted": bool(rng.random() < 0.3),
         "valid": True, "length": 100, "peak_force_n": 8.0, "error_m": float(rng.uniform(0, 0.028))}
        for i in range(60)
    ]  # fmt: skip
    other = assembly({"full": 1.0}, 1)
    return replace(other, experiment="attempt", summary=summarise_attempt(trials), trials=trials)


def interactions() -> Rollout:
    rng = np.random.default_rng(2)
    n, steps = 20, 30
    hole = rng.uniform(-0.1, 0.1, (n, 2))
    tip = np.zeros((n, steps, 3))
    tip[..., :2] = hole[:, None] + rng.normal(0, 0.01, (n, steps, 2))
    length = rng.integers(1, steps + 1, n)
    zeros = np.zeros
    wrench = rng.normal(0, 5, (n, steps, 50, 6))
    trace: Any = wrench, tip, zeros((n, steps, 4)), tip, tip, tip
    felt: Any = length, zeros((n, 6)), hole, np.arange(n) % 3
    truth: Any = np.arange(n) % 2, hole, length < steps, np.arange(n) > 0, zeros((n, 7)), zeros((n, 7))
    return Rollout(Felt(Trace(*trace), *felt), Truth(*truth))


def as_stored(leaf: np.ndarray) -> np.ndarray:
    """Single floats and short integers, as JAX makes them."""
    return leaf.astype({"f": np.float32, "i": np.int32}.get(leaf.dtype.kind, leaf.dtype))


def dataset_folder(path: Path) -> Path:
    plan = Plan(episodes=20, actions=30, policy="random", engine="native", seed=12)
    request, ids = plan.request(Config()), np.arange(20)
    cov = np.tile(1e-4 * np.eye(2, dtype=np.float32), (20, 1, 1))
    policy = np.zeros(20, np.int32)
    episodes = Episode(ids, ids, 0 * ids, policy, cov, jax.tree.map(as_stored, interactions()))
    with Writer(path, new_manifest(request, (0, 1))) as writer:
        content = encode(episodes, request)
        writer.write(new_shard("shard-00000000.h5", ids, content), content)
        writer.finish()
    return path


def run_folder(path: Path) -> Path:
    path.mkdir(parents=True)
    lines = [json.dumps({"epoch": e, "nll": -e, "val_nll": -e / 2, "prior_nll": 1.0}) for e in (0, 1, 2, 1)]
    (path / "metrics.jsonl").write_text("\n".join(lines) + '\n{"epoch": 3, "n')  # killed while it wrote
    (path / "run.json").write_text(json.dumps({"seed": 11, "device": "cpu: cpu"}))
    return path


class Page(HTMLParser):
    """Checks that elements nest, and collects ids, addresses and counts."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "data", "srcset"):
                self.links.append(value or "")

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "all"
    run_folder(root / "run")
    dataset_folder(root / "data")
    results.write(root / "assembly.json", assembly({"failure_only": 0.05, "full": 0.3, EVIL: 0.5}, 8))
    results.write(root / "attempt.json", attempt())
    results.write(root / "deeper" / "assembly.json", assembly({"full": 0.9}, 8))  # no intervention
    results.write(root / "one.json", assembly({"full": 0.4}, 1))
    (root / "bench.json").write_text("[]")  # not a result: passed over
    return root


def test_the_page_stands_alone(folder: Path, tmp_path: Path):
    index = build([folder], tmp_path / "out")
    text = index.read_text()
    page = Page(text)
    figures = sorted((tmp_path / "out" / "figures").iterdir())
    assert (
        page.tags.count("svg") == page.tags.count("figcaption") == len(figures) == 3 * 4 + 1 + 2 + 1 + 3 + 1
    )
    assert len(page.ids) == len(set(page.ids))
    assert "script" not in page.tags
    assert "&lt;script&gt;" in text
    for link in page.links:
        assert link.startswith(("#", "data:"))
        assert not link.startswith("#") or link[1:] in page.ids
    used = re.findall(r"url\(([^)]*)\)", text)
    assert used
    assert all(link[0] == "#" and link[1:] in page.ids for link in used)
    assert "@import" not in text
    for figure in figures:
        ET.parse(figure)


def test_each_set_of_parts_is_drawn_once_beside_its_results(folder: Path, tmp_path: Path):
    tight = replace(Config(), scene=replace(Config().scene, clearance_m=0.0008))
    results.write(folder / "tight.json", replace(attempt(), config=config_to_tree(tight)))
    text = build([folder], tmp_path / "out").read_text()
    drawn = [path.name for path in sorted((tmp_path / "out" / "figures").glob("*-parts.svg"))]
    assert len(drawn) == 2
    assert "tight-parts.svg" in drawn
    assert "gap 0.8 mm" in text


def test_the_page_says_what_was_counted_and_on_what(folder: Path, tmp_path: Path):
    text = build([folder], tmp_path / "out").read_text()
    row = summarise_attempt(attempt().trials)[0]
    assert f"{row.value:.3f} <span>[{row.low:.3f}, {row.high:.3f}]</span>" in text
    for word in ("native", "jax 0.10", "max_attempts: 30", "<dd>11</dd>", "0.264", ">0.340<"):
        assert word in text
    for fact in ("performed</dt><dd>19", "diverged</dt><dd>1", "seed</dt><dd>12"):
        assert fact in text
    assert not any("nan" in cell for cell in re.findall(r"<td>[^<]*", text))


@pytest.mark.parametrize(("cap", "shown"), [(30, True), (10, False)])
def test_the_papers_interventions_stand_beside_its_cap_alone(tmp_path: Path, cap: int, shown: bool):
    few = assembly({"failure_only": 0.2, "full": 0.6}, 8)
    few.config["task"]["max_attempts"] = cap
    results.write(tmp_path / "assembly.json", few)
    text = build([tmp_path / "assembly.json"], tmp_path / "out").read_text()
    assert (">0.264<" in text) == shown
    assert (">paper</th>" in text) == shown
    figure = (tmp_path / "out" / "figures" / "assembly-interventions.svg").read_text()
    assert ("paper" in " ".join(ET.fromstring(figure).itertext())) == shown


def test_every_method_and_experiment_of_ours_is_told():
    for experiment, methods in (("assembly", ASSEMBLY), ("position", POSITION), ("insertion", INSERTION)):
        names = [method.name for method in methods]
        assert [name for name, _ in descriptions.told(experiment, [*names, *names])] == names
    assert all(map(descriptions.about, ("attempt", "position", "insertion", "assembly", "calibration")))


def test_the_same_input_gives_the_same_bytes(folder: Path, tmp_path: Path):
    first, second = (build([folder], tmp_path / name) for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    for one in (tmp_path / "first" / "figures").iterdir():
        assert one.read_bytes() == (tmp_path / "second" / "figures" / one.name).read_bytes()


def test_figures_show_the_numbers(folder: Path, tmp_path: Path):
    build([folder / "assembly.json", folder / "run"], tmp_path / "out")
    texts = {
        path.stem: " ".join(ET.parse(path).getroot().itertext())
        for path in (tmp_path / "out" / "figures").iterdir()
    }
    assembly_figures = ("success", "interventions", "attempts", "spent", "ratio", "parts")
    assert set(texts) == {"run-training", *(f"assembly-{name}" for name in assembly_figures)}
    rate = next(row for row in results.read(folder / "assembly.json").summary if row.metric != "attempts")
    assert f"{rate.value:.1%} of 40 pegs" in texts["assembly-interventions"]
    assert "Attempts at one peg" in texts["assembly-success"]
    assert "first 5 pegs" in texts["assembly-attempts"]
    assert "prior" in texts["run-training"]


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A section of one picture, drawn once."""
    path = tmp_path_factory.mktemp("small") / "assembly.json"
    results.write(path, assembly({"full": 0.4}, 2))
    section = building._find(path)[path][1]("assembly")
    return path, replace(section, pictures=section.pictures[:1], scene=None)


@pytest.fixture
def report(small, monkeypatch):
    """Makes a report of it, and says what is in the folder."""
    path, section = small
    monkeypatch.setattr(building, "_find", lambda _: {path: ("assembly", lambda slug: section)})

    def make(out: Path) -> dict[str, bytes]:
        build([path], out)
        return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}

    return make


@pytest.mark.parametrize("code", [0, *NO_ROOM])
def test_a_report_that_is_stopped_is_continued(report, tmp_path: Path, monkeypatch, code: int):
    """Killed, or out of room, at any file operation: the same command comes to the same bytes.

    Both folders and the lock are made, and one is synced in the other; the page that says it is unfinished,
    the figure and the page are each created, written, synced, renamed and synced in their folder. A kill may
    also come after a renaming, when the lock is removed, and when the folder would be, were it empty.
    """
    whole, moment = report(tmp_path / "whole"), 0
    assert len(whole) == 2
    while True:
        out = tmp_path / f"stopped{moment}"
        with monkeypatch.context() as patch:
            faults = Faults(patch, out, moment, code)
            with suppress(Killed, OSError):
                report(out)
        if not faults.failed:
            break
        assert code == 0 or not [path for path in out.rglob("*") if path.suffix in (".tmp", ".lock")]
        assert report(out) == whole
        moment += 1
    assert moment == (4 + 3 * 5 if code else 4 + 3 * 6 + 2)


def test_an_unfinished_page_says_so(report, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(building, "page", lambda made: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        report(tmp_path / "out")
    assert "is unfinished: rerun its command" in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.parametrize("name", ["figures", ".lock"])
def test_a_report_follows_no_link(report, tmp_path: Path, name: str):
    (tmp_path / "elsewhere").mkdir()
    report(tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / name, ignore_errors=True)
    (tmp_path / "out" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RequestError, match=f"{name} cannot be used: it is a symbolic link"):
        report(tmp_path / "out")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_an_input_that_is_given_twice_is_shown_once(folder: Path, tmp_path: Path):
    build([folder / "one.json", folder / "one.json"], tmp_path / "out")
    assert len(list((tmp_path / "out" / "figures").iterdir())) == 5  # four of the result, one of its parts


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("nowhere.json", None),
        ("empty", {}),
        ("broken.json", "{"),
        ("folder", {"cut.json": '{"experiment": "assem'}),
        ("data", {"manifest.json": "{}"}),
        ("run", {"metrics.jsonl": ""}),
        ("run", {"metrics.jsonl": 'nonsense\n{"epoch": 1}\n'}),
    ],
)
def test_bad_inputs_are_refused_before_anything_is_written(
    tmp_path: Path, name: str, content: str | dict[str, str] | None
):
    path = tmp_path / name
    if isinstance(content, str):
        path.write_text(content)
    elif content is not None:
        path.mkdir()
        for file, text in content.items():
            (path / file).write_text(text)
    good = run_folder(tmp_path / "good")
    with pytest.raises(RequestError, match=re.escape(str(path))) as error:
        build([good, path], tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_a_result_of_nothing_is_refused(tmp_path: Path):
    results.write(tmp_path / "none.json", replace(attempt(), summary=[], trials=[]))
    with pytest.raises(RequestError, match=r"none\.json"):
        build([tmp_path / "none.json"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_out_must_not_be_a_file(tmp_path: Path):
    (tmp_path / "out").write_text("")
    with pytest.raises(RequestError, match="out"):
        build([run_folder(tmp_path / "run")], tmp_path / "out")


def told() -> Result:
    """Three assemblies of two pegs: of 2, 3 and 5 attempts, the last with help at a cap of 3."""
    trials = []
    for i, (attempts, human) in enumerate((([1, 1], False), ([2, 1], False), ([2, 3], True))):
        columns = {
            "tried": [[0, 1][:n] + [1] * (n - 2) for n in attempts],
            "match_probability": [[0.25] * n for n in attempts],
            "chance": [[0.031] * n for n in attempts],
            "next_best": [[0.0123] * attempts[0], [None] * attempts[1]],
            "error_cm": [[1.57] * n for n in attempts],
            "match_after": [[0.75] * n for n in attempts],
            "error_after_cm": [[0.13] * n for n in attempts],
            "peak_force_n": [[41.2] * n for n in attempts],
            "seconds": [[10.0] * n for n in attempts],
        }
        trials.append(
            {"trial": i, "method": "full", "pegs": ["cross", EVIL], "holes": ["square", "cross"],
             "attempts": attempts, "human": [False, human], **columns}
        )  # fmt: skip
    return replace(assembly({"full": 1.0}, 1), trials=trials, summary=summarise_assembly(trials))


def test_the_page_tells_a_median_and_the_hardest_assembly(tmp_path: Path):
    results.write(tmp_path / "told.json", told())
    text = build([tmp_path / "told.json"], tmp_path / "out").read_text()
    Page(text)
    median = text.index("Median of 3 assemblies with full: trial 1, 3 attempts")
    hardest = text.index("Hardest of 3 assemblies with full: trial 2, 5 attempts")
    assert "Peg 1, a cross: inserted after 2 attempts" in text[median:hardest]
    rows = (
        ("1 (square)", "25%", "3.1%", "1.2%", "15.7 mm", "10.0 s", "41 N", "failed", "75%", "1.3 mm"),
        ("2 (cross)", "25%", "3.1%", "1.2%", "15.7 mm", "10.0 s", "41 N", "inserted", "", ""),
    )
    table = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    assert table in text[median:hardest]
    assert "the probability that peg and hole match, times" in text[median:hardest]
    assert "<td>3.1%</td><td>-</td>" in text[median:hardest]  # no other hole is empty
    assert "human intervention after 3 attempts" in text[hardest:]
    assert text[hardest:].count("<td>failed</td>") == 4
    assert "<script>" not in text
    assert text.index("<details open>") == hardest - len("<details open><summary>")
    assert text.count("<details open>") == 1


def test_a_video_comes_first_and_inside_the_page(tmp_path: Path):
    results.write(tmp_path / "in" / "told.json", told())
    for name, begins in (("z.mp4", b"\0\0\0\x20ftypisom"), ("y.gif", b"GIF89a")):
        (tmp_path / "in" / name).write_bytes(begins)
    text = build([tmp_path / "in"], tmp_path / "out").read_text()
    page = Page(text)
    assert [link[:15] for link in page.links if link.startswith("data:")] == [
        "data:image/gif;",
        "data:video/mp4;",
    ]
    assert text.index("<video") < text.index("<svg")


def test_a_video_that_is_too_large_for_a_page(tmp_path: Path):
    with (tmp_path / "long.mp4").open("wb") as file:
        file.truncate(21_000_000)
    with pytest.raises(RequestError, match=r"long\.mp4 cannot be used: it has 21 MB"):
        build([tmp_path / "long.mp4"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_called_a_video_and_is_none(tmp_path: Path):
    (tmp_path / "no.mp4").write_bytes(b"GIF89a")
    with pytest.raises(RequestError, match=r"no\.mp4 cannot be used: it is not a \.mp4 video"):
        build([tmp_path / "no.mp4"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_results_of_other_versions_and_of_another_training_say_so(tmp_path: Path):
    old, new = assembly({"full": 0.5}, 4), assembly({"full": 0.5}, 4)
    old.versions["numpy"] = new.versions["numpy"] = "2.4"
    results.write(tmp_path / "old.json", old)
    differs = ["scene.clearance_m is 0.001 there and 0.004 here"]
    new = replace(new, versions=new.versions | {"jax": "0.11"}, request={"differs_from_training": differs})
    results.write(tmp_path / "new.json", new)
    both = build([tmp_path / "old.json", tmp_path / "new.json"], tmp_path / "both").read_text()
    assert "made with different versions: jax 0.10 and 0.11. Compare" in both
    assert f"<dd>{differs[0]}</dd>" in both
    alone = build([tmp_path / "old.json"], tmp_path / "alone").read_text()
    assert "different versions" not in alone
    assert "changed since training" not in alone


def test_runs_are_compared_in_one_figure(tmp_path):
    """The figure of one run is not drawn twice; of two runs the first section holds both curves."""
    alone = [run_folder(tmp_path / "a")]
    both = [*alone, run_folder(tmp_path / "b")]
    pictures = []
    for number, runs in enumerate((alone, both)):
        page = build(runs, tmp_path / f"report-{number}")
        pictures.append(sorted(path.name for path in (page.parent / "figures").iterdir()))
    assert pictures == [["a-training.svg"], ["a-compared.svg", "a-training.svg", "b-training.svg"]]
    drawn = (tmp_path / "report-1/figures/a-compared.svg").read_text()
    assert ">a</text>" in drawn
    assert ">b</text>" in drawn
