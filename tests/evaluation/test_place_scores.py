"""Errors of believed places: symmetric parts look alike, and truths drawn from beliefs are calibrated."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from mjx_fit.config.files import read_config
from mjx_fit.evaluation.place_scores import place_columns, rotation_errors, score_places, symmetries
from mjx_fit.evaluation.scores import inside
from mjx_fit.filters import chart

PLANE = read_config(None, [])
POSES = read_config(None, ["filter.coordinates=[x, y, z, yaw, roll, pitch]"])
SIX = POSES.filter.coordinates
SQUARE = PLANE.scene.names.index("square")


def beliefs(rng: np.random.Generator, n: int, d: int) -> tuple[np.ndarray, np.ndarray]:
    root = 0.01 * rng.normal(size=(n, 1, d, d))
    return rng.uniform(-0.1, 0.1, (n, 1, d)), root @ root.swapaxes(-1, -2) + 1e-5 * np.eye(d)


def test_with_x_and_y_alone_the_scores_are_the_plain_ones():
    rng = np.random.default_rng(0)
    mean, cov = beliefs(rng, 5, 2)
    place, kinds = rng.uniform(-0.1, 0.1, (5, 2)), np.zeros(5, int)
    scores, error = score_places(mean, cov, place[:, None], kinds, PLANE), place - mean[:, 0]
    np.testing.assert_allclose(scores.distance_cm[:, 0], 100 * np.hypot(*error.T))
    want = [e @ np.linalg.inv(c) @ e for e, c in zip(error, cov[:, 0], strict=True)]
    np.testing.assert_allclose(scores.squared[:, 0], want)
    assert set(place_columns(scores, 0)) == {"error_cm", "squared_mahalanobis"}


def test_truths_drawn_from_their_beliefs_are_inside_as_often_as_they_should():
    rng, n = np.random.default_rng(1), 4000
    mean, cov = beliefs(rng, n, 6)
    mean, cov = mean * 2, cov * 0.2
    steps = np.einsum("nij,nj->ni", np.linalg.cholesky(cov[:, 0]), rng.normal(size=(n, 6)))
    place = np.asarray(chart.moved(jnp.asarray(mean[:, 0]), jnp.asarray(steps), SIX))
    scores = score_places(mean, cov, place[:, None], np.full(n, SQUARE), POSES)
    assert scores.squared.mean() == pytest.approx(6, abs=0.2)
    assert inside(scores.squared[:, 0], 0.9, scores.degrees).mean() == pytest.approx(0.9, abs=0.02)
    assert place_columns(scores, 0)["degrees"] == 6


def test_a_square_turned_by_a_quarter_is_where_it_was():
    mean, cov = np.zeros((1, 1, 6)), np.tile(np.eye(6), (1, 1, 1, 1))
    place = np.array([[0.003, 0, 0.004, np.pi / 2 - 0.02, 0, 0]])
    scores = score_places(mean, cov, place[:, None], np.array([SQUARE]), POSES)
    assert scores.distance_cm[0, 0] == pytest.approx(0.5)
    assert scores.turn_deg is not None
    assert scores.turn_deg[0, 0] == pytest.approx(np.rad2deg(0.02), rel=1e-3)
    assert place_columns(scores, 0)["yaw_deg"] == pytest.approx([np.rad2deg(0.02)], rel=1e-3)
    assert scores.squared[0, 0] == pytest.approx(0.003**2 + 0.004**2 + 0.02**2, rel=1e-3)


def test_a_round_part_has_no_yaw():
    """Its yaw counts neither as an error nor as a degree of freedom: the others have their marginal."""
    config = read_config(
        None,
        [
            "scene.shapes=[{name: ring, section: {circle: {diameter_m: 0.02}}}, {name: box, rectangles: "
            "[[-0.01, -0.01, 0.01, 0.01]]}]",
            "task.success_probability=[0.3, 0.3]",
            "filter.coordinates=[x, y, yaw]",
            "scene.clearance_m=0.001",
        ],
    )
    assert symmetries(config.scene) == (0, 4)
    rng = np.random.default_rng(2)
    mean, cov = beliefs(rng, 2, 3)
    place, kinds = mean[:, 0] + [0.001, 0.002, 0.3], np.array([0, 1])
    scores = score_places(mean, cov, place[:, None], kinds, config)
    assert scores.degrees.tolist() == [2, 3]
    assert scores.turn_deg is not None
    assert scores.turn_deg[:, 0] == pytest.approx([0, np.rad2deg(0.3)], rel=1e-3)
    rows = [place_columns(scores, i) for i in range(2)]
    assert "yaw_deg" not in rows[0]
    errors = rotation_errors(rows)
    assert np.isnan(errors["yaw_error_deg"][0])
    assert errors["yaw_error_deg"][1] == pytest.approx(np.rad2deg(0.3), rel=1e-3)
    assert list(rotation_errors(rows[:1])) == ["turn_error_deg"]
    error = np.array([0.001, 0.002])
    assert scores.squared[0, 0] == pytest.approx(error @ np.linalg.inv(cov[0, 0, :2, :2]) @ error, rel=1e-3)


def test_the_region_of_d_coordinates_has_its_own_quantile():
    squared = np.array([4.0, 5.0, 10.0, 11.0])
    assert inside(squared, 0.9).tolist() == [True, False, False, False]
    assert inside(squared, 0.9, np.array([2, 3, 6, 6])).tolist() == [True, True, True, False]
    assert chi2.ppf(0.9, 6) == pytest.approx(10.64, abs=0.01)
