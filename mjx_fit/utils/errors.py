"""The two errors that the command line turns into one line, and how they show what was asked for."""

import reprlib

MOST_CHARACTERS = 80
"""Of a value that a refusal quotes."""
MOST_OF_A_LINE = 2000

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxdict, _SHORT.maxset = 4, 12, 12, 12, 12
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = MOST_CHARACTERS


class RequestError(ValueError):
    """A request that cannot be met as it was made.

    The message is one line that names the field, the value and what is allowed. The command line prints it
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
    """Work that was asked for rightly and failed all the same; the command line exits with code 1."""


def require(field: str, value: float, low: float, high: float, because: str = "") -> None:
    """Refuse a number that is out of range, or no number.

    Args:
        field: What the user wrote it as, such as ``--trials``.
        value: The number.
        low: Least one that is allowed.
        high: Largest one.
        because: What the range follows from, where that is not the field alone.

    Raises:
        RequestError: It is invalid.
    """
    if not low <= value <= high:
        reason = f": {because}" if because else ""
        raise RequestError(f"{field}: {shown(value)} is out of range: expected {low} to {high}{reason}")


def shown(value: object) -> str:
    """A value as an error message quotes it: its ``repr``, cut to ``MOST_CHARACTERS``, whatever its size."""
    try:
        text = _SHORT.repr(value)
    except ValueError:  # Python writes no integer of more than 4,300 digits
        text = f"a {type(value).__name__} that is too long to write"
    return shortened(text)


def one_line(message: str) -> str:
    """A message as it is printed: whatever a library put into it, a line that a terminal holds."""
    return shortened(" ".join(message.split()), MOST_OF_A_LINE)


def shortened(text: str, most: int = MOST_CHARACTERS) -> str:
    """Text that is no longer than that: what is left out is where the dots are."""
    return text if len(text) <= most else f"{text[: most - 12]}...{text[-9:]}"
