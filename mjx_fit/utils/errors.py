"""The two errors that the command line reports in one line, and the formatting of values in messages."""

import reprlib

MOST_CHARACTERS = 80
"""Longest quotation of a value in an error message."""
MOST_OF_A_LINE = 2000

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxdict, _SHORT.maxset = 4, 12, 12, 12, 12
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = MOST_CHARACTERS


class RequestError(ValueError):
    """Invalid request: a value, file or combination that cannot be used.

    The message is one line that names the field, the value and the allowed values. The command line prints it
    and exits with code 2.

    Example:
        >>> import mjx_fit as mf
        >>> try:
        ...     mf.make_engine("mujoco")
        ... except mf.RequestError as error:
        ...     print(error)
        --engine: 'mujoco' is invalid: choose from auto, mjx, native
    """


class WorkError(RuntimeError):
    """Failure of a valid request at run time; the command line exits with code 1."""


def require(field: str, value: float, low: float, high: float, because: str = "") -> None:
    """Check that a number lies within a range; NaN does not.

    Args:
        field: Name of the field as the user wrote it, such as ``--trials``.
        value: Number to check.
        low: Smallest allowed value.
        high: Largest allowed value.
        because: Reason for the range, if it does not depend on the field alone.

    Raises:
        RequestError: The number is out of range.
    """
    if not low <= value <= high:
        reason = f": {because}" if because else ""
        raise RequestError(f"{field}: {shown(value)} is out of range: expected {low} to {high}{reason}")


def shown(value: object) -> str:
    """Format a value for an error message: its ``repr``, truncated to ``MOST_CHARACTERS``."""
    try:
        text = _SHORT.repr(value)
    except ValueError:  # Python refuses to format integers of more than 4,300 digits
        text = f"a {type(value).__name__} too long to print"
    return shortened(text)


def one_line(message: str) -> str:
    """Collapse a message, which may quote a library's error, to one line of bounded length."""
    return shortened(" ".join(message.split()), MOST_OF_A_LINE)


def shortened(text: str, most: int = MOST_CHARACTERS) -> str:
    """Shorten text to at most ``most`` characters, with dots in place of the omitted part."""
    return text if len(text) <= most else f"{text[: most - 12]}...{text[-9:]}"
