"""Build the API reference of the public names, with signatures as short as they are written.

    python docs/build_api.py [FOLDER]

pdoc prints annotations as Python evaluates them: an array of shape (n, 2) becomes a union over JAX and NumPy,
with module paths. This script prints ``Float[n 2]`` instead, and names without modules.
"""

import re
import sys
import warnings
from pathlib import Path

import pdoc
import pdoc.doc

_ARRAY = r"(?:jaxtyping\.)?(\w+)\[(?:jaxlib\._jax\.Array|jax\.Array|ndarray), '([^']*)'\]"
_EITHER = re.compile(r"(?:typing\.)?Union\[" + _ARRAY + ", " + _ARRAY + r"(, NoneType)?\]")
_ONE = re.compile(_ARRAY)
_MODULES = re.compile(
    r"\b(?:mjx_fit|typing|pathlib|collections\.abc|numpy|jaxtyping|builtins)\.(?:\w+\.)*(?=\w)"
)
_LONG_DEFAULT = re.compile(r"(= ?)(\w+)\(.{20,}\)$")


def shortened(annotation: str) -> str:
    """Shorten an annotation: ``Float[n 2]`` for arrays, names without modules, defaults by their type."""
    text = _EITHER.sub(
        lambda found: f"{_array(found[1], found[2])}{' | None' if found[5] else ''}", annotation
    )
    text = _ONE.sub(lambda found: _array(found[1], found[2]), text)
    return _LONG_DEFAULT.sub(r"\1\2(...)", _MODULES.sub("", text))


def _array(kind: str, shape: str) -> str:
    return f"{kind}[{shape}]" if shape else kind


def main(folder: Path) -> None:
    """Write the pages."""
    warnings.filterwarnings("ignore", "(?s).*PydanticDataclass")  # pydantic's, which no reader needs
    signature = pdoc.doc._PrettySignature
    parameters, returned = signature._params, signature._return_annotation_str
    signature._params = lambda self: [shortened(one) for one in parameters(self)]
    signature._return_annotation_str = lambda self: shortened(returned(self))
    pdoc.render.configure(docformat="google", show_source=False)
    pdoc.pdoc("mjx_fit", output_directory=folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "api")
