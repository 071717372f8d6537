"""Colours of peg and hole types in figures and renderings."""

_MORE = (
    "#0000FF", "#000088", "#AAEE88", "#443300", "#7766FF", "#EEDD00", "#441155", "#CCCCFF", "#334444"
)  # fmt: skip
"""Colours at a CIELAB distance of at least 27 from each other, white, black and the mismatch colour.

The distance holds for normal vision and, by Machado's matrices, without red or green cones."""

FIGURE_COLOURS = ("#0072B2", "#009E73", "#CC79A7", *_MORE)
"""Colours of the types in figures, on white."""


def _rgb(colour: str) -> tuple[float, float, float]:
    r, g, b = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return r, g, b


TYPE_RGB = ((0.90, 0.38, 0.05), (0.00, 0.60, 0.45), (0.80, 0.30, 0.62), *map(_rgb, _MORE))
"""Colours of the types in renderings: of pegs, and of beliefs as they become certain."""
