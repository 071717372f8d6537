"""Choice of an engine, and what it says."""

from mjx_fit.config.files import read_config
from mjx_fit.engines.select import make_engine


def test_mjx_says_that_contact_slots_are_few(capsys):
    for name, slots, said in (("mjx", 8, True), ("mjx", 24, False), ("native", 8, False)):
        make_engine(name, read_config(None, [f"scene.max_contacts={slots}"]))
        assert ("mjx: scene.max_contacts is 8" in capsys.readouterr().err) == said
