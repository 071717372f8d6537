"""Where a command begins: what a process needs before anything large is imported, and how it ends.

``mjx_fit.cli.main.main`` is the command itself; it may be called from a program of one's own.
"""

from mjx_fit.utils import interrupts, streams


def main() -> int:
    """Runs the command of this process's arguments.

    Returns:
        The exit code, as ``mjx_fit.cli.main.main``; 1 where standard output could not be written.
    """
    streams.prepare()  # first: a closed stream's number must not become that of another file
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
