"""Parameter files as ROS writes and reads them; files that are never half written."""

import pytest
import yaml

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config, read_parameters, write_config


def test_numbers_are_read_as_ros_reads_them(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text("/**:\n  ros__parameters:\n    sync: {slop: 1e-4}\n    basis: {velocity_range: [-2E-1, +.2e0]}\n")
    config = read_config(file)
    assert config.sync.slop == 1e-4
    assert config.basis.velocity_range == (-0.2, 0.2)


@pytest.mark.parametrize("joint", ["y", "1e3", "on", "a: b", "it's", "x-1"])
def test_words_are_written_so_that_ros_reads_words(tmp_path, joint):
    file = tmp_path / "a.yaml"
    config = Config.from_mapping({"input.axis": "y", "input.joint": joint, "learned.fir_taps": [1e-5, 2.0]})
    write_config(file, config)
    assert read_config(file) == config
    words = [token for token in yaml.scan(file.read_text()) if getattr(token, "value", None) in ("y", joint)]
    assert words
    assert not any(token.plain for token in words)


@pytest.mark.parametrize(
    "sections",
    [
        ["/rig/friction_estimator"],
        ["friction_estimator"],
        ["/renamed"],
        ["/**", "/left/friction_estimator"],
        ["/friction_estimator", "/controller_manager"],
    ],
)
def test_the_dump_of_a_node_is_read_whatever_its_namespace(tmp_path, sections):
    file = tmp_path / "dump.yaml"
    orders = {name: 4 if name != "/controller_manager" else 1 for name in sections} | {"/**": 2}
    file.write_text("".join(f"{n}:\n  ros__parameters:\n    fir.order: {orders[n]}\n" for n in sections))
    assert read_parameters(file) == {"fir.order": 4}


def test_the_parameters_of_two_estimators_are_asked_back(tmp_path):
    file = tmp_path / "two.yaml"
    file.write_text("".join(f"/{n}/friction_estimator:\n  ros__parameters: {{fir.order: 4}}\n" for n in ("a", "b")))
    with pytest.raises(ConfigError, match="several nodes"):
        read_parameters(file)
