"""Outputs are replaced whole or not at all, by one process at a time, and nothing of a user's is lost with them."""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from friction_estimator.core.errors import InputError
from friction_estimator.output.exchange import exchange
from friction_estimator.output.paths import refuse_inputs
from friction_estimator.output.run import RunOutput
from friction_estimator.output.staging import InUseError, Staging
from friction_estimator.output.target import Target, replacing_file, write_text

HOLDER = (
    "import sys; from pathlib import Path; from friction_estimator.output.staging import Staging\n"
    "with Staging(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
)


def anything(folder):
    """Refuses nothing."""


def tree(folder):
    """Return what is in a folder: name -> content of each file."""
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def put(target, **files):
    with Target(target, anything) as output, output.part() as part:
        part.mkdir()
        for name, text in files.items():
            (part / name).write_text(text)


@pytest.fixture
def holder():
    """Start processes that hold the staging folder of a target until they are told, or killed."""
    started = []

    def start(target):
        command = [sys.executable, "-c", HOLDER, str(target)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert process.stdout.readline() == b"held\n"
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


# Replacing


def test_a_file_and_a_folder_are_replaced_whole(tmp_path):
    for text in ("one", "two"):
        write_text(tmp_path / "deep" / "a.txt", text)
        put(tmp_path / "run", **{f"{text}.txt": text})
        assert tree(tmp_path) == {"deep/a.txt": text, f"run/{text}.txt": text}
    assert sorted(item.name for item in tmp_path.iterdir()) == ["deep", "run"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
def test_what_fails_leaves_the_former_one_and_nothing_else(tmp_path, error):
    put(tmp_path / "run", a="old")
    write_text(tmp_path / "a.txt", "old")
    before = tree(tmp_path)

    def half_a_folder():
        with Target(tmp_path / "run", anything) as output, output.part() as part:
            part.mkdir()
            (part / "half").touch()
            raise error

    def half_a_file(path):
        with replacing_file(path) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        half_a_folder()
    for path in ("a.txt", "new/deep/a.txt"):
        with pytest.raises(error):
            half_a_file(tmp_path / path)
    assert tree(tmp_path) == before
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.txt", "run"]


def test_two_renames_where_names_cannot_be_exchanged_bring_the_former_back(tmp_path, monkeypatch):
    """The way for file systems without RENAME_EXCHANGE, interrupted between its renames."""
    monkeypatch.setattr("friction_estimator.output.exchange._renamed", lambda *_: False)
    put(tmp_path / "run", a="old")
    put(tmp_path / "run", a="new")
    assert tree(tmp_path) == {"run/a": "new"}
    (tmp_path / "none").mkdir()
    with pytest.raises(FileNotFoundError):
        exchange(tmp_path / "missing", tmp_path / "run", tmp_path / "former")
    assert tree(tmp_path) == {"run/a": "new"}
    # Killed in between: whoever takes the staging folder next brings it back.
    staging = Staging(tmp_path / "run")
    staging.take()
    (tmp_path / "run").rename(staging.folder / "former")
    os.close(staging._descriptor)
    with Staging(tmp_path / "run"):
        assert tree(tmp_path / "run") == {"a": "new"}
    assert not list(tmp_path.glob(".*"))


def test_permissions_stay(tmp_path):
    write_text(tmp_path / "a.txt", "old")
    (tmp_path / "a.txt").chmod(0o600)
    put(tmp_path / "run", a="old")
    (tmp_path / "run").chmod(0o750)
    write_text(tmp_path / "a.txt", "new")
    put(tmp_path / "run", a="new")
    modes = [(tmp_path / name).stat().st_mode & 0o777 for name in ("a.txt", "run")]
    assert modes == [0o600, 0o750]


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path):
    for name in ("disk", "links"):
        (tmp_path / name).mkdir()
    (tmp_path / "links" / "run").symlink_to(tmp_path / "disk" / "run")
    (tmp_path / "links" / "a.txt").symlink_to("../disk/a.txt")
    for text in ("old", "new"):
        put(tmp_path / "links" / "run", a=text)
        write_text(tmp_path / "links" / "a.txt", text)
        assert tree(tmp_path / "disk") == {"a.txt": text, "run/a": text}
    assert sorted(item.name for item in (tmp_path / "links").iterdir() if item.is_symlink()) == ["a.txt", "run"]
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(InputError, match="circle"):
        write_text(tmp_path / "circle", "")


def test_devices_and_pipes_are_written_as_they_are(tmp_path):
    write_text("/dev/null", "nothing")
    assert Path("/dev/null").is_char_device()
    os.mkfifo(tmp_path / "pipe")
    heard = []
    reader = threading.Thread(target=lambda: heard.append((tmp_path / "pipe").read_text()))
    reader.start()
    with RunOutput(document=tmp_path / "pipe") as output:
        output.write_document("{}")
    reader.join(60)
    assert heard == ["{}"]
    assert [item.name for item in tmp_path.iterdir()] == ["pipe"]
    assert (tmp_path / "pipe").is_fifo()


def test_stdout_by_its_path_is_no_file_to_replace(tmp_path):
    """/dev/stdout may lead to a file, in which words stand already."""
    code = "from friction_estimator.output.target import write_text; print('words'); write_text('/dev/stdout', 'json')"
    with (tmp_path / "log").open("wb") as log:
        subprocess.run([sys.executable, "-c", code], stdout=log, check=True)
    assert (tmp_path / "log").read_text() == "words\njson"


def test_kinds_are_not_exchanged(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="a file stands there"):
        put(tmp_path / "file")
    with pytest.raises(InputError, match="a folder stands there"):
        write_text(tmp_path / "folder", "")
    with pytest.raises(InputError, match="Not a directory"):
        write_text(tmp_path / "file" / "a.txt", "")


def test_where_this_process_stands_is_not_exchanged(tmp_path, monkeypatch):
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path / "run")
    for path in (".", tmp_path):
        with pytest.raises(InputError, match="holds the current folder"):
            put(path)
    with pytest.raises(InputError, match="root of a file system"):
        put("/dev/shm")


def test_what_comes_into_the_former_folder_at_the_last_moment_is_kept(tmp_path):
    """It is looked at before the exchange and after it: the exchange is undone."""
    put(tmp_path / "run", a="old")
    looks = []

    def refusal(folder):
        looks.append(folder)
        if len(looks) == 3:
            (folder / "mine").touch()
            return "mine came into it"
        return None

    def replace():
        with Target(tmp_path / "run", refusal) as output, output.part() as part:
            part.mkdir()

    with pytest.raises(InputError, match="mine came into it"):
        replace()
    assert tree(tmp_path) == {"run/a": "old", "run/mine": ""}
    assert [item.name for item in tmp_path.iterdir()] == ["run"]


@pytest.fixture
def mount(tmp_path):
    """Mount something and return where, for as long as the test runs."""
    mounted = []

    def mounted_at(place, *words):
        done = subprocess.run(["mount", *words, place], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"nothing can be mounted here: {done.stderr.strip()}")
        mounted.append(place)
        return place

    yield mounted_at
    for place in mounted:
        subprocess.run(["umount", place], check=True)


def test_a_folder_that_came_with_the_image_of_a_container_is_told(tmp_path, mount):
    folders = {name: tmp_path / name for name in ("lowerdir", "upperdir", "workdir")}
    for folder in folders.values():
        folder.mkdir()
    put(folders["lowerdir"] / "run", a="old")
    (tmp_path / "root").mkdir()
    options = ",".join(f"{name}={folder}" for name, folder in folders.items())
    root = mount(tmp_path / "root", "-t", "overlay", "overlay", "-o", options)
    with pytest.raises(InputError, match=r"came with the image of a container.*remove it first"):
        put(root / "run", a="new")
    assert tree(root) == {"run/a": "old"}
    assert os.listdir(root) == ["run"]
    shutil.rmtree(root / "run")
    put(root / "run", a="new")
    assert tree(root) == {"run/a": "new"}


def test_a_file_that_is_a_mount_is_told(tmp_path, mount):
    for name in ("given", "state.json"):
        (tmp_path / name).write_text(name)
    path = mount(tmp_path / "state.json", "--bind", tmp_path / "given")
    with pytest.raises(InputError, match=r"it is a mount, .*: mount the folder that it lies in"):
        write_text(path, "new")
    assert path.read_text() == "given"
    assert sorted(os.listdir(tmp_path)) == ["given", "state.json"]


# One at a time


def test_the_second_writer_is_told_who_holds_it(tmp_path, holder):
    first = holder(tmp_path / "run")
    with pytest.raises(InUseError, match=rf"run is in use by process {first.pid} \(-c .*run\): wait") as caught:
        put(tmp_path / "run", a="new")
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "run").exists()
    first.communicate()
    put(tmp_path / "run", a="new")
    assert [item.name for item in tmp_path.iterdir()] == ["run"]


def test_what_a_killed_writer_left_is_swept_and_nothing_else(tmp_path, holder):
    users = [tmp_path / name for name in (".run.backup", ".run.tmp", ".run.friction_estimator.old", ".other")]
    for folder in users:
        folder.mkdir()
        (folder / "mine").touch()
    dead, alive = holder(tmp_path / "run"), holder(tmp_path / "other")
    places = [Staging(tmp_path / name).folder for name in ("run", "other")]
    for place in places:
        (place / "new").mkdir()
        (place / "new" / "half").touch()
    dead.kill()
    dead.wait()
    put(tmp_path / "run", a="new")
    assert not places[0].exists()
    assert (places[1] / "new" / "half").exists()
    assert all((folder / "mine").exists() for folder in users)
    alive.communicate()
    assert not places[1].exists()


def test_a_lock_that_somebody_removed_is_taken_anew_and_never_another_processs(tmp_path, holder):
    path = tmp_path / "sub" / "run"
    with Staging(path) as staging:
        for gone in (staging.folder, path.parent):
            shutil.rmtree(gone)
            with staging.file() as part:
                part.write_text("mine")
            assert path.read_text() == "mine"
        shutil.rmtree(staging.folder)
        other = holder(path)
        with pytest.raises(InUseError, match=f"process {other.pid} "), staging.file():
            pass
        with pytest.raises(InUseError, match=f"process {other.pid} "), staging.replacement(lambda _: None):
            pass
    assert (staging.folder / "owner").exists(), "it is the other one's to remove"
    other.communicate()
    assert [item.name for item in path.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("content", [{"mine": "x"}, {"owner": "x"}, {"owner": "", "mine": "x"}])
def test_a_users_folder_of_that_name_is_left_alone(tmp_path, content):
    place = Staging(tmp_path / "run").folder
    place.mkdir()
    for name, text in content.items():
        (place / name).write_text(text)
    with pytest.raises(InputError, match="move that away"):
        put(tmp_path / "run", a="new")
    assert tree(place) == {name: text for name, text in content.items() if name != "owner" or text}


def test_many_takers_get_it_one_after_the_other(tmp_path):
    """Takers and leavers at the same moments: never two at once, nothing left."""
    inside, most, rounds = [], [], 40

    def work():
        done = 0
        while done < rounds:
            try:
                with Staging(tmp_path / "run"):
                    inside.append(1)
                    most.append(len(inside))
                    inside.pop()
                    done += 1
            except InUseError:
                continue

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert len(most) == 4 * rounds
    assert max(most) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_name_as_long_as_names_may_be(tmp_path):
    write_text(tmp_path / ("n" * 255), "text")
    assert (tmp_path / ("n" * 255)).read_text() == "text"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InputError, match="File name too long"):
        write_text(tmp_path / ("n" * 256), "text")


# Inputs


@pytest.mark.parametrize(
    ("output", "says"),
    [
        ("run/bag", "is the input"),
        ("run", "holds the input"),
        (".", "holds the input"),
        ("run/bag/results", "lies in the input"),
        ("linked", "is the input"),
        ("table.csv", "is the input"),
        ("hard.csv", "is the input"),
        ("elsewhere", "holds the input"),
    ],
)
def test_an_output_is_no_input_by_whatever_name(tmp_path, monkeypatch, output, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run" / "bag").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "data.mcap").touch()
    (tmp_path / "run" / "bag" / "data.mcap").symlink_to(tmp_path / "elsewhere" / "data.mcap")
    (tmp_path / "linked").symlink_to("run/bag")
    (tmp_path / "table.csv").touch()
    (tmp_path / "hard.csv").hardlink_to("table.csv")
    with pytest.raises(InputError, match=says):
        refuse_inputs("--out", output, ["run/bag", "table.csv"])
    refuse_inputs("--out", "other", ["run/bag", "table.csv"])


def test_the_document_lies_outside_the_set(tmp_path):
    for document in ("run", "run/result.json"):
        with (
            pytest.raises(InputError, match="name a file outside"),
            RunOutput(tmp_path / "run", anything, tmp_path / document),
        ):
            pass
    assert list(tmp_path.iterdir()) == []
