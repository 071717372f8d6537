"""Result files of measurement scripts."""

import json

from mjx_fit.report import script


def test_a_file_that_is_added_to_names_its_last_origin(tmp_path):
    stored = {"command": "python earlier.py", "device": "elsewhere", "rows": {"a": 1}}
    script.save(tmp_path / "r.json", stored | {"rows": {"a": 1, "b": 2}})
    found = json.loads((tmp_path / "r.json").read_text())
    assert found["rows"] == {"a": 1, "b": 2}
    assert "earlier" not in found["command"]
    assert found["device"] != "elsewhere"
