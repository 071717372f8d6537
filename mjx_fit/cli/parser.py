"""Build the parser of the command line."""

import argparse

from mjx_fit import __version__
from mjx_fit.cli.about_commands import add_about
from mjx_fit.cli.data_commands import add_collect, add_data
from mjx_fit.cli.evaluate_commands import add_evaluate
from mjx_fit.cli.log_commands import add_log
from mjx_fit.cli.options import Parser
from mjx_fit.cli.page_commands import add_demo, add_paper, add_report, add_table
from mjx_fit.cli.part_commands import add_part
from mjx_fit.cli.picture_commands import add_render, add_view
from mjx_fit.cli.sweep_command import add_sweep
from mjx_fit.cli.train_command import add_train


def parser() -> argparse.ArgumentParser:
    """Return the parser; each command sets ``command``, a function of the parsed arguments."""
    root = Parser(prog="mjx-fit", description="Contact-rich assembly under uncertainty, on JAX and MuJoCo.")
    root.add_argument("--version", action="version", version=f"mjx-fit {__version__}")
    parsers = root.add_subparsers(required=True, metavar="COMMAND")
    for add in (
        add_demo,
        add_collect,
        add_data,
        add_log,
        add_part,
        add_train,
        add_evaluate,
        add_sweep,
        add_paper,
        add_report,
        add_table,
        add_render,
        add_view,
        add_about,
    ):
        add(parsers)
    return root
