"""Summary of a result as a table on the terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mjx_fit.evaluation.results import Result
from mjx_fit.sensors.trained_sensor import away_from_training


def print_summary(result: Result) -> None:
    """Print method, metric, group, value with its 95 % interval, n, and a note on the sensor's training."""
    table = Table(
        title=escape(f"{result.experiment}, engine {result.engine}, seed {result.seed}"),
        title_justify="left",
    )
    for column in ("method", "metric", "group"):
        table.add_column(column, overflow="fold")
    for column in ("value", "95 % interval", "n"):
        table.add_column(column, justify="right")
    for row in result.summary:
        interval = "?" if row.low is None or row.high is None else f"{row.low:.3g} to {row.high:.3g}"
        metric = row.metric.replace("_", " ")  # a narrow terminal then wraps between words
        names = map(escape, (row.method, metric, row.group))  # brackets in a name are not markup
        table.add_row(*names, f"{row.value:.3g}", interval, str(row.n))
    Console(emoji=False).print(table)
    if note := _note(result):
        Console(highlight=False, emoji=False).print(note, soft_wrap=True, markup=False)


def _note(result: Result) -> str:
    differs = result.request.get("differs_from_training")
    if differs is None and result.request.get("sensor"):
        return "sensor training settings unknown: the result file does not store them"
    return away_from_training(differs or [])
