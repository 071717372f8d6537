"""The attempt experiment goes on where it was stopped."""

from dataclasses import replace

import pytest

from mjx_fit.config.schema import Config
from mjx_fit.engines.native.engine import NativeEngine
from mjx_fit.evaluation import attempt
from mjx_fit.evaluation.request import Request


def test_it_resumes_at_the_batch_that_was_interrupted(tmp_path, monkeypatch):
    monkeypatch.setattr(attempt, "ATTEMPT_BATCH", 6)
    config = Config()
    config = replace(config, task=replace(config.task, attempt_actions=2))

    class Stopped(NativeEngine):
        """Stops at its third batch."""

        runs, stops_at = 0, 3

        def run(self, *args, **kwargs):
            self.runs += 1
            if self.runs == self.stops_at:
                raise KeyboardInterrupt
            return super().run(*args, **kwargs)

    whole = attempt.attempt(Request(config, tmp_path / "whole.json", NativeEngine(config, 1), 4))
    stopped = Stopped(config, 1)
    with pytest.raises(KeyboardInterrupt):
        attempt.attempt(Request(config, tmp_path / "a.json", stopped, 4))
    assert not (tmp_path / "a.json").exists()
    resumed = attempt.attempt(Request(config, tmp_path / "a.json", stopped, 4))
    assert stopped.runs == 4
    assert (resumed.trials, resumed.summary) == (whole.trials, whole.summary)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "whole.json"]
