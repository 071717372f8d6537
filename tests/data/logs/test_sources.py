"""The same log as a table, arrays and bags; and files that are damaged or lack a signal."""

import jax
import numpy as np
import pytest
import yaml
from robot_logs import COMMAND, FORCE, PLACE, QUAT, TORQUE, map_of_table, recorded, table_of
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from test_importing import CONFIG, compare, imported

from mjx_fit.control.kinematics import chain_of, inverse
from mjx_fit.data.logs.importing import import_log
from mjx_fit.data.logs.log_map import read_map
from mjx_fit.data.logs.sources import read_raw
from mjx_fit.scene.build import simulation_scene
from mjx_fit.utils.errors import RequestError

DATE_NS = 17 * 10**17
STORE = get_typestore(Stores.ROS2_HUMBLE)
TOPICS = {"wrench": "/ft", "pose": "/tcp", "command": "/step", "attempts": "/attempt"}


@pytest.fixture(scope="module")
def own(attempts):
    return recorded(attempts, noise_n=0.02)


@pytest.fixture(scope="module")
def felt(own, tmp_path_factory):
    return [one.felt for one in imported(tmp_path_factory.mktemp("clean"), table_of(own)).attempts]


def written(folder, said):
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(said))
    return read_map(path)


def bag_map():
    said = map_of_table()
    for name in ("wrench", "pose", "command"):
        said[name]["source"] = TOPICS[name]
    return said


def angles_of(own):
    """Return the angles of the joints at each pose, rad, by inverse kinematics."""
    scene = simulation_scene(CONFIG.scene)
    chain = chain_of(scene.models[0], scene.robot)
    down = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)
    turns = (Rotation.from_quat(own.pose[:, 4:], scalar_first=True) * down.inv()).as_rotvec()
    solve = jax.jit(jax.vmap(lambda place, turn: inverse(chain, place, turn_world=turn)))
    return np.asarray(solve(own.pose[:, 1:4], turns), float)


def write_bag(path, own, plugin, *, transforms=False, angles=None):
    """Write a bag as a robot's driver does; attempts are numbered when they begin."""
    types = {name: STORE.types[name] for name in STORE.types}
    stamp = types["builtin_interfaces/msg/Time"]
    header, vector, turn = (
        types[name]
        for name in ("std_msgs/msg/Header", "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion")
    )

    def head(time):
        ns = DATE_NS + round(time * 1e9)
        return header(stamp(ns // 10**9, ns % 10**9), "base")

    def wrench(row):
        force = types["geometry_msgs/msg/Wrench"](vector(*row[1:4]), vector(*row[4:7]))
        return types["geometry_msgs/msg/WrenchStamped"](head(row[0]), force)

    def pose(row):
        at = turn(*row[[5, 6, 7, 4]])
        if transforms:
            moved = types["geometry_msgs/msg/Transform"](vector(*row[1:4]), at)
            one = types["geometry_msgs/msg/TransformStamped"](head(row[0]), "tool", moved)
            other = types["geometry_msgs/msg/TransformStamped"](head(row[0]), "camera", moved)
            return types["tf2_msgs/msg/TFMessage"]([other, one])
        place = types["geometry_msgs/msg/Point"](*row[1:4])
        return types["geometry_msgs/msg/PoseStamped"](
            head(row[0]), types["geometry_msgs/msg/Pose"](place, at)
        )

    def joints(row):
        names = [*(f"joint{i}" for i in range(7, 0, -1)), "finger"]
        values = np.array([*row[:0:-1], 0.04])
        return types["sensor_msgs/msg/JointState"](head(row[0]), names, values, np.zeros(8), np.zeros(8))

    def gripper(row):
        """Another publisher on the topic."""
        return types["sensor_msgs/msg/JointState"](head(row[0]), ["f1", "f2"], *[np.full(2, 0.04)] * 3)

    def step(row):
        return types["geometry_msgs/msg/Vector3Stamped"](head(row[0]), vector(*row[1:]))

    poses = (own.pose, pose, "tf2_msgs/msg/TFMessage" if transforms else "geometry_msgs/msg/PoseStamped")
    if angles is not None:
        poses = (np.column_stack([own.pose[:, 0], angles]), joints, "sensor_msgs/msg/JointState")
    numbers = np.array([(begin, i) for i, (begin, _) in enumerate(own.attempts)])
    said = {
        "wrench": (own.wrench, wrench, "geometry_msgs/msg/WrenchStamped"),
        "pose": poses,
        "command": (own.command, step, "geometry_msgs/msg/Vector3Stamped"),
        "attempts": (numbers, lambda row: types["std_msgs/msg/Int32"](int(row[1])), "std_msgs/msg/Int32"),
    }
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        for name, (rows, message, kind) in said.items():
            connection = bag.add_connection(TOPICS[name], kind, typestore=STORE)
            for row in rows:
                for one in (message, gripper) if message is joints else (message,):
                    bag.write(connection, DATE_NS + round(row[0] * 1e9), STORE.serialize_cdr(one(row), kind))


@pytest.mark.parametrize("kind", ["npz", "parquet"])
def test_files_of_numbers_hold_the_same(kind, own, felt, tmp_path):
    said = map_of_table()
    path = tmp_path / f"log.{kind}"
    if kind == "npz":
        said |= {"wrench": said["wrench"] | {"source": "ft"}, "pose": said["pose"] | {"source": "tcp"}}
        steps = dict(zip(COMMAND, own.command[:, 1:].T, strict=True))
        times = {"wrench_time": own.wrench[:, 0], "pose_time": own.pose[:, 0], "time": own.command[:, 0]}
        np.savez(path, ft=own.wrench[:, 1:], tcp=own.pose[:, 1:], **times, **steps)
    else:
        table_of(own).to_parquet(path)
    compare(import_log(path, written(tmp_path, said), CONFIG), felt, 1e-4, 1e-6)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_bags_hold_the_same(plugin, own, felt, tmp_path):
    write_bag(tmp_path / "bag", own, plugin)
    got = import_log(tmp_path / "bag", written(tmp_path, bag_map()), CONFIG)
    compare(got, felt, 1e-4, 1e-6)
    # One file of it, as it is passed around.
    (file,) = [one for one in (tmp_path / "bag").iterdir() if one.suffix in (".mcap", ".db3")]
    if plugin is StoragePlugin.MCAP:
        compare(import_log(file, written(tmp_path, bag_map()), CONFIG), felt, 1e-4, 1e-6)


def test_poses_come_from_transforms_and_attempts_from_numbers(own, felt, tmp_path):
    write_bag(tmp_path / "bag", own, StoragePlugin.MCAP, transforms=True)
    said = bag_map()
    said["pose"]["frame"] = "tool"
    said["attempts"] = {"by": "column", "source": "/attempt", "peg": "cross"}
    got = import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)
    assert [one.label for one in got.attempts] == ["0", "1", "2"]
    compare(got, felt, 1e-4, 1e-6)
    said["pose"]["frame"] = "hand"
    with pytest.raises(RequestError, match="/tcp has no message about hand"):
        import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)
    said["pose"]["source"] = "/ft"
    with pytest.raises(RequestError, match=r"/ft: geometry_msgs/msg/WrenchStamped is invalid: expected geom"):
        import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)
    said["pose"]["source"] = "/pose"
    with pytest.raises(
        RequestError, match=r"the topic '/pose' is missing: it has /attempt, /ft, /step, /tcp"
    ):
        import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)


def test_poses_come_from_the_angles_of_joints_by_name(own, felt, tmp_path):
    """The message has them from the hand to the base, and a finger; a table has them in order, in degrees."""
    angles = angles_of(own)
    write_bag(tmp_path / "bag", own, StoragePlugin.MCAP, angles=angles)
    said = bag_map()
    said["pose"] |= {"rotation": "joints", "joints": [f"joint{i}" for i in range(1, 8)]}
    compare(import_log(tmp_path / "bag", written(tmp_path, said), CONFIG), felt, 1e-3, 1e-4)
    said["pose"]["joints"][2] = "panda_joint3"
    with pytest.raises(RequestError, match=r"pose\.joints: 'panda_joint3' is not among joint7, joint6"):
        import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)
    del said["pose"]["joints"]
    with pytest.raises(RequestError, match=r"/tcp: its messages have different numbers .*name the joints"):
        import_log(tmp_path / "bag", written(tmp_path, said), CONFIG)
    with pytest.raises(RequestError, match=r"pose\.rotation: quat_wxyz cannot be used with sensor_msgs"):
        import_log(tmp_path / "bag", written(tmp_path, bag_map()), CONFIG)

    rows, said = table_of(own), map_of_table()
    names = [f"q{i}" for i in range(7)]
    rows.loc[rows["qw"].notna(), names] = np.rad2deg(angles)
    rows.drop(columns=["x", "y", "z", "qw", "qx", "qy", "qz"]).to_parquet(tmp_path / "log.parquet")
    said["pose"] = {"source": names, "rotation": "joints", "angle": "deg"}
    compare(import_log(tmp_path / "log.parquet", written(tmp_path, said), CONFIG), felt, 1e-3, 1e-4)
    said["pose"]["source"] = names[:6]
    with pytest.raises(RequestError, match="pose: 6 values are invalid: expected 7"):
        import_log(tmp_path / "log.parquet", written(tmp_path, said), CONFIG)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_a_truncated_bag_is_refused_or_holds_the_first_attempts(share, own, felt, tmp_path):
    write_bag(tmp_path / "bag", own, StoragePlugin.MCAP)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RequestError) as error:
        import_log(tmp_path / "bag", written(tmp_path, bag_map()), CONFIG)
    assert "\n" not in str(error.value)


def test_a_missing_or_foreign_file_is_refused(own, tmp_path):
    said = written(tmp_path, map_of_table())
    for name, content, message in (
        ("none.csv", None, "does not exist"),
        ("log.txt", b"", "'.txt' is invalid: expected .csv"),
        ("log.csv", b"", "cannot be read"),
        ("log.csv", b"time,fx\n1,2\n", "the column 'dx' is missing: it has"),
        ("log.parquet", b"PAR1", "cannot be read"),
        ("log.npz", b"PK\3\4", "cannot be read"),
        ("log.mcap", b"\x89MCAP0\r\n", "log.mcap"),
        ("log.bag", b"#ROSBAG", "log.bag"),
    ):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(RequestError, match=message) as error:
            read_raw(path, said)
        assert "\n" not in str(error.value)
    (tmp_path / "folder").mkdir()
    with pytest.raises(RequestError, match="folder"):
        read_raw(tmp_path / "folder", said)
    rows = table_of(own).astype(object)
    rows.loc[5, "fx"] = "three"
    rows.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(RequestError, match=r"'three' in row 6 of 'fx' is invalid: expected a number"):
        read_raw(tmp_path / "log.csv", said)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda said: said["attempts"].pop("peg"), r"attempts.peg: it is missing: expected one of cross"),
        (lambda said: said["attempts"].update(peg="crass"), r"attempts.peg: 'crass' is invalid"),
        (lambda said: said["wrench"].pop("acts_on"), r"wrench.acts_on: it is missing"),
        (lambda said: said["attempts"].update(by="column"), r"attempts.source: it is needed with by: column"),
        (lambda said: said["pose"].update(source=PLACE), r"pose: 3 values are invalid: expected 7"),
        (lambda said: said["pose"].update(source="/tcp"), r"pose.source: '/tcp' is invalid: expected a list"),
        (lambda said: said["pose"].update(source=[*PLACE, *PLACE, "x"]), r"pose: a quaternion of norm"),
        (lambda said: said["wrench"].update(units="N"), r"wrench.units: unknown key; allowed here: source"),
    ],
)
def test_a_map_that_does_not_suit_is_refused(change, message, own, tmp_path):
    said = map_of_table()
    change(said)
    with pytest.raises(RequestError, match=message):
        imported(tmp_path, table_of(own), said)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wrench: [1", "map: .* cannot be read: line 1"),
        ("- 1", "map: .*: a list is invalid: expected sections such as 'wrench:'"),
        ("wrench: {a: 1}", "wrench.a: unknown key"),
        (None, "map: .* cannot be read: No such file"),
    ],
)
def test_a_file_that_is_no_map_is_refused(text, message, tmp_path):
    if text is not None:
        (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(RequestError, match=message):
        read_map(tmp_path / "map.yaml")


def test_columns_are_those_of_the_map():
    assert map_of_table()["wrench"]["source"] == [*FORCE, *TORQUE]
    assert map_of_table()["pose"]["source"] == [*PLACE, *QUAT]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"joints": ["a", "b"]}, "joints: it has no effect without rotation: joints"),
        ({"rotation": "joints", "length": "mm"}, "rotation: joints cannot be used with length or frame"),
        ({"rotation": "joints", "joints": ["a"]}, "joints: it cannot be used with columns"),
    ],
)
def test_keys_of_poses_without_effect_are_refused(change, expected, tmp_path):
    said = map_of_table()
    said["pose"] |= change
    with pytest.raises(RequestError, match=expected):
        written(tmp_path, said)
