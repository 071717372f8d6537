"""The opening of a page: its lead sentence, the claims of a result in words, and the legend."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import EXPERIMENTS
from test_report import EVIL, Page, assembly, dataset_folder, run_folder

from mjx_fit.evaluation import insertion, position, results
from mjx_fit.evaluation.results import Result
from mjx_fit.evaluation.statistics import Row
from mjx_fit.report import claims
from mjx_fit.report.build import build
from mjx_fit.report.figures import catalogue
from mjx_fit.report.figures.style import picture


def of(experiment: str, *rows: Row) -> tuple[str, ...]:
    """The claims of a summary."""
    return claims.of_result(Result(experiment, {}, 0, "native", "cpu", {}, [*rows], []))


def mean(method: str, value: float, low: float | None, high: float | None) -> list[Row]:
    """Attempts of an assembly of two pegs."""
    return [
        Row(method, "attempts", "1", value / 2, value / 2, value / 2, 8),
        Row(method, "attempts", "2", value, low, high, 8),
        Row(method, "attempts", "all", value, low, high, 8),
    ]


def resampled(values: np.ndarray) -> list[float]:
    """Percentile interval of means of resampled rows, drawn one by one."""
    rng = np.random.default_rng(99)
    means = [values[rng.integers(len(values), size=len(values))].mean() for _ in range(4000)]
    return np.quantile(means, [0.025, 0.975]).tolist()


def numbers(text: str) -> list[float]:
    """The numbers of a sentence."""
    words = text.replace("(", " ").replace(")", " ").replace(";", " ").replace(",", " ").split()
    bare = [word.rstrip(".%") for word in words]
    return [float(word) for word in bare if word.replace(".", "", 1).isdigit()]


def test_the_claim_of_an_assembly_is_computed_from_its_trials():
    result = assembly({"failure_only": 0.1, "full": 0.5}, 40)
    total = {
        name: np.array([sum(row["attempts"]) for row in result.trials if row["method"] == name])
        for name in ("failure_only", "full")
    }
    human = np.mean([row["human"] for row in result.trials if row["method"] == "failure_only"])
    first, second = claims.of_result(result)
    own, other = total["full"], total["failure_only"]
    assert first.startswith(
        f"full needs {own.sum() / 40:.1f} attempts on average for five pegs (95 % interval "
    )
    assert numbers(first)[2:4] == pytest.approx(resampled(own), abs=0.3)
    assert "; n = 40)" in first
    assert second.startswith(
        f"{(other.sum() - own.sum()) / 40:.1f} attempts fewer than failure_only: {other.sum() / 40:.1f} ("
    )
    assert numbers(second)[2:4] == pytest.approx(resampled(other), abs=1.5)
    assert f"ratio {own.sum() / other.sum():.3g} (" in second
    assert f"human intervention for {human:.1%} (" in second


@pytest.mark.parametrize(
    ("other", "ratio", "said"),
    [
        ((12.0, 11.0, 13.0), None, "2.0 attempts fewer than b: 12.0 (11.0 to 13.0)."),
        ((7.0, 6.5, 7.5), None, "3.0 attempts more than b: 7.0 (6.5 to 7.5)."),
        ((11.0, 10.4, 11.6), None, "No difference from b is shown: 11.0 (10.4 to 11.6)."),
        (
            (11.0, 10.4, 11.6),
            (0.91, 0.85, 0.97),
            "1.0 attempts fewer than b: 11.0 (10.4 to 11.6), ratio 0.91",
        ),
        ((12.0, 11.0, 13.0), (0.83, 0.6, 1.1), "No difference from b is shown: 12.0 (11.0 to 13.0), ratio"),
        ((12.0, 11.0, 13.0), (1.3, 1.1, 1.5), "No difference from b is shown"),  # the two contradict
    ],
)
def test_a_difference_is_claimed_only_where_the_intervals_show_one(other, ratio, said: str):
    rows = [*mean("full", 10.0, 9.5, 10.5), *mean("b", *other)]
    if ratio:
        value, low, high = ratio
        rows.append(Row("full", "attempts_ratio", "b", value, low, high, 8))
    first, second = of("assembly", *rows)
    assert first == "full needs 10.0 attempts on average for two pegs (95 % interval 9.5 to 10.5; n = 8)."
    assert second.startswith(said)


def test_nothing_is_claimed_without_an_interval():
    assert of("assembly", *mean("full", 10.0, None, None)) == ()
    assert of("assembly") == of("insertion") == of("position") == of("attempt") == of("other") == ()
    assert of("assembly", *mean("mine", 3.0, 2.0, 4.0))[0].startswith("mine needs 3.0 attempts")


def test_the_claim_of_an_insertion():
    needed = {"full": [1, 2, 2, 1, 2, 1], "sample": [4, 6, 9, 3, 8, 2], "frame_by_frame": [2, 1, 1, 2, 2, 1]}
    trials = [
        {"trial": i, "seed": 0, "method": name, "attempts": n, "success": True, "peak_force_n": [1.0] * n}
        for name, own in needed.items()
        for i, n in enumerate(own)
    ]
    said = of("insertion", *insertion.summarise(trials))
    assert said[0].startswith("full needs 1.50 attempts on average at a matching hole (95 % interval ")
    assert "and inserts 100.0% (" in said[0]
    assert said[0].endswith("of the pegs within 10 attempts.")
    assert said[1].startswith("3.83 attempts fewer than sample: 5.33 (")  # 32/6 - 9/6
    assert ", 3.83 saved (" in said[1]
    assert said[2].startswith("No difference from frame_by_frame is shown: 1.50 (")


def test_the_claim_of_a_position_result():
    error = {"full": (1.5, 0.25), "frame_by_frame": (1.5, 0.5), "no_update": (1.5, 1.5), "oracle": (0.0, 0.0)}
    trials = [
        {"trial": i, "method": name, "pair": ["a", "b"],
         "error_cm": [first * (1 + i / 50), last * (1 + i / 50)],
         "squared_mahalanobis": [1.0, 1.0], "inserted_at": None, "peak_force_n": [1.0]}
        for name, (first, last) in error.items()
        for i in range(5)
    ]  # fmt: skip
    said = of("position", *position.summarise(trials))
    grown = (1 + 0.02 + 0.04 + 0.06 + 0.08 + 4) / 5  # mean of 1 + i/50
    assert said[0].startswith(
        f"full reduces the mean position error from {1.5 * grown:.3g} cm (95 % interval 1.5"
    )
    assert f"to {0.25 * grown:.3g} cm (0.25" in said[0]
    assert said[0].endswith("in one attempt at mismatched holes (n = 5).")
    assert said[1].startswith(f"{0.25 * grown:.3g} cm less than frame_by_frame: {0.5 * grown:.3g} (0.5")
    assert len(said) == 3
    still = of("position", *position.summarise([one for one in trials if one["method"] == "no_update"]))
    assert still[0].startswith("no_update shows no change of the mean position error, from 1.56 cm")


def test_the_page_opens_with_its_content_claims_and_a_legend(tmp_path: Path):
    results.write(tmp_path / "in" / "one.json", assembly({"full": 0.5, EVIL: 0.05}, 8))
    results.write(tmp_path / "in" / "two.json", replace(assembly({"full": 0.5}, 8), experiment="other"))
    run_folder(tmp_path / "in" / "run")
    dataset_folder(tmp_path / "in" / "data")
    text = build([tmp_path / "in"], tmp_path / "out").read_text()
    Page(text)
    lead = text[text.index('<p class="lead">') : text.index("<nav>")]
    assert lead.endswith("shows 2 experiments (assembly, other), 1 data set and 1 training run.</p>\n")
    legend = text[text.index("</nav>") : text.index("<section>")]
    for word in ("95 % interval", "arXiv 2101.02725", "cross, rectangle, square", "background:#0072B2"):
        assert word in legend
    assert "video" not in legend
    assert text.count('<ul class="claims">') == 1
    assert "attempts fewer than &lt;script&gt;" in text


def test_a_legend_names_only_what_the_page_has(tmp_path: Path):
    text = build([run_folder(tmp_path / "run")], tmp_path / "out").read_text()
    assert "this page shows 1 training run.</p>" in text
    assert "arXiv" not in text
    assert "mismatched" not in text
    assert "swatch" not in text[text.index("</nav>") :]


def test_no_figure_shows_a_formula_as_text():
    result = results.read(EXPERIMENTS / "paper" / "as-2026-11" / "position.json")
    for name, _, draw in catalogue.of_result(result):
        assert "mathdefault" not in picture(name, name, draw).svg
