"""A request to stop is met, whatever the process is doing; a child does not outlive its parent."""

import os
import signal
import subprocess
import sys
import time

import pytest

BEGIN = """
import ctypes, gc, os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever this test was started with
from mjx_fit.utils import interrupts
interrupts.GRACE_S = 1.0
interrupts.install()
interrupts.say_when_stopped("this is kept")
def ask(number=signal.SIGINT):
    os.kill(os.getpid(), number)
    time.sleep(0.3)
"""


def run(body, begin=BEGIN):
    command = [sys.executable, "-c", begin + body]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_every_request_has_its_exit_code(name, code):
    body = f"""
try:
    ask(signal.{name})
except KeyboardInterrupt:
    interrupts.end()
"""
    # Whoever runs the tests may ignore SIGHUP, as nohup does.
    begin = BEGIN.replace("signal.signal(", "signal.signal(signal.SIGHUP, signal.SIG_DFL); signal.signal(", 1)
    done = run(body, begin)
    assert (done.returncode, done.stderr) == (code, "mjx-fit: stopped; this is kept\n")


DROPPED = {
    "the garbage collector": "gc.callbacks.append(lambda *_: ask()); gc.collect(); gc.callbacks.pop()",
    "a callback of C code": "ctypes.CFUNCTYPE(None)(ask)()",
    "a finalizer": "type('X', (), {'__del__': lambda self: ask()})()",
    "code that catches everything": "try: ask()\nexcept BaseException: pass",
}


@pytest.mark.parametrize("where", DROPPED)
def test_a_request_that_was_dropped_is_met_at_the_next_beat(where):
    body = f"""
{DROPPED[where]}
try:
    interrupts.check()
    print("went on")
except KeyboardInterrupt:
    interrupts.end()
"""
    done = run(body)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "mjx-fit: stopped; this is kept\n")


def test_or_seconds_later_or_at_a_second_signal():
    """Nobody asks: neither in Python, which drops it, nor in C, which Python's handler cannot reach."""
    busy = (
        "threading.Thread(target=lambda: (time.sleep(0.2), os.kill(os.getpid(), signal.SIGTERM))).start()\n"
    )
    in_c = "import hashlib\nhashlib.pbkdf2_hmac('sha512', b'', b'', 200_000_000)"
    began = time.monotonic()
    done = run(busy + in_c)
    assert (done.returncode, done.stderr) == (143, "mjx-fit: stopped; this is kept\n")
    assert time.monotonic() - began < 30
    twice = run("interrupts.GRACE_S = 100\n" + DROPPED["a callback of C code"] + "\nask()\ntime.sleep(30)")
    assert (twice.returncode, twice.stderr) == (130, "mjx-fit: stopped; this is kept\n")


def test_who_asks_after_the_end_is_told_so():
    done = run("interrupts.finished(0)\nask()\nprint('went on')")
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr == "mjx-fit: asked to stop; the work was complete\n"


def test_a_process_that_is_done_ends_after_everything_else_was_cleaned_up():
    """And before Python takes its modules apart, when a signal would kill it."""
    body = """
import atexit
class Late:
    def __del__(self): print("taken apart", flush=True)
late = Late()
atexit.register(lambda: (print("cleaned up", flush=True), {more}))
interrupts.finished(3)
"""
    done = run(body.format(more="None"))
    assert (done.returncode, done.stdout, done.stderr) == (3, "cleaned up\n", "")
    asked = run(body.format(more="ask()"))
    assert (asked.returncode, asked.stdout) == (3, "cleaned up\n")
    assert asked.stderr == "mjx-fit: asked to stop; the work was complete\n"


def test_a_request_that_is_settled_is_forgotten():
    done = run(f"{DROPPED['a callback of C code']}\ninterrupts.settle()\ntime.sleep(1.5)\ninterrupts.check()")
    assert (done.returncode, done.stderr) == (0, "")


def test_what_a_starter_ignored_stays_ignored():
    begin = BEGIN.replace("signal.signal(", "signal.signal(signal.SIGHUP, signal.SIG_IGN); signal.signal(", 1)
    done = run("ask(signal.SIGHUP)\ntime.sleep(1.2)", begin)
    assert (done.returncode, done.stderr) == (0, "")


LAUNCH = """
import os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = ["mjx-fit", *{words}]
from mjx_fit.cli.launch import main
threading.Timer({delay}, os.kill, (os.getpid(), {number})).start()
sys.exit(main())
"""


def launch(words, delay, number=signal.SIGINT):
    return run("", LAUNCH.format(words=words, delay=delay, number=int(number)))


ASKS_WHILE_IMPORTING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Asks:
    def find_spec(self, name, path, target=None):
        if name == "mjx_fit.cli.main":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Asks())
sys.argv = ["mjx-fit", "info", "--json"]
from mjx_fit.cli.launch import main
sys.exit(main())
"""


def test_a_request_while_importing_is_one_line():
    done = run("", ASKS_WHILE_IMPORTING)
    assert (done.returncode, done.stderr) == (130, "mjx-fit: stopped\n")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_request_at_any_moment_is_met_or_comes_too_late(tmp_path):
    """Within imports, compiling, work, and the end of a command."""
    for step in range(40):
        number = (signal.SIGINT, signal.SIGTERM)[step % 2]
        out = tmp_path / str(step)
        done = launch(
            ["collect", "--episodes", "2", "--steps", "2", "--out", str(out)], 0.1 + 0.2 * step, number
        )
        assert done.returncode in (0, 128 + number)
        said = [line for line in done.stderr.splitlines() if line.startswith("mjx-fit: ")]
        assert "Traceback" not in done.stderr
        if done.returncode:
            assert said[0].startswith("mjx-fit: stopped")
        else:
            assert said in ([], ["mjx-fit: asked to stop; the work was complete"])
            assert (out / "manifest.json").is_file()


def alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


PARENT = """
import os, subprocess, sys
os.environ["MJX_FIT_PARENT"] = str(os.getpid())
sleeper = "import time; from mjx_fit.utils import interrupts as i; i.install(); "
sleeper += "print(1,flush=1); time.sleep(60)"
child = subprocess.Popen([sys.executable, "-c", sleeper], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
child.wait()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_child_ends_with_its_parent(number):
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert alive(child)
        parent.send_signal(number)
        parent.wait(10)
    deadline = time.monotonic() + 20
    while alive(child) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not alive(child)


def test_a_command_stops_its_child_before_itself(monkeypatch, tmp_path):
    """As demo's drawing: the child is ended by name, not by the loss of its parent."""
    from mjx_fit.utils import children

    pids = []
    popen = subprocess.Popen

    def start(words, env):
        assert env["MJX_FIT_PARENT"] == str(os.getpid())
        child = popen([sys.executable, "-c", "import time; time.sleep(60)"], env=env)
        pids.append(child.pid)
        monkeypatch.setattr(child, "wait", lambda *time_s: waited(child, *time_s))
        return child

    def waited(child, *time_s):
        if not time_s:
            raise KeyboardInterrupt
        return popen.wait(child, *time_s)

    monkeypatch.setattr(children.subprocess, "Popen", start)
    with pytest.raises(KeyboardInterrupt):
        children.run(["render"])
    assert not alive(pids[0])
