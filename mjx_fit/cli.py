"""The command line: parses, calls the library, and turns a refused request into one line and exit code 2."""

import errno
import os
import sys
from collections.abc import Sequence

from mjx_fit.arguments import parser
from mjx_fit.errors import RequestError, WorkError

_WRONG_PLACE = {
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.EISDIR,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
}
"""What the system says of a path that should not have been asked for; a full disk is another matter."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command.

    Returns:
        0: done. 1: the work failed. 2: the request was wrong; one line on stderr says what is allowed.
    """
    resumes = False
    try:
        args = parser().parse_args(argv)
        resumes = args.resumes
        if args.draws:  # before anything else imports MuJoCo
            from mjx_fit.picture import gl

            gl.choose()
        if args.computes:
            from mjx_fit import granted, memory

            memory.require_start()
            granted.limit_to(args.threads)
            from mjx_fit import runtime  # only now: it imports the libraries that these two are about

            runtime.configure()
        args.command(args)
        sys.stdout.flush()
    except RequestError as error:
        return _refuse(str(error), 2)
    except WorkError as error:
        return _refuse(str(error), 1)
    except BrokenPipeError:  # whoever read the output has seen enough; nothing is left to be flushed to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        where = f"{error.filename} cannot be used: {error.strerror}" if error.filename else str(error)
        return _refuse(where, 2 if error.errno in _WRONG_PLACE else 1)
    except MemoryError as error:
        return _refuse(f"this needs more memory than there is ({error or 'none left'}): make it smaller", 1)
    except KeyboardInterrupt:
        _refuse(
            "stopped"
            + "; the same command, given again, goes on behind the last part that was finished" * resumes,
            1,
        )
        # At once: XLA may still be compiling in a thread of its own, and an orderly exit would crash in it.
        sys.stderr.flush()
        os._exit(1)
    return 0


def _refuse(message: str, code: int) -> int:
    print(f"mjx-fit: {' '.join(message.split())}", file=sys.stderr)
    return code
