"""Attempt log of an assembly: values per trial, peg and attempt."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int, Shaped

from mjx_fit.filters.kalman import CM_PER_M
from mjx_fit.types import Belief

DIGITS = 4


class Diary:
    """Columns of logged values, one list per row and peg, in the layout of a result file's trials."""

    def __init__(self, n_rows: int, n_pegs: int):
        self._n_pegs = n_pegs
        self._of_row: list[dict[str, list[list[Any]]]] = [{} for _ in range(n_rows)]

    def write(
        self, rows: Int[np.ndarray, "R"], peg: Int[np.ndarray, "R"], **columns: Shaped[np.ndarray, "R"]
    ) -> None:
        """Log one attempt of each given row.

        Args:
            rows: Indices of the rows.
            peg: Number of the peg in hand.
            columns: Values to log: integers, or floats rounded to ``DIGITS`` decimals.
        """
        for name, values in columns.items():
            kept = (
                values if np.issubdtype(values.dtype, np.integer) else np.round(values.astype(float), DIGITS)
            )
            for row, number, value in zip(rows, peg, kept.tolist(), strict=True):
                self._of_row[row].setdefault(name, [[] for _ in range(self._n_pegs)])[number].append(value)

    def of(self, row: int) -> dict[str, list[list[Any]]]:
        """Return the log of a row, by column."""
        return self._of_row[row]


def about(beliefs: Belief, hole: Int[np.ndarray, "R"]) -> Belief:
    """Return the belief of each row about one of its holes."""
    return jax.tree.map(lambda leaf: leaf[np.arange(len(hole)), hole], beliefs)


def believed(
    belief: Belief, peg_type: Int[np.ndarray, "R"], place_world: Float[np.ndarray, "R D"]
) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R"]]:
    """Compute P(match) of the hole and the error of the belief's mean in x and y, cm."""
    match = np.exp(np.take_along_axis(np.asarray(belief.type_logp), peg_type[:, None], axis=1)[:, 0])
    return match, CM_PER_M * np.linalg.norm(np.asarray(belief.pos_mean_world) - place_world[:, :2], axis=1)
