"""The cache of compiled code: found where it can be, never trusted where it is damaged, never a reason to fail."""

import importlib
import os
import runpy
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from friction_estimator import compiled

SOURCE = """
from friction_estimator.compiled import njit

@njit(cache=True)
def tripled(x):
    return 3 * x

assert tripled(14) == 42
assert tripled(0.5) == 1.5
hits = sum(tripled.stats.cache_hits.values())
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    path = tmp_path / "module.py"
    path.write_text(SOURCE)
    return path


def run(module):
    """Run it as a new start would; return how many of its two compiled forms were found in the cache."""
    compiled._usable_folder.cache_clear()
    compiled._digest.cache_clear()
    try:
        return runpy.run_path(str(module))["hits"]
    finally:
        compiled._usable_folder.cache_clear()


def kept(module):
    return sorted((module.parent / "__pycache__").glob("*.nbc"))


def test_what_was_compiled_is_found_again(module):
    assert run(module) == 0
    assert len(kept(module)) == 2
    assert run(module) == 2
    module.write_text(SOURCE.replace("3 * x", "2 * x + x"))
    assert run(module) == 0
    assert len(kept(module)) == 2  # overwritten


def test_an_edit_of_what_a_function_calls_is_noticed(module, tmp_path, monkeypatch):
    """By numba's own cache it is not: the function's own file has not changed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    helper = tmp_path / "helper_of_compiled.py"

    def called(factor):
        helper.write_text(
            "from friction_estimator.compiled import njit\n\n@njit(cache=True)\n"
            f"def scaled(x):\n    return {factor} * x\n"
        )
        sys.modules.pop("helper_of_compiled", None)
        importlib.invalidate_caches()
        compiled._digest.cache_clear()
        return runpy.run_path(str(module))["result"]

    module.write_text(
        "from friction_estimator.compiled import njit\nfrom helper_of_compiled import scaled\n\n"
        "@njit(cache=True)\ndef outer(x):\n    return scaled(x)\n\nresult = outer(2)\n"
    )
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert called(3) == 6
    assert called(5) == 10


READS = {
    "a constant imported by its name": "from PACKAGE.places import FACTOR as factor\n",
    "a constant of a module": "from PACKAGE import places\nfactor = None\n",
}


@pytest.mark.parametrize(("how", "expression"), list(zip(READS, ["factor", "places.FACTOR"], strict=True)))
def test_an_edit_of_a_constant_in_another_file_is_noticed(how, expression, tmp_path, monkeypatch):
    """A constant is compiled in: the places of workspace.py, say, in every loop."""
    name = f"package_{expression.replace('.', '_')}"
    package = tmp_path / name
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "loops.py").write_text(
        "from friction_estimator.compiled import njit\n" + READS[how].replace("PACKAGE", name) + "\n"
        f"@njit(cache=True)\ndef outer(x):\n    return {expression} * x\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def found(factor):
        (package / "places.py").write_text(f"FACTOR = {factor}\n")
        for module in [module for module in sys.modules if module.partition(".")[0] == name]:
            del sys.modules[module]
        importlib.invalidate_caches()
        compiled._digest.cache_clear()
        outer = importlib.import_module(f"{name}.loops").outer
        return outer(2), sum(outer.stats.cache_hits.values())

    assert found(3) == (6, 0)
    assert found(3) == (6, 1)
    assert found(5) == (10, 0)


def damages(content):
    yield b""
    yield content[: len(content) // 2]
    yield content[:-1]
    middle = len(content) // 2
    yield content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    yield os.urandom(len(content))
    yield bytes(len(content))


def test_a_damaged_file_is_compiled_anew(module):
    run(module)
    first, second = kept(module)
    good = first.read_bytes()
    for content in damages(good):
        first.write_bytes(content)
        assert run(module) == 1
        assert run(module) == 2  # written anew
    # The form of another signature, whole and with a checksum that fits.
    first.write_bytes(second.read_bytes())
    assert run(module) == 1
    first.unlink()
    first.mkdir()
    assert run(module) == 1


@pytest.fixture
def blocked(module, monkeypatch):
    """A machine where nothing can be written: neither beside the source nor in a home."""
    (module.parent / "__pycache__").write_text("no folder")
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.setenv(name, str(module))  # a file
    return module


def test_a_folder_that_the_user_names_is_the_only_one(module, tmp_path, monkeypatch):
    assert run(module) == 0
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
    assert run(module) == 0
    assert run(module) == 2
    assert len(list((tmp_path / "given").rglob("*.nbc"))) == 2


def test_the_last_resort_is_a_private_temporary_folder(blocked, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert run(blocked) == 0
    own = tmp_path / f"friction_estimator-{os.getuid()}"
    assert own.stat().st_mode & 0o777 == 0o700
    assert run(blocked) == 2


def test_without_any_folder_it_runs_and_leaves_nothing(blocked, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(blocked))
    before = set(tmp_path.iterdir())
    assert run(blocked) == run(blocked) == 0
    # What tempfile falls back to where there is no temporary folder at all is the present one.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert run(blocked) == 0
    assert set(tmp_path.iterdir()) == before


def test_a_home_without_a_place_gets_no_folder(module, tmp_path, monkeypatch):
    """As for a user that no passwd knows, whose tilde stays as it is: nothing is made where the program was started."""
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "nowhere")
    assert all(path.is_absolute() for path in compiled._candidates(tmp_path))


@pytest.mark.parametrize("prepare", ["others may write", "a link", "a file"])
def test_a_folder_that_others_may_write_to_is_not_taken(tmp_path, monkeypatch, prepare):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / f"friction_estimator-{os.getuid()}"
    if prepare == "others may write":
        folder.mkdir()
        folder.chmod(0o777)
    elif prepare == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        folder.write_text("")
    assert compiled.private_folder() is None


LIMITED = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
runpy.run_path(sys.argv[1])
"""


def test_a_full_disk_costs_the_cache_only(module):
    """A limit on the size of files stands for the disk: the write ends in the middle, with an error."""
    root = str(Path(compiled.__file__).parents[1])
    ended = subprocess.run(
        [sys.executable, "-c", LIMITED, module],
        env=os.environ | {"PYTHONPATH": root, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert not list((module.parent / "__pycache__").iterdir())


def test_what_killed_writers_left_is_swept(module):
    run(module)
    (first, _) = kept(module)
    old, new = (first.with_name(f"{first.name}.{number}.part") for number in (1, 2))
    for path in (old, new):
        path.write_bytes(b"half")
    past = time.time() - 2 * compiled.ABANDONED_S
    os.utime(old, (past, past))
    first.unlink()
    run(module)
    assert not old.exists()
    assert new.exists()


LOADED_AND_COMPILED = """
import runpy, sys
import numpy as np
from numba.core import entrypoints
from friction_estimator.compiled import njit

loaded = runpy.run_path(sys.argv[1])
print(loaded["hits"], "numba.np.npyimpl" in sys.modules, entrypoints._already_initialized)

@njit()
def anew(x):
    return np.sort(np.round(x, 1)), loaded_tripled(x.sum())

loaded_tripled = loaded["tripled"]
print(anew(np.array([0.75, 0.25, -1.5])), loaded_tripled(np.arange(2)))
"""


def test_a_form_is_loaded_without_what_compilers_need(module):
    """Which is a quarter of a start; what is compiled after it finds all that it needs."""
    run(module)
    command = [sys.executable, "-c", LOADED_AND_COMPILED, str(module)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["2 False False", "(array([-1.5,  0.2,  0.8]), -1.5) [0 3]"]


DRIVE = """
import gc, math
from numba.core.dispatcher import Dispatcher
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.settings.config import Config
from friction_estimator.ros.build import build, warm_up
from friction_estimator.ros.stream import SampleStream

def forms():
    return {d.py_func.__qualname__: len(d.overloads) for d in gc.get_objects() if isinstance(d, Dispatcher)}

warm_up()
before = forms()
for law in ("rls", "nlms", "lms"):
    config = Config.from_mapping({"model.law": law})
    stream = SampleStream(config, build, lambda *_: None)
    stream.begin(config)
    for k in range(2500):
        velocity = 0.002 * 2 ** (k / 500) * math.sin(k / 80) * (not 1000 < k < 1200)
        friction = 5 * math.tanh(velocity / 0.001) + 20 * velocity + 0.05 * math.sin(7.0 * k) + 40 * (1800 < k < 1900)
        stream.event(VELOCITY, k * 10**6, velocity)
        stream.event(FRICTION, k * 10**6, friction)
        if stream.working_off:
            stream.work_off()
    assert stream.estimator.health.grown > 1
    stream.estimator.curve()
    stream.estimator.check_state()
after = forms()
print({name: count for name, count in after.items() if before.get(name, 0) != count})
"""


def test_nothing_is_compiled_or_loaded_while_samples_come():
    """First contact, a range that grows, a standstill, a fault: each of them is compiled at the node's start."""
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", DRIVE], check=False, capture_output=True, text=True, env=env)
    assert (done.returncode, done.stdout.strip()) == (0, "{}"), done.stderr


def test_a_start_leaves_out_coverage_and_most_searches_for_garbage(tmp_path):
    """`coverage` is there to be imported, and numba, which looks for it, does without."""
    (tmp_path / "coverage.py").write_text("raise SystemExit('coverage was imported')\n")
    start = (
        "import gc, sys\n"
        "from friction_estimator.startup import START_OBJECTS, spare_the_start\n"
        "spare_the_start()\n"
        "import numba\n"
        "assert gc.get_threshold()[0] == START_OBJECTS\n"
        "assert not sys.modules['coverage']\n"
    )
    env = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", start], check=False, capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr


def printed(start):
    """Return the words that a new process prints."""
    return subprocess.run([sys.executable, "-c", start], check=True, capture_output=True, text=True).stdout.split()


def test_the_start_of_the_node_imports_what_it_uses():
    pytest.importorskip("rclpy")
    idle = ("rosbags", "scipy.linalg", "friction_estimator.effects")
    assert (
        printed(f"import friction_estimator.ros.estimator_node, sys; print(*(set({idle}) & sys.modules.keys()))") == []
    )


@pytest.mark.parametrize(
    ("imported", "inner", "use"),
    [
        ("scipy.linalg", "numpy.f2py.f2py2e", "numpy.f2py.get_include()"),
        ("scipy.linalg", "numpy.testing._private.utils", "numpy.testing.assert_allclose(1.0, 1.0)"),
        ("scipy.optimize", "scipy.fft", "scipy.linalg.interpolative.interp_decomp(numpy.ones((2, 2)), 1)"),
        ("scipy.spatial", "scipy.constants", "scipy.spatial.transform.Rotation.identity()"),
    ],
)
def test_what_nobody_uses_is_loaded_by_whoever_uses_it(imported, inner, use):
    pytest.importorskip("scipy", minversion="1.15")  # former ones import other modules
    start = (
        "from friction_estimator.startup import spare_the_start; spare_the_start(); "
        f"import sys, numpy, scipy, {imported}; before = {inner!r} in sys.modules; {use}; "
        f"print(before, {inner!r} in sys.modules)"
    )
    assert printed(start) == ["False", "True"]
