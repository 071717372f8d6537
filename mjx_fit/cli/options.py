"""Pieces that the commands' arguments are put together from."""

import argparse
from collections.abc import Callable
from typing import NoReturn

from mjx_fit.cli.path_argument import path
from mjx_fit.utils.errors import RequestError, shortened


class Parser(argparse.ArgumentParser):
    """argparse, but with a refusal in one line, and no abbreviations: --trial and --trials are two things."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        raise RequestError(f"{shortened(message, 300)}; see {self.prog} --help")


def add_command(
    parsers: argparse._SubParsersAction,
    name: str,
    run: Callable[[argparse.Namespace], None],
    text: str,
    *,
    resumes: bool,
) -> argparse.ArgumentParser:
    """Add a command, with what it calls, a sentence about it, and whether it keeps what a stop interrupts."""
    parser = parsers.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.set_defaults(command=run, computes=False, draws=False, resumes=resumes, threads=None)
    return parser


def simulating(parser: argparse.ArgumentParser) -> None:
    """Add engine and seed."""
    parser.add_argument("--engine", default="auto", help="auto, mjx or native (default auto)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="root seed (default 0)")


def configurable(parser: argparse.ArgumentParser) -> None:
    """Add threads and the configuration; mark the command as one that computes."""
    parser.set_defaults(computes=True)
    parser.add_argument(
        "--threads", type=int, metavar="N", help="most CPU threads (default: all that it may use)"
    )
    with_config(parser)


def with_config(parser: argparse.ArgumentParser) -> None:
    """Add the configuration."""
    parser.add_argument(
        "--config",
        type=path,
        action="append",
        default=[],
        metavar="FILE",
        help="YAML with what differs from the defaults (demo, paper, bench: from their preset); repeatable, "
        "later ones win",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="e.g. scene.clearance_m=0.002; repeatable",
    )
