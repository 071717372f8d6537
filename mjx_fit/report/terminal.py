"""The summary of a result as a table on the terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mjx_fit.evaluation.results import Result


def print_summary(result: Result) -> None:
    """Prints method, metric, group, value with its 95 % interval, and n."""
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
        metric = row.metric.replace("_", " ")  # a narrow terminal breaks it between words
        names = map(escape, (row.method, metric, row.group))  # a name with brackets is no markup
        table.add_row(*names, f"{row.value:.3g}", interval, str(row.n))
    Console().print(table)
