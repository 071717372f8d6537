"""The one error that means: the request was wrong, nothing was done."""


class RequestError(ValueError):
    """A request that cannot be met as it was made.

    The message is one line that names the field, the value and what is allowed. The command line prints it
    and exits with code 2.
    """
