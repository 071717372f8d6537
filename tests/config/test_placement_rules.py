"""Rules of the section ``placement``."""

import pytest

from mjx_fit.config.files import read_config
from mjx_fit.utils.errors import RequestError


@pytest.mark.parametrize(
    "keys",
    [
        ["placement.socket_z_m=0.002"],
        ["placement.socket_z_m=0.0015", "placement.grasp_z_m=0.0005"],
        ["randomize.socket_z_m={uniform: [-0.005, 0.005]}", "scene.start_height_m=0.005"],
    ],
)
def test_no_peg_may_begin_in_its_socket(keys):
    with pytest.raises(
        RequestError, match=r"^config: scene\.start_height_m: .* expected more than 0\.00[25]"
    ):
        read_config(None, keys)


def test_a_start_above_the_highest_socket_is_taken():
    keys = ["randomize.socket_z_m={uniform: [-0.005, 0.005]}", "scene.start_height_m=0.006"]
    assert read_config(None, keys).scene.start_height_m == 0.006
