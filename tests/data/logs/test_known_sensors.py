"""Wrenches of sensors that are known, by the maps in experiments/logs/maps, are those of the library."""

import numpy as np
import pytest
import yaml
from places import ROOT
from robot_logs import FORCE, QUAT, TORQUE, map_of_table, recorded, table_of
from scipy.spatial.transform import Rotation, Slerp
from test_importing import compare, imported

from mjx_fit.data.logs.log_map import read_map

LBF_N, INCH_M = 4.4482216, 0.0254


@pytest.fixture(scope="module")
def own(attempts):
    return recorded(attempts, noise_n=0.02)


@pytest.fixture(scope="module")
def felt(own, tmp_path_factory):
    return [one.felt for one in imported(tmp_path_factory.mktemp("clean"), table_of(own)).attempts]


def wrenches(rows):
    return rows["fx"].notna()


def about(rows, up):
    """Take torques about a point this far from the library's sensor, in its axes."""
    rows[TORQUE] -= np.cross(up, rows[FORCE].to_numpy())


def turned(rows, turn):
    for names in (FORCE, TORQUE):
        rows.loc[wrenches(rows), names] = turn.apply(np.array(rows.loc[wrenches(rows), names]))


def of_a_franka(rows):
    """About the TCP, in the axes of the base, and without the weight that the robot knows."""
    rows.loc[wrenches(rows), FORCE + TORQUE] -= rows.loc[wrenches(rows), FORCE + TORQUE].iloc[:200].mean()
    about(rows, [0, 0, 0.07])
    there = rows["qw"].notna()
    times = rows.loc[there, "time"].to_numpy()
    tool = Slerp(times, Rotation.from_quat(rows.loc[there, QUAT].to_numpy(), scalar_first=True))
    turned(rows, tool(np.clip(rows.loc[wrenches(rows), "time"], times[0], times[-1])))


def of_an_ft300(rows):
    """Its x is the tool's -y: the connector points to y."""
    x, y = (rows[names].to_numpy() for names in (["fx", "tx"], ["fy", "ty"]))
    rows[["fx", "tx"]], rows[["fy", "ty"]] = -y, x
    rows[FORCE + TORQUE] *= -1


def of_a_gamma(rows):
    """Pounds and inches, 0.03 m above the library's sensor."""
    about(rows, [0, 0, -0.03])
    rows[FORCE] /= -LBF_N
    rows[TORQUE] /= -LBF_N * INCH_M


def map_of(name):
    """Return the committed map, with the columns of the table as its sources."""
    said = map_of_table()
    said["wrench"] = yaml.safe_load((ROOT / "experiments/logs/maps" / name).read_text())["wrench"]
    said["wrench"]["source"] = [*FORCE, *TORQUE]
    return said


def tared(felt):
    """Return the wrenches of attempts without their constant part."""
    return [np.asarray(one.trace.wrench_sensor) - np.asarray(one.tare_sensor) for one in felt]


@pytest.mark.parametrize(
    ("name", "change"),
    [("ft300.yaml", of_an_ft300), ("gamma.yaml", of_a_gamma)],
)
def test_a_sensor_at_the_wrist_reads_what_the_arm_exerts_on_the_peg(name, change, own, felt, tmp_path):
    rows = table_of(own)
    change(rows)
    compare(imported(tmp_path, rows, map_of(name)), felt, 1e-3, 1e-5)


def test_a_frankas_estimate_is_that_wrench_but_for_the_weight(own, felt, tmp_path):
    rows = table_of(own)
    of_a_franka(rows)
    got = imported(tmp_path, rows, map_of("franka.yaml"))
    assert not got.refused
    for one, other in zip(tared([each.felt for each in got.attempts]), tared(felt), strict=True):
        np.testing.assert_allclose(one, other[: len(one)], atol=0.05)


@pytest.mark.parametrize("change", [of_a_franka, of_an_ft300, of_a_gamma])
def test_the_other_sign_is_refused(change, own, tmp_path):
    """Pressing down would be a pull: no map with a wrong sign passes, even without a weight to tell it."""
    name = {of_a_franka: "franka.yaml", of_an_ft300: "ft300.yaml", of_a_gamma: "gamma.yaml"}[change]
    rows, said = table_of(own), map_of(name)
    change(rows)
    said["wrench"]["acts_on"] = "arm" if change is of_a_franka else "peg"
    got = imported(tmp_path, rows, said)
    assert got.refused
    assert any("sign" in str(one) or "press" in str(one) or "weight" in str(one) for one in got.findings)


def test_what_hangs_below_a_sensor_at_rest_pulls_along_its_z(own):
    """The weight of the peg is positive for drivers, and negative in the library's sign."""
    rows = table_of(own)
    of_an_ft300(rows)
    rest = rows.loc[wrenches(rows)].iloc[:200]
    assert rest["fz"].mean() == pytest.approx(0.98, abs=0.02)


def test_a_log_at_100_hz_is_read_at_the_librarys_rate(own, felt, tmp_path):
    """Means over an action stay; what happens within 10 ms is lost."""
    rows = table_of(own)
    of_an_ft300(rows)
    kept = ~wrenches(rows) | (np.cumsum(wrenches(rows)) % 5 == 1)
    got = imported(tmp_path, rows[kept].reset_index(drop=True), map_of("ft300.yaml"))
    assert len(got.attempts) == len(felt)
    for one, other in zip(got.attempts, felt, strict=True):
        new, old = (np.asarray(each.trace.wrench_sensor).mean(1) for each in (one.felt, other))
        assert np.abs(new - old[: len(new)]).mean() < 0.15


def test_every_committed_map_can_be_read():
    maps = sorted((ROOT / "experiments/logs/maps").glob("*.yaml"))
    assert len(maps) == 3
    for path in maps:
        assert read_map(path).wrench.acts_on == ("peg" if path.stem == "franka" else "arm")
