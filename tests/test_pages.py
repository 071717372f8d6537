"""Check that each test that a page names exists."""

import re

import pytest
from places import ROOT

NAMED = re.compile(r"`(test_\w+)?(?:::(test_\w+))?`")


@pytest.mark.parametrize(("page", "least"), [("nothing_silent.md", 100), ("frames.md", 27)])
def test_every_test_that_a_page_names_is_there(page, least):
    page = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert len(NAMED.findall(page)) >= least
    missing, file = [], ""
    for found in NAMED.finditer(page):
        if found[1] is None and found[2] is None:
            continue
        file = found[1] or file
        texts = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob(f"{file}.py")]
        if len(texts) != 1 or (found[2] and f"def {found[2]}(" not in texts[0]):
            missing.append(f"{file}::{found[2]}")
    assert not missing
