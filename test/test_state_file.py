"""The state file: nothing foreign is read, renamed or replaced; nothing unsound is taken; two nodes do not share it."""

import json
import logging
import os
import random
import shutil
import socket
import subprocess
import sys
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from synthetic import samples_of

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, InputError
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import StateConfig
from friction_estimator.output.staging import Staging
from friction_estimator.ros.state import Standing, dumps, loads, read_state, set_aside, standing, write_state
from friction_estimator.ros.state_keeper import FAILURE, StateKeeper

VERSION_3 = Path(__file__).parent / "data" / "state_version_3.json"
"""Written by the program as it was before states were judged by more than their checksum."""

CONFIG = Config.from_mapping(
    {
        "theory.kind": "seal",
        "basis.velocity_range": [-0.1, 0.1],
        "force_unit": 5.0,
        "fir.order": 2,
        "basis.finest_level": 1,
    }
)


def learned():
    estimator = Estimator(CONFIG)
    estimator.restore(read_state(VERSION_3))
    return estimator


def resealed(document, change):
    """Return a state file whose content was changed, under a checksum that fits."""
    import hashlib

    content = json.loads(document["content"])
    content = change(content) or content
    text = json.dumps(content)
    sealed = {"format": document["format"], "sha256": hashlib.sha256(text.encode()).hexdigest(), "content": text}
    return json.dumps(sealed).encode()


def test_a_state_of_version_3_loads_bit_for_bit():
    estimator = learned()
    assert estimator.health.samples == 1500
    assert estimator.health.learned > 1400
    arrays = read_state(VERSION_3)["arrays"]
    now = estimator.state()["arrays"]
    assert set(now) - set(arrays) == {"kept", "kept_root", "trial", "hold", "noise", "residual"}
    assert set(arrays) <= set(now)
    now["rest"] = now["rest"][: arrays["rest"].size]  # it knew nothing of the position
    for name in set(arrays) - {"moments"}:
        np.testing.assert_array_equal(now[name], arrays[name], err_msg=name)
    assert now["moments"][at.ERROR_POWER] == arrays["moments"][0]
    np.testing.assert_array_equal(now["moments"][at.BACKOFF :], arrays["moments"][6:])


def test_a_state_loads_bit_for_bit():
    written = dumps(learned().state())
    estimator = Estimator(CONFIG)
    estimator.restore(loads(written, "state.json"))
    assert dumps(estimator.state()) == written


def test_flipped_bits_and_cut_files_are_refused_in_one_line():
    good = VERSION_3.read_bytes()
    rng = random.Random(12)
    for _ in range(200):
        place = rng.randrange(len(good))
        flipped = bytearray(good)
        flipped[place] ^= 1 << rng.randrange(8)
        for data in (bytes(flipped), good[: rng.randrange(len(good))]):
            with pytest.raises(InputError) as caught:
                loads(data, "state.json")
            assert str(caught.value).startswith("state.json")
            assert str(caught.value).isprintable()
            assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("words", "content"),
    [
        ("no state file", b"[" * 100_000),
        ("no state file", b'{"a": 1}'),
        ("no state file", b"\x00" * 300),
        ("nested deeper", b'{"format": "friction_estimator/state/1", "a": ' + b"[" * 5000 + b"]" * 5000 + b"}"),
        ("nested deeper", b'{"format": "friction_estimator/state/1", "a": ' + b"[" * 15000 + b"]" * 15000 + b"}"),
        ("more than 20000 values", b'{"format": "friction_estimator/state/1", "a": [' + b"1," * 10**6 + b"1]}"),
        ("cut short", b'{"format": "friction_estimator/state/1"'),
        ("lacks sha256", b'{"format": "friction_estimator/state/1"}'),
        ("sha256 is 1, expected text", b'{"format": "friction_estimator/state/1", "sha256": 1, "content": ""}'),
        ("half a surrogate", b'{"format": "friction_estimator/state/1", "sha256": "x", "content": "\\ud800"}'),
        ("format friction_estimator/state/9", b'{"format": "friction_estimator/state/9", "sha256": "", "content": ""}'),
        ("checksum", b'{"format": "friction_estimator/state/1", "sha256": "x", "content": "{}"}'),
    ],
)
def test_what_is_no_state_is_refused_in_one_line(tmp_path, words, content):
    file = tmp_path / "state.json"
    file.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_state(file)
    assert str(file) in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500


def test_the_collected_states_are_refused(shared_hostile):
    for name in ("deep", "surr", "nostruct", "noarrays"):
        with pytest.raises(InputError):
            learned().restore(read_state(shared_hostile / f"{name}.json"))


def entry(*path):
    """Return what sets an entry of the content's estimator to a value, or removes it."""

    def changed(value):
        def change(content):
            place = content["estimator"]
            for step in path[:-1]:
                place = place[step]
            if value is None:
                del place[path[-1]]
            else:
                place[path[-1]] = value

        return change

    return changed


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("it is a list", lambda content: [1]),
        ("lacks estimator", lambda content: {"a": 1}),
        ("estimator is 3", lambda content: {"estimator": 3}),
        ("estimator lacks version", entry("version")(None)),
        ("estimator.version is 'x'", entry("version")("x")),
        ("version 2", entry("version")(2)),
        ("which range and units", entry("structure")(None)),
        ("estimator.structure is an empty list", entry("structure")([])),
        ("which range and units", entry("chosen")(None)),
        ("holds no arrays", entry("arrays")(None)),
        ("estimator.arrays is an empty list", entry("arrays")([])),
        ("fir.order", entry("structure", "fir.order")("\x1b[31m" + "x" * 9000)),
        ("learned with", entry("structure", "model.law")(None)),
        ("estimator.structure.fir.order is a section", entry("structure", "fir.order")({"a": 1})),
        ("velocity_range.* out of range", entry("chosen", "learned.velocity_range")([-1e300, 1e300])),
        ("velocity_range.*lowest first", entry("chosen", "learned.velocity_range")([1.0])),
        ("force_unit", entry("chosen", "learned.force_unit")("much")),
        ("estimator.arrays.theta is 3", entry("arrays", "theta")(3)),
        ("estimator.arrays.theta lacks shape", entry("arrays", "theta")({"array": "", "type": "float64"})),
        ("lacks the array theta", entry("arrays", "theta")(None)),
        ("type is 'object'", entry("arrays", "theta", "type")("object")),
        ("damaged", entry("arrays", "theta", "type")("int8")),
        ("damaged", entry("arrays", "theta", "array")("!!!!")),
        ("damaged", entry("arrays", "theta", "array")("AAAA")),
        (r"shape\[0\] is -1", entry("arrays", "theta", "shape")([-1])),
        (r"shape\[0\] is 42.0", entry("arrays", "theta", "shape")([42.0])),
        (r"shape\[0\] is 1000000000000", entry("arrays", "theta", "shape")([10**12])),
        ("theta is float64", entry("arrays", "theta", "shape")([6, 7])),
    ],
)
def test_a_state_of_wrong_types_or_shapes_is_refused_under_a_valid_checksum(words, change):
    document = json.loads(VERSION_3.read_bytes())
    estimator = Estimator(CONFIG)
    before = dumps(estimator.state())
    with pytest.raises(InputError, match=words) as caught:
        estimator.restore(loads(resealed(document, change), "state.json"))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 700
    assert dumps(estimator.state()) == before


UNSOUND = {
    "theta": [(0, (1e308, -1e308, 1.1e6, np.nan, np.inf))],
    "owed": [(0, (1e308,))],
    "ring": [((0, 0), (1e308, 1e9))],
    "ring_theory": [(0, (1e308, -1e20))],
    "root": [((0, 0), (1e308, 1e6, np.nan)), (..., (0.0,)), (3, (0.0, 1e5))],
    "moments": [
        (at.ERROR_POWER, (-1.0, 0.0, 1e300)), (at.MISFIT_POWER, (-1.0,)), (at.TOLERANCE, (0.0, -1.0)),
        (at.BACKOFF, (0.0, 2.0)), (at.ABSORBED, (-1.0,)), (at.OWED, (-0.1, 1.1)), (at.LAST_ERROR, (1e200,)),
    ],
    "status": [
        (at.SEEN, (-1, 2**62)), (at.LEARNED, (-1,)), (at.HEAD, (-2, -(2**63))), (at.MAY_GROW, (2, -1)),
        (at.FOLLOWS, (7,)), (at.UNPULLED, (-1,)), (at.BEYOND, (-(2**63),)),
    ],
    "errors": [((0, 0), (-1.0, 1e300)), ((0, 1), (-1.0, 1e300)), ((0, 2), (1e300,))],
    "residual": [(0, (-1.0, np.nan, np.inf))],
    "rest": [(0, (1e300, np.nan)), (2, (-1.0,))],
    "kept": [((0, 0), (1e300, np.nan, 0.5))],
    "trial": [((0, 0), (-1.0, np.nan))],
    "hold": [(at.HOLDING, (0.5, -1.0, 2.0)), (at.SUM, (-1.0,)), (at.SIDE, (3.0,)), (at.HAS_FORMER, (0.5,))],
}  # fmt: skip


@pytest.mark.parametrize("name", UNSOUND)
def test_an_unsound_array_is_refused_and_not_saved(name):
    estimator = learned()
    before = dumps(estimator.state())
    for place, values in UNSOUND[name]:
        for value in values:
            state = estimator.state()
            state["arrays"][name][place] = value
            with pytest.raises(ConfigError, match=f"state array {name}"):
                estimator.restore(state)
            spoiled = learned()
            getattr(spoiled.work, name)[place] = value
            with pytest.raises(ConfigError, match=f"state array {name}"):
                spoiled.check_state()
    assert dumps(estimator.state()) == before


def test_each_array_of_a_state_is_tried_above():
    # kept_root is used while a model is held only, noise beside a load: test_recovery.py and test_load.py try them.
    assert {*UNSOUND, "kept_root", "noise"} == {item.name for item in fields(Workspace)} - set(at.CONSTANTS)


@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
def test_the_state_of_an_estimator_is_sound(law):
    estimator = Estimator(CONFIG.updated({"model.law": law}))
    rng = np.random.default_rng(3)
    for stamp in range(1, 400):
        estimator.check_state()
        estimator.step(stamp * 10**6, 0.2 * rng.standard_normal(), 10.0 ** rng.uniform(-3, 12))
    estimator.check_state()


# --- what stands under the name ------------------------------------------------------------------------------------


def foreign(folder):
    """Yield paths that name something else than a state file, and what a message says of each."""
    (folder / "folder").mkdir()
    (folder / "folder" / "kept").write_text("kept")
    os.mkfifo(folder / "pipe")
    (folder / "notes.txt").write_text("format: mine")
    (folder / "settings.json").write_text('{"format": "mine"}')
    (folder / "link").symlink_to("notes.txt")
    yield folder / "folder", "a folder"
    yield folder / "pipe", "a named pipe"
    yield Path("/dev/zero"), "a device"
    yield Path("/dev/null"), "a device"
    yield folder / "notes.txt", "is no state file"
    yield folder / "settings.json", "is no state file"
    yield folder / "link", "is no state file"


def snapshot(folder):
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


class Lines(logging.Handler):
    """Keeps what a logger is told."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        self.lines.append(record.getMessage())


def keeper_of(path, period=0.0):
    logger = logging.Logger("node")
    heard = Lines()
    logger.addHandler(heard)
    keeper = StateKeeper(logger)
    keeper.configure(StateConfig(file=str(path), period=period))
    return keeper, heard.lines


def test_what_is_saved_while_samples_come_is_of_one_moment(tmp_path):
    """The compiled loop lets threads run in the middle of a sample; what they save is what was when it was time to."""
    path = tmp_path / "state.json"
    keeper, _ = keeper_of(path, period=1e-9)
    units = {"theory.kind": "seal", "basis.velocity_range": [-0.1, 0.1], "force_unit": 5.0}
    estimator = Estimator(Config.from_mapping(units))
    velocity = 0.09 * np.sin(0.3 * np.arange(300))
    samples = samples_of(velocity, 4.0 * np.sign(velocity))
    states: dict[int, bytes] = {}
    found = set()
    while len(found) < 10:
        estimator.run(samples)
        states[estimator.health.samples] = dumps(estimator.state())
        keeper.tick(estimator)
        if path.exists():
            data = path.read_bytes()
            moment = int(loads(data, "saved")["arrays"]["status"][at.SEEN])
            assert data == states[moment]
            found.add(moment)
    keeper.close(estimator)
    assert path.read_bytes() == states[estimator.health.samples]


def test_what_is_foreign_is_neither_read_nor_renamed_nor_replaced(tmp_path):
    estimator = learned()
    for path, words in foreign(tmp_path):
        before = snapshot(tmp_path)
        with pytest.raises(InputError, match=words):
            standing(path)
        with pytest.raises(InputError, match=words):
            set_aside(path)
        keeper, lines = keeper_of(path)
        assert not keeper.start()
        assert words in keeper.report()[FAILURE]
        assert "starting cold and not saving" in lines[-1]
        for act in (lambda k=keeper: k.save(estimator), lambda k=keeper: k.load(lambda state: estimator)):
            with pytest.raises(InputError, match=words) as caught:
                act()
            assert str(path) in str(caught.value)
        keeper.close(estimator)
        assert words in lines[-1]
        assert snapshot(tmp_path) == before
    assert not Path("/dev/.null.friction_estimator").exists()


def test_saving_begins_when_what_was_foreign_is_gone(tmp_path):
    path = tmp_path / "state.json"
    path.write_text("mine")
    keeper, _ = keeper_of(path)
    with pytest.raises(InputError, match="no state file"):
        keeper.save(learned())
    path.unlink()
    keeper.save(learned())
    assert FAILURE not in keeper.report()
    assert path.read_bytes() == dumps(learned().state())
    path.write_text("mine")  # while the node has it
    with pytest.raises(InputError, match="no state file"):
        keeper.save(learned())
    assert path.read_text() == "mine"
    keeper.close(None)
    assert os.listdir(tmp_path) == ["state.json"]


@pytest.mark.parametrize("content", [None, b""])
def test_nothing_and_an_empty_file_are_a_cold_start_and_are_saved_to(tmp_path, content):
    path = tmp_path / "sub" / "state.json"
    if content is not None:
        path.parent.mkdir()
        path.write_bytes(content)
    assert standing(path) is Standing.NOTHING
    keeper, lines = keeper_of(path)
    assert not keeper.start()
    assert "starting cold" in lines[-1]
    keeper.save(learned())
    assert standing(path) is Standing.STATE
    assert FAILURE not in keeper.report()
    keeper.close(None)


def test_a_link_stays_one(tmp_path):
    (tmp_path / "link").symlink_to("state.json")
    keeper, _ = keeper_of(tmp_path / "link")
    keeper.save(learned())
    keeper.close(None)
    assert (tmp_path / "link").is_symlink()
    assert read_state(tmp_path / "state.json")["version"] == 5


def test_each_damaged_file_is_kept_under_a_name_of_its_own(tmp_path):
    path = tmp_path / "state.json"
    for number in range(3):
        path.write_bytes(VERSION_3.read_bytes()[: 1000 + number])
        keeper, lines = keeper_of(path)
        assert keeper.start()
        with pytest.raises(InputError) as caught:
            keeper.load(lambda state: learned())
        keeper.refuse(caught.value)
        assert "starting cold" in lines[-1]
        assert "cut short" in keeper.report()[FAILURE]
        keeper.close(None)
    kept = {name: (tmp_path / name).stat().st_size for name in os.listdir(tmp_path)}
    assert kept == {"state.json.refused": 1000, "state.json.refused1": 1001, "state.json.refused2": 1002}


def test_only_what_a_dead_writer_left_is_swept(tmp_path):
    path = tmp_path / "shaft.json"
    users = [tmp_path / name for name in (".shaft.json.backup", ".shaft.json.2024", ".shaft.json.x.bak")]
    for folder in users:
        folder.mkdir()
        (folder / "old").write_text("kept")
        os.utime(folder, (1, 1))
    script = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from friction_estimator.output.staging import Staging\n"
        "staging = Staging(Path(sys.argv[1]))\n"
        "staging.take()\n"
        "with staging.file() as part:\n"
        "    part.write_text('half')\n"
        "    os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", script, path], check=False).returncode == 9
    assert len(os.listdir(tmp_path)) == 4
    keeper, _ = keeper_of(path)
    keeper.save(learned())
    keeper.close(None)
    assert sorted(os.listdir(tmp_path)) == sorted(["shaft.json", *(folder.name for folder in users)])
    assert all((folder / "old").read_text() == "kept" for folder in users)


def test_a_second_node_loads_and_goes_on_without_saving_until_the_first_has_ended(tmp_path):
    path = tmp_path / "state.json"
    script = (
        "import logging, sys\n"
        "from friction_estimator.core.settings.groups import StateConfig\n"
        "from friction_estimator.ros.state_keeper import StateKeeper\n"
        "keeper = StateKeeper(logging.getLogger())\n"
        "keeper.configure(StateConfig(file=sys.argv[1]))\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    path.write_bytes(VERSION_3.read_bytes())
    first = subprocess.Popen(
        [sys.executable, "-c", script, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert first.stdout.readline() == "held\n"
    keeper, lines = keeper_of(path)
    assert f"in use by process {first.pid}" in lines[-1]
    assert f"in use by process {first.pid}" in keeper.report()[FAILURE]
    assert keeper.start()
    estimator = Estimator(CONFIG)
    keeper.load(lambda state: estimator.restore(state) or estimator)
    estimator.step(10**12, 0.05, 5.0)
    with pytest.raises(InputError, match=f"process {first.pid}"):
        keeper.save(estimator)
    assert path.read_bytes() == VERSION_3.read_bytes()
    keeper.refuse(InputError("it does not fit"))  # it is not this node's to keep
    assert os.path.exists(path)
    first.kill()
    first.communicate()
    keeper.save(estimator)
    assert FAILURE not in keeper.report()
    assert read_state(path)["arrays"]["status"][at.SEEN] == 1501
    keeper.close(estimator)
    assert os.listdir(tmp_path) == ["state.json"]


def test_saving_goes_on_where_somebody_removed_the_lock_or_the_whole_folder(tmp_path):
    """As it was, each later save failed until the node was started again; with a second node, both saved."""
    path = tmp_path / "states" / "state.json"
    keeper, _ = keeper_of(path)
    estimator = learned()
    for gone in (path.parent / ".state.json.friction_estimator", path.parent):
        shutil.rmtree(gone)
        keeper.save(estimator)
        assert path.read_bytes() == dumps(estimator.state())
    shutil.rmtree(path.parent)
    second, _ = keeper_of(path)
    with pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
        keeper.save(estimator)
    second.close(None)
    keeper.save(estimator)
    keeper.close(None)
    assert os.listdir(path.parent) == ["state.json"]


def test_an_unsound_state_is_not_saved_over_a_sound_one(tmp_path):
    path = tmp_path / "state.json"
    keeper, _ = keeper_of(path)
    estimator = learned()
    keeper.save(estimator)
    estimator.work.theta[0] = np.nan
    with pytest.raises(ConfigError, match="not finite"):
        keeper.save(estimator)
    keeper.close(estimator)
    assert path.read_bytes() == dumps(learned().state())
    assert "not finite" in keeper.report()[FAILURE]


def test_a_failed_save_is_reported_until_one_succeeds(tmp_path):
    path = tmp_path / "state.json"
    keeper, lines = keeper_of(path, period=1e-9)
    estimator = learned()
    keeper.save(estimator)
    path.unlink()
    path.mkdir()
    for stamp in (1, 2, 3):
        estimator.step(10**12 + stamp, 0.05, 5.0)
        keeper.tick(estimator)
        keeper._join()
        assert "a folder" in keeper.report()[FAILURE]
    assert len(lines) == 1, "the same words are not logged again"
    path.rmdir()
    keeper.tick(estimator)
    keeper._join()
    assert FAILURE not in keeper.report()
    assert read_state(path)["arrays"]["status"][at.SEEN] == 1503
    keeper.close(estimator)


def test_a_reader_beside_a_writer_never_misses(tmp_path):
    path = tmp_path / "state.json"
    data = [dumps({"version": number, "arrays": {"a": np.zeros(2000)}}) for number in (1, 2)]
    with Staging(path) as staging:
        write_state(staging, data[0])
        done = threading.Event()

        def write():
            for number in range(60):
                write_state(staging, data[number % 2])
            done.set()

        writer = threading.Thread(target=write)
        writer.start()
        reads = 0
        while not done.is_set():
            assert read_state(path)["version"] in (1, 2)
            reads += 1
        writer.join()
    assert reads > 10


def test_a_state_that_could_not_be_read_back_is_not_written():
    with pytest.raises(InputError, match="more than the 128 MiB that are read back"):
        dumps({"version": 3, "arrays": {"root": np.zeros((3600, 3600))}})


def test_a_socket_and_a_name_that_is_none_are_refused(tmp_path):
    with socket.socket(socket.AF_UNIX) as open_socket:
        open_socket.bind(str(tmp_path / "s"))
        for path in (tmp_path / "s", "a\0b", "x" * 5000, tmp_path / "s" / "below"):
            keeper, _ = keeper_of(path)
            assert keeper.report()[FAILURE].isprintable()
            with pytest.raises(FrictionEstimatorError):
                keeper.save(learned())
