"""Logs come in: in other units, frames, signs and files, damaged, and with maps that are wrong."""

import numpy as np
import pytest
import yaml
from robot_logs import COMMAND, FORCE, PLACE, QUAT, TORQUE, map_of_table, recorded, table_of
from scipy.spatial.transform import Rotation, Slerp

import mjx_fit as mf
from mjx_fit.data.logs.importing import import_log
from mjx_fit.data.logs.log_map import read_map
from mjx_fit.data.logs.raw_log import RawLog, Stream
from mjx_fit.data.logs.signals import signals_of

CONFIG = mf.Config()


@pytest.fixture(scope="module")
def own(attempts):
    return recorded(attempts, noise_n=0.02)


@pytest.fixture(scope="module")
def clean(own, tmp_path_factory):
    path = tmp_path_factory.mktemp("clean")
    return imported(path, table_of(own))


def imported(folder, rows, said=None):
    rows.to_csv(folder / "log.csv", index=False)
    (folder / "map.yaml").write_text(yaml.safe_dump(said or map_of_table()))
    return import_log(folder / "log.csv", read_map(folder / "map.yaml"), CONFIG)


def compare(got, want, wrench=1e-3, place=1e-6):
    assert len(got.attempts) == len(want)
    for one, other in zip(got.attempts, want, strict=True):
        assert one.felt.length == other.length
        np.testing.assert_allclose(
            one.felt.trace.wrench_sensor, other.trace.wrench_sensor[: other.length], atol=wrench
        )
        for name in ("tip_pos_world", "tip_quat_world", "action_world"):
            new, old = (np.asarray(getattr(each.trace, name))[: other.length] for each in (one.felt, other))
            np.testing.assert_allclose(new, old, atol=place)


def test_a_clean_log_is_what_was_felt(attempts, tmp_path):
    got = imported(tmp_path, table_of(recorded(attempts, noise_n=1e-6)))
    compare(got, attempts, wrench=1e-4)
    assert [str(finding) for finding in got.findings] == []
    for one, felt in zip(got.attempts, attempts, strict=True):
        np.testing.assert_allclose(one.felt.tare_sensor, felt.tare_sensor, atol=0.01)
        np.testing.assert_allclose(one.felt.estimate_world, felt.start.pos_world[:2], atol=1e-5)


def in_millimetres(rows, said):
    rows[PLACE] *= 1000
    said["pose"]["length"] = "mm"


def as_a_driver_publishes(rows, said):
    rows[FORCE + TORQUE] *= -1
    said["wrench"]["acts_on"] = "arm"


def with_a_turned_sensor(rows, said):
    turn = Rotation.from_euler("xyz", [10, -5, 30], degrees=True)  # of the sensor's axes in the tool's
    turned(rows, turn.inv())
    said["wrench"]["sensor_in_tool"]["rpy_deg"] = [10, -5, 30]


def with_a_sensor_further_up(rows, said):
    up = np.array([0.01, -0.02, -0.05])  # from the library's sensor
    rows[TORQUE] -= np.cross(up, rows[FORCE].to_numpy())
    said["wrench"]["sensor_in_tool"]["position_m"] = [0.01, -0.02, -0.12]


def in_other_units(rows, said):
    rows[TORQUE] *= 1000
    rows["time"] *= 1e6
    said["wrench"]["torque"] = "N mm"
    said["time"] = {"unit": "us"}


def as_rotation_vectors(rows, said):
    there = rows["qw"].notna()
    turns = Rotation.from_quat(rows.loc[there, QUAT].to_numpy(), scalar_first=True)
    rows.loc[there, ["a", "b", "c"]] = turns.as_rotvec(degrees=True)
    said["pose"] |= {"source": [*PLACE, "a", "b", "c"], "rotation": "rotvec", "angle": "deg"}


def of_the_flange_in_a_turned_base(rows, said):
    there, moved = rows["qw"].notna(), rows["dx"].notna()
    turns = Rotation.from_quat(rows.loc[there, QUAT].to_numpy(), scalar_first=True)
    base, hand = (Rotation.from_euler("z", angle, degrees=True) for angle in (90, 45))
    # World = base · flange · hand; the flange is 0.2 m above the TCP.
    flange = turns * hand.inv()
    place = rows.loc[there, PLACE].to_numpy() - flange.apply([0, 0, 0.2]) - [0.1, 0, 0.4]
    rows.loc[there, PLACE] = base.inv().apply(place)
    rows.loc[there, QUAT] = (base.inv() * flange).as_quat(scalar_first=True)
    rows.loc[moved, COMMAND] = base.inv().apply(np.array(rows.loc[moved, COMMAND]))
    said["pose"] |= {
        "tool_in_pose": {"position_m": [0, 0, 0.2], "rpy_deg": [0, 0, 45]},
        "base_in_world": {"position_m": [0.1, 0, 0.4], "rpy_deg": [0, 0, 90]},
    }


def in_the_axes_of_the_base(rows, said):
    there, felt = rows["qw"].notna(), rows["fx"].notna()
    times = rows.loc[there, "time"].to_numpy()
    tool = Slerp(times, Rotation.from_quat(rows.loc[there, QUAT].to_numpy(), scalar_first=True))
    turned(rows, tool(np.clip(rows.loc[felt, "time"], times[0], times[-1])))
    said["wrench"]["axes"] = "base"


def with_targets(rows, said):
    there, moved = rows["qw"].notna(), rows["dx"].notna()
    for name, step in zip(PLACE, COMMAND, strict=True):
        at = np.interp(rows.loc[moved, "time"], rows.loc[there, "time"], rows.loc[there, name])
        rows.loc[moved, step] += at
    said["command"]["kind"] = "target"


def turned(rows, turn):
    felt = rows["fx"].notna()
    for names in (FORCE, TORQUE):
        rows.loc[felt, names] = turn.apply(np.array(rows.loc[felt, names]))


@pytest.mark.parametrize(
    "change",
    [
        in_millimetres,
        as_a_driver_publishes,
        with_a_turned_sensor,
        with_a_sensor_further_up,
        in_other_units,
        as_rotation_vectors,
        of_the_flange_in_a_turned_base,
        in_the_axes_of_the_base,
        with_targets,
    ],
)
def test_other_units_frames_and_signs_give_the_same(change, own, clean, tmp_path):
    rows, said = table_of(own), map_of_table()
    change(rows, said)
    compare(imported(tmp_path, rows, said), [one.felt for one in clean.attempts], 1e-3, 1e-5)


def test_without_commands_an_attempt_is_the_motion_from_rest_to_the_end_of_contact(attempts, tmp_path):
    own = recorded(attempts, noise_n=0.02)
    rows, said = table_of(own), map_of_table()
    del said["command"]
    got = imported(tmp_path, rows, said)
    assert len(got.attempts) == len(attempts)
    for one, (begin, end), felt in zip(got.attempts, own.attempts, attempts, strict=True):
        assert abs(one.begin_s - begin) < 0.06
        assert abs(one.end_s - end) < 0.11
        n = min(int(one.felt.length), int(felt.length))
        moved = np.diff(felt.trace.tip_pos_world[:n], axis=0)
        same = np.abs(one.felt.trace.action_world[1:n] - moved)
        assert np.median(same) < 0.001


def test_a_sensor_elsewhere_than_the_map_says_is_refused(own, tmp_path):
    rows, said = table_of(own), map_of_table()
    said["wrench"]["sensor_in_tool"]["position_m"] = [0, 0, 0]
    got = imported(tmp_path, rows, said)
    assert got.refused
    assert any("as with a lever of" in str(one) for one in got.findings)


def test_the_weight_of_a_load_is_taken_out_as_the_tool_turns(tmp_path):
    """A tool in free space, in many orientations: the wrench is the weight of the load, and a bias."""
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(30, 3)))
    centre, mount = np.array([0.01, -0.02, 0.03]), Rotation.from_euler("z", 40, degrees=True)
    up = (turns * mount).inv().apply([0.0, 0.0, 1.5 * 9.81])  # what holds 1.5 kg, in the sensor's axes
    bias = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    wrench = np.hstack([up, np.cross(centre, up)]) + bias
    time = np.arange(30.0)
    pose = np.hstack([np.tile([0.5, 0.0, 0.3], (30, 1)), turns.as_quat()])
    raw = RawLog("x", {"wrench": Stream(time, wrench), "pose": Stream(time, pose)}, quaternions_xyzw=True)
    said = map_of_table()
    said["wrench"]["sensor_in_tool"]["rpy_deg"] = [0, 0, 40]
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(said))
    heavy = signals_of(raw, read_map(tmp_path / "map.yaml"), CONFIG).wrench_sensor
    assert heavy.std(0).max() > 5
    said["load"] = {"mass_kg": 1.5, "centre_m": centre.tolist()}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(said))
    light = signals_of(raw, read_map(tmp_path / "map.yaml"), CONFIG).wrench_sensor
    want = np.concatenate([mount.apply(bias[:3]), mount.apply(bias[3:])])
    np.testing.assert_allclose(light, np.tile(want, (30, 1)), atol=1e-9)


def test_a_column_of_labels_cuts_and_needs_one(attempts, own, clean, tmp_path):
    rows, said = table_of(own), map_of_table()
    said["attempts"] = {"by": "column", "source": "trial", "peg": "cross"}
    rows["trial"] = None
    with_none = imported(tmp_path, rows, said)
    assert with_none.refused
    assert "no sample has a label" in str(with_none.findings[-1])
    for name, (begin, end) in zip("abc", own.attempts, strict=True):
        rows.loc[rows["time"].between(begin - 0.5, end), "trial"] = name
    got = imported(tmp_path, rows, said)
    assert [one.label for one in got.attempts] == ["a", "b", "c"]
    compare(got, [one.felt for one in clean.attempts], 1e-3, 1e-5)


def test_a_tare_of_a_given_time_changes_nothing_else(own, clean, tmp_path):
    """Clocks are judged by where contact begins, wherever the tare is taken."""
    said = map_of_table()
    said["attempts"]["tare_s"] = 0.5
    got = imported(tmp_path, table_of(own), said)
    assert not got.findings
    assert len(got.attempts) == 3
    compare(got, [one.felt for one in clean.attempts])


def test_attempts_keep_their_numbers_where_some_are_left_out(own, tmp_path, capsys):
    """The middle one is far away: the error says what to check, and the last one is still number 2."""
    rows = table_of(own)
    begin, end = own.attempts[1]
    rows.loc[rows["time"].between(begin - 0.5, end), "x"] += 0.6
    got = imported(tmp_path, rows)
    assert [one.name for one in got.attempts] == ["0", "2"]
    (finding,) = [str(one) for one in got.findings if "attempt 1" in str(one)]
    assert "outside the workspace" in finding
    assert finding.endswith("check pose.base_in_world and pose.tool_in_pose")
