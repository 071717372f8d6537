"""Start and end a command: set up the process before large imports, and return the exit code.

``mjx_fit.cli.main.main`` is the command itself; your own program may call it.
"""

from mjx_fit.utils import interrupts, streams


def main() -> int:
    """Run the command given by the arguments of this process.

    Returns:
        The exit code of ``mjx_fit.cli.main.main``; 1 if standard output could not be written.
    """
    streams.prepare()  # first: no other file may get the descriptor of a closed stream
    interrupts.install()
    try:
        code = _run()
    except BaseException:
        if interrupts.asked():
            interrupts.end()
        raise
    interrupts.finished(code)
    return code


def _run() -> int:
    from mjx_fit.utils import environment

    environment.relax_warnings()
    from mjx_fit.cli import main as cli

    try:
        code = cli.main()
    except SystemExit as finished:  # of --help and --version
        code = finished.code if isinstance(finished.code, int) else 0
    lost = streams.finish()
    if lost is not None:
        said = cli.refuse(f"standard output cannot be written: {lost.strerror or lost}", 1)
        code = code or said
    return code
