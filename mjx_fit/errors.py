"""The two errors that the command line turns into one line."""


class RequestError(ValueError):
    """A request that cannot be met as it was made.

    The message is one line that names the field, the value and what is allowed. The command line prints it
    and exits with code 2.
    """


class WorkError(RuntimeError):
    """Work that was asked for rightly and failed all the same; the command line exits with code 1."""
