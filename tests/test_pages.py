"""What the pages say of the tests is true: each test that a page names is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
NAMED = re.compile(r"`(test_\w+)?(?:::(test_\w+))?`")


def test_every_test_that_the_table_of_faults_names_is_there():
    page = (ROOT / "docs" / "nothing_silent.md").read_text(encoding="utf-8")
    missing, file = [], ""
    for found in NAMED.finditer(page):
        if found[1] is None and found[2] is None:
            continue
        file = found[1] or file
        path = ROOT / "tests" / f"{file}.py"
        if not path.is_file() or (found[2] and f"def {found[2]}(" not in path.read_text(encoding="utf-8")):
            missing.append(f"{file}::{found[2]}")
    assert not missing
