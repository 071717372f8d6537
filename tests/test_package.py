"""The wheel, built from the sdist, installed in an empty environment and used from another folder."""

import subprocess
import sys
import venv
import zipfile

import pytest
from places import ROOT

from mjx_fit.utils import resources

SHIPPED = ("models/panda.xml", "models/table.xml", "configs/quick.yaml", "configs/worlds/paper.yaml")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    # Without --wheel it is built from the sdist, which so is checked, too.
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, timeout=200)
    return next(out.glob("*.whl"))


def test_wheel_holds_models_configs_and_weights(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"mjx_fit/assets/{name}" for name in SHIPPED} <= names
    weights = resources.folder("weights")
    files = {path.relative_to(weights).as_posix() for path in weights.rglob("*") if path.is_file()}
    assert {f"mjx_fit/assets/weights/{name}" for name in files} <= names
    licences = {name.rpartition("/")[2] for name in names if ".dist-info/licenses/" in name}
    assert licences == {"LICENSE", "NOTICE"}
    assert not any(name.startswith(("tests/", "runs/", "benchmarks/")) for name in names)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_installed_wheel_works_outside_the_checkout(wheel, tmp_path):
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", str(wheel)], check=True, timeout=600)
    away = tmp_path / "away"
    away.mkdir()
    assembly = ["evaluate", "assembly", "--methods", "full", "--trials", "2", "--out", "a.json"]
    collect = ["collect", "--episodes", "4", "--steps", "5", "--out", "d"]
    for argv in (["info"], collect, assembly, ["report", "a.json", "d"]):
        subprocess.run([tmp_path / "env" / "bin" / "mjx-fit", *argv], check=True, cwd=away, timeout=200)
    assert (away / "d" / "manifest.json").is_file()
