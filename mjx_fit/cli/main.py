"""Parse the command line, call the library, and report a refused request in one line with exit code 2."""

import errno
import sys
from collections.abc import Sequence

from mjx_fit.cli.parser import parser
from mjx_fit.utils import environment, granted_cpus, interrupts, memory, streams
from mjx_fit.utils.errors import RequestError, WorkError, one_line

_WRONG_PLACE = {
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.EISDIR,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ELOOP,
    errno.ENAMETOOLONG,
}
"""System errors caused by an invalid path in the request; a full disk is not among them."""

RESUME = "run the same command again to resume"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns:
        0: done. 1: the work failed. 2: the request was invalid; one line on stderr states what is allowed.
        A command that receives a stop signal ends the process with exit code 128 + signal number.
    """
    try:
        _run(argv)
        code = 0
    except KeyboardInterrupt:
        interrupts.end()
    except Exception as error:
        # An error caused by the stop signal, such as that of an encoder in the same terminal, may come first.
        code = interrupts.end() if interrupts.asked() else _refused(error)
    return interrupts.end(done=True) if interrupts.asked() else code


def refuse(message: str, code: int) -> int:
    """Print one line with the reason of a nonzero exit code."""
    print(f"mjx-fit: {one_line(message)}", file=sys.stderr)
    return code


def _run(argv: Sequence[str] | None) -> None:
    args = parser().parse_args(argv)
    interrupts.say_when_stopped(RESUME * args.resumes)
    if args.draws:  # before anything else imports MuJoCo
        from mjx_fit.viz import gl

        gl.choose()
    else:
        environment.draw_nothing()
    if args.computes:  # before the libraries that these settings affect
        memory.require_start()
        granted_cpus.limit_to(args.threads)
    environment.require(args.computes)
    from mjx_fit.utils import process_setup

    process_setup.pin()
    if args.computes:
        process_setup.configure()
    args.command(args)
    streams.finish()


def _refused(error: Exception) -> int:
    """Print a failure of the request or the work and return its exit code; raise any other error."""
    match error:
        case RequestError():
            return refuse(str(error), 2)
        case WorkError():
            return refuse(str(error), 1)
        case BrokenPipeError():  # the reader of the output has closed it
            return 0
        case OSError():
            where = f"{error.filename} cannot be used: {error.strerror}" if error.filename else str(error)
            return refuse(where, 2 if error.errno in _WRONG_PLACE else 1)
        case MemoryError():
            return _no_memory(str(error) or "none left")
    if str(error).startswith("RESOURCE_EXHAUSTED"):  # from XLA, which has no separate error class
        return _no_memory(str(error).partition("RESOURCE_EXHAUSTED: ")[2].partition("\n")[0])
    raise error


def _no_memory(what: str) -> int:
    return refuse(f"this needs more memory than there is ({what}): make it smaller", 1)
