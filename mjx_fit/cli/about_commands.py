"""Commands ``bench``, ``config`` and ``info``: speed, configuration keys and versions."""

import argparse
import json

from mjx_fit.cli.options import add_command, config_of, configurable, with_config
from mjx_fit.cli.output import show


def add_about(parsers: argparse._SubParsersAction) -> None:
    """Add ``bench``, ``config`` and ``info``."""
    parser = add_command(parsers, "bench", bench, "measure the speed of the engines side by side")
    parser.add_argument("--json", action="store_true")
    configurable(parser)

    parser = add_command(parsers, "config", config_keys, "list every key with its unit, range and default")
    parser.add_argument("--json", action="store_true")
    with_config(parser)

    parser = add_command(parsers, "info", info, "print versions, devices and the default engine")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(computes=True)


def bench(args: argparse.Namespace) -> None:
    """Run ``bench``."""
    from mjx_fit.cli.bench.run import bench

    bench(config_of(args, preset="paper"), args.json)


def config_keys(args: argparse.Namespace) -> None:
    """Run ``config``."""
    from mjx_fit.config.table import as_json, as_text, keys

    table = keys(config_of(args))
    print(json.dumps(as_json(table), indent=1) if args.json else as_text(table))


def info(args: argparse.Namespace) -> None:
    """Run ``info``."""
    import jax

    from mjx_fit.engines.select import resolve
    from mjx_fit.utils import provenance

    show(
        {
            "versions": provenance.versions(),
            "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
            "engine": resolve("auto"),
        },
        args.json,
    )
