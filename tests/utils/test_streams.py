"""Standard streams in any state that a shell can create: nothing is raised, and nothing is mixed."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
from mjx_fit.utils import streams
streams.prepare()
{}
streams.finish()
"""


def shell(body, how, **environment):
    """Runs a program under a redirection of the shell's."""
    command = ["sh", "-c", f'"$0" -c "$1" {how}', sys.executable, PROGRAM.format(body)]
    env = os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=env)


MUCH = "print('ä' * 100000)\nprint('é', file=sys.stderr)\nprint('and on', flush=True)\nsys.stdin.read(1)"


@pytest.mark.parametrize(
    "how",
    [">&-", "2>&-", "<&-", ">&- 2>&- <&-", ">/dev/full", "2>/dev/full", "| head -c 1", "2>&1 | true", ""],
)
def test_no_redirection_raises(how):
    done = shell(MUCH, f"{how}; echo ended" if "|" not in how else how, PYTHONIOENCODING="ascii")
    assert "Traceback" not in done.stdout + done.stderr
    assert "Error" not in done.stdout + done.stderr


def test_what_cannot_be_encoded_is_escaped():
    done = shell("print('ä')", "", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stdout) == (0, "\\xe4\n")


def test_no_file_gets_the_number_of_a_closed_stream(tmp_path):
    """Else what is printed would end up in it, here by code that knows no Python."""
    path = tmp_path / "data"
    body = (
        f"file = open({str(path)!r}, 'wb'); os.write(1, b'noise'); os.write(2, b'noise'); file.write(b'data')"
    )
    done = shell(body, ">&- 2>&- <&-")
    assert (done.returncode, path.read_bytes()) == (0, b"data")


def test_what_was_lost_is_known_but_for_a_reader_that_left():
    tell = "print('x' * 100000)\nos.write(2, repr(streams.finish()).encode())"
    assert "No space left" in shell(tell, ">/dev/full").stderr
    assert shell(tell, "| true").stderr == "None"
    assert shell(tell, ">&-").stderr == "None"


def test_a_pipe_that_does_not_wait_gets_everything():
    body = "os.set_blocking(1, False)\nfor _ in range(300): print('x' * 1000)"
    done = shell(body, "| (sleep 0.5; cat)")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == ("x" * 1000 + "\n") * 300


def test_unbuffered_output_stays_so():
    done = shell("sys.stdout.write('a'); os.write(1, b'b')", "", PYTHONUNBUFFERED="1")
    assert done.stdout == "ab"


COMMAND = """
import sys
sys.argv = ["mjx-fit", "--version"]
from mjx_fit.cli.launch import main
sys.exit(main())
"""


def test_a_command_says_that_its_output_is_lost():
    for how, code in ((">/dev/full", 1), (">&-", 0), ("| true", 0)):
        command = ["bash", "-c", f'"$0" -c "$1" {how}; exit ${{PIPESTATUS[0]}}', sys.executable, COMMAND]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == code, how
        lost = "mjx-fit: standard output cannot be written: No space left on device\n"
        assert done.stderr == (lost if code else "")
