"""Print trees of values on the terminal."""

import json


def show(tree: dict, as_json: bool) -> None:
    """Print a tree as JSON or as YAML."""
    import yaml

    text = (
        json.dumps(tree, indent=1) if as_json else yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    )
    print(text.rstrip())
