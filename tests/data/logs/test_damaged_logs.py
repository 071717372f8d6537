"""Damaged logs and wrong maps: each is refused in one line, or what is accepted is what was felt."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from robot_logs import COMMAND, FORCE, PLACE, QUAT, TORQUE, map_of_table, recorded, table_of
from scipy.spatial.transform import Rotation
from test_importing import compare, imported

import mjx_fit as mf
from mjx_fit.config.files import read_config
from mjx_fit.config.worlds import world_file
from mjx_fit.data.logs.consistency import Contact, _against_motion, inconsistencies

rng = np.random.default_rng(5)


@pytest.fixture(scope="module")
def own(attempts):
    return recorded(attempts, noise_n=0.02)


@pytest.fixture(scope="module")
def felt(own, tmp_path_factory):
    return [one.felt for one in imported(tmp_path_factory.mktemp("clean"), table_of(own)).attempts]


def wrenches(rows):
    return rows.index[rows["fx"].notna()]


def in_attempt(rows, own, number=1, after_s=4.0):
    """Return the wrenches of an attempt from some time on."""
    begin = own.attempts[number][0] + after_s
    return rows.index[rows["fx"].notna() & (rows["time"] >= begin)]


def two_not_finite(rows, own):
    rows.loc[in_attempt(rows, own)[[0, 40]], "fy"] = np.inf


def duplicated(rows, own):
    again = np.sort(np.concatenate([np.arange(len(rows)), in_attempt(rows, own)[:30]]))
    return rows.loc[again].reset_index(drop=True)


def a_little_out_of_order(rows, own):
    at = in_attempt(rows, own)[:500].to_numpy()
    order = np.argsort(np.arange(500) + rng.uniform(0, 8, 500))
    rows.loc[at] = rows.loc[at].to_numpy()[order]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (two_not_finite, "wrench: 2 samples are not finite: left out"),
        (duplicated, "wrench: 30 samples are at the time of another: left out"),
        (a_little_out_of_order, "samples come late, by up to"),
    ],
)
def test_small_damage_is_repaired_and_told(damage, said, own, felt, tmp_path):
    rows = table_of(own)
    changed = damage(rows, own)
    got = imported(tmp_path, rows if changed is None else changed)
    assert [one.severity for one in got.findings] == ["repaired"]
    assert said in got.findings[0].what
    begin = own.attempts[1][0]
    assert begin + 3.9 < got.findings[0].at_s < begin + 5.1
    compare(got, felt, wrench=0.5)


def test_other_rates_and_jitter_change_little(own, felt, tmp_path):
    for hertz in (100, 250, 1000):
        rows, times = table_of(own), own.wrench[:, 0]
        at = np.arange(times[0], times[-1], 1 / hertz)
        at += rng.uniform(-0.1, 0.1, len(at)) / hertz
        values = np.column_stack([np.interp(at, times, column) for column in own.wrench[:, 1:].T])
        rows = rows[rows["fx"].isna()]
        fast = table_of(type(own)(np.column_stack([at, values]), own.pose, own.command, own.attempts))
        got = imported(tmp_path, fast)
        assert got.findings == ()
        assert len(got.attempts) == len(felt)
        for one, other in zip(got.attempts, felt, strict=True):
            new, old = (np.asarray(each.trace.wrench_sensor).mean(1) for each in (one.felt, other))
            assert np.abs(new - old).mean() < 0.1


def a_gap(rows, own):
    at = in_attempt(rows, own)[:100]
    rows.drop(index=at, inplace=True)


def saturated(rows, own):
    rows.loc[in_attempt(rows, own)[:5], "fz"] = 300.0


def stopped(rows, own):
    at = in_attempt(rows, own)[:100]
    rows.loc[at, FORCE + TORQUE] = rows.loc[at[0], FORCE + TORQUE].to_numpy(float)


def no_poses(rows, own):
    lost = rows["qw"].notna() & (rows["time"] > own.attempts[1][0] + 4)
    lost &= rows["time"] < own.attempts[1][0] + 4.4
    rows.drop(index=rows.index[lost], inplace=True)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (a_gap, "attempt 1: log: wrench_time_s: no sample for 0.20"),
        (saturated, "attempt 1: the force is saturated at"),
        (stopped, "attempt 1: the wrench does not change for 0.198 s: the sensor stopped"),
        (no_poses, "attempt 1: log: pose_time_s: no sample for 0.4"),
    ],
)
def test_an_attempt_that_lost_samples_is_left_out_and_the_others_stay(damage, said, own, felt, tmp_path):
    rows = table_of(own)
    damage(rows, own)
    got = imported(tmp_path, rows)
    assert [one.severity for one in got.findings] == ["left out"]
    assert said in got.findings[0].what
    compare(got, [felt[0], felt[2]])


def clock_jumps_back(rows, own):
    rows.loc[rows["time"] > own.attempts[1][0] + 3, "time"] -= 5


def slow_wrench(rows, own):
    at = wrenches(rows)
    rows.drop(index=at[np.arange(len(at)) % 25 > 0], inplace=True)


def in_metres_that_are_millimetres(rows, own):
    rows[PLACE] *= 1000


def a_flipped_sign(rows, own):
    rows[FORCE + TORQUE] *= -1


def flipped_x(rows, own):
    rows["fx"] *= -1


def flipped_y(rows, own):
    rows["fy"] *= -1


def flipped_torque(rows, own):
    rows[TORQUE] *= -1


def flipped_twist(rows, own):
    rows["tz"] *= -1


def swapped_with_the_press(rows, own):
    rows[["fx", "fz"]] = rows[["fz", "fx"]].to_numpy()


def swapped_axes(rows, own):
    rows[["fx", "fy", "tx", "ty"]] = rows[["fy", "fx", "ty", "tx"]].to_numpy()


def a_sensor_turned_by_90_degrees(rows, own):
    rows[["fx", "fy", "tx", "ty"]] = rows[["fy", "fx", "ty", "tx"]].to_numpy() * [-1, 1, -1, 1]


def newton_millimetres(rows, own):
    rows[TORQUE] *= 1000


def scalar_last(rows, own):
    rows[QUAT] = rows[["qx", "qy", "qz", "qw"]].to_numpy()


def a_hand_of_another_length(rows, own):
    rows["z"] += 0.05


def mirrored_positions(rows, own):
    rows["x"] = 1.0 - rows["x"]


def no_contact(rows, own):
    at = wrenches(rows)
    rows.loc[at, FORCE + TORQUE] = rng.normal(0, 0.02, (len(at), 6))


def contact_from_the_first_sample_on(rows, own):
    rows.drop(index=rows.index[rows["time"] < own.attempts[0][0] + 3], inplace=True)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (clock_jumps_back, "the clock goes back by 4.998 s"),
        (slow_wrench, "wrench: 20 samples per second are too few: expected at least 90"),
        (in_metres_that_are_millimetres, "check pose.length"),
        (a_flipped_sign, "the arm pulls by"),
        (flipped_x, "F_x"),
        (flipped_y, "F_y"),
        (flipped_twist, "T_z has the opposite sign"),
        (flipped_torque, "T_y changes with F_x as with a lever of -"),
        (swapped_axes, "wrench: "),
        (swapped_with_the_press, "of the force in contact: expected at least 0.5"),
        (a_sensor_turned_by_90_degrees, "lateral forces point"),
        (newton_millimetres, "as with a lever of"),
        (a_hand_of_another_length, "mm above the plate in contact: expected -30 to 20"),
        (mirrored_positions, "lateral forces point"),
        (no_contact, "no contact"),
        (contact_from_the_first_sample_on, "expected free motion there"),
    ],
)
def test_a_log_that_contradicts_its_map_is_refused(damage, said, own, tmp_path):
    rows = table_of(own)
    damage(rows, own)
    got = imported(tmp_path, rows)
    assert got.refused
    assert got.attempts == ()
    lines = [str(one) for one in got.findings if one.severity == "refused"]
    assert any(said in line for line in lines), lines
    assert all("\n" not in line for line in lines)


def test_another_order_of_the_quaternion_is_refused(own, tmp_path):
    """Read as w x y z, that of x y z w leans or turns the tool by half a turn: friction tells."""
    rows, said = table_of(own), map_of_table()
    said["pose"]["rotation"] = "quat_xyzw"
    assert imported(tmp_path, rows, said).refused


def test_a_late_wrench_and_a_tilted_sensor_are_told(own, felt, tmp_path):
    rows = table_of(own)
    rows.loc[wrenches(rows), "time"] += 0.15
    got = imported(tmp_path, rows.sort_values("time", kind="stable"))
    assert got.refused
    assert any("ms after the tool is stopped" in str(one) for one in got.findings)
    for angle in (20, 40):
        for attempts, severity in ((1, "noted"), (3, "refused")):  # one attempt does not tell as well
            rows = table_of(own)
            turn = Rotation.from_euler("y", angle, degrees=True)
            for names in (FORCE, TORQUE):
                rows.loc[wrenches(rows), names] = turn.apply(np.array(rows.loc[wrenches(rows), names]))
            rows = rows[rows["time"] < own.attempts[attempts - 1][1] + 1]
            (line,) = [one for one in imported(tmp_path, rows).findings if "the force leans" in one.what]
            assert line.severity == severity


def test_good_logs_of_worlds_with_other_friction_are_accepted(tmp_path):
    """Pegs that are caught, drop in, or are held askew do not look like wrong maps."""
    for world in ("forge", "bench"):
        config = read_config(world_file(world))
        felt = (
            mf.make_engine("native", config).run(mf.draw_attempts(jax.random.key(7), 6, config=config)).felt
        )
        rows = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], felt) for i in range(6)]
        assert [one for one in inconsistencies(rows, config) if one.severity == "refused"] == []


def test_commands_in_millimetres_are_refused(own, tmp_path):
    rows = table_of(own)
    rows[COMMAND] *= 1000
    got = imported(tmp_path, rows)
    assert got.refused
    assert "check command.length" in got.findings[-1].what


def test_a_peg_that_is_caught_pushes_hard_and_is_no_wrong_axis():
    """Directions count, not sizes: 35 actions of sliding outweigh five of pushing against a wall."""
    turn = np.linspace(0, 4 * np.pi, 40)
    along = np.column_stack([np.cos(turn), np.sin(turn)])
    across = along @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    caught = (np.arange(40) % 8 == 0)[:, None]
    lateral = np.where(caught, 60 * across, 3 * along)
    force = np.column_stack([lateral, np.full(40, -8.0)])
    wrench = np.hstack([force, np.zeros((40, 3))])
    contact = Contact(wrench, wrench, force, 0.001 * along, np.zeros(40), np.zeros(40))
    assert _against_motion(contact, strict=False) == []
    turned = replace(contact, force_world=np.column_stack([across, np.full(40, -8.0)]))
    (line,) = _against_motion(turned, strict=False)
    assert line.severity == "refused"
