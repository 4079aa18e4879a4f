"""Launch files: compiled everywhere, built where launch_ros is installed."""

import importlib.util
import py_compile

import pytest
from ros_graph import ROOT

FILES = sorted((ROOT / "launch").glob("*.launch.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_compiles(path, tmp_path):
    py_compile.compile(str(path), cfile=str(tmp_path / "compiled"), doraise=True)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_describes_a_launch(path):
    pytest.importorskip("launch_ros")
    spec = importlib.util.spec_from_file_location("launched", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.generate_launch_description().entities


def test_there_are_launch_files():
    assert {path.name for path in FILES} == {"estimator.launch.py", "two_shafts.launch.py"}
