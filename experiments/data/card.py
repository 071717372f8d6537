"""The numbers and figures of a data set for this folder: ``python experiments/data/card.py DIR``."""

import sys
from pathlib import Path

import jax

from mjx_fit.dataset import manifest, store
from mjx_fit.dataset.episode import happened
from mjx_fit.report import data_figures, script

HERE = Path(__file__).parent


def main(folder: Path) -> None:
    told, there = store.describe(folder), manifest.read(folder)
    episodes = store.load(folder)
    keep = happened(episodes)
    data = jax.tree.map(lambda leaf: leaf[keep], episodes.interaction)
    request = {name: value for name, value in there.request.items() if name != "config"}
    script.save(HERE / f"{folder.name}.json", {"request": request, "holds": told})
    for name, figure in (
        ("visited", data_figures.visited_positions),
        ("lengths", data_figures.interaction_lengths),
        ("forces", data_figures.forces_by_pair),
    ):
        script.draw(HERE / f"{folder.name}_{name}.png", lambda figure=figure: figure(data))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
