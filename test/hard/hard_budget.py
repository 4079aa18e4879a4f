"""Gigabytes in small files, given to the command line in a process with 2 GB of addresses: one line, under 1 GB."""

import resource
import subprocess
import sys

import pytest
from hard import bombs

LIMIT, GB = 2 << 30, 1 << 30


def run(*arguments):
    """Return exit code, lines on stderr and the largest memory of it and its own processes, MB."""
    script = (  # ru_maxrss of a process itself is inherited from whoever started it
        "import re, resource, sys\n"
        "from friction_estimator.cli.main import main\n"
        "try:\n    code = main(sys.argv[1:])\n"
        "finally:\n"
        "    own = int(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])\n"
        "    print(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) // 1024)\n"
        "sys.exit(code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        check=False,
        capture_output=True,
        text=True,
        timeout=100,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT)),
    )
    return done.returncode, done.stderr.splitlines(), int(done.stdout.splitlines()[-1])


def assert_refused(path, *arguments):
    code, lines, largest_mb = run(*arguments)
    assert code == 2
    assert len(lines) == 1, lines
    assert str(path) in lines[0]
    assert largest_mb < 1000
    print(f"{path.name}: {path.stat().st_size} bytes, {largest_mb} MB; {lines[0]}")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared", [None, 100_000_000, 1000])
@pytest.mark.parametrize("indexed", [True, False])
def test_a_chunk_of_six_gigabytes(tmp_path, compression, declared, indexed):
    bombs.mcap_chunk(tmp_path / "run.mcap", 6 * GB, compression, declared=declared, indexed=indexed)
    assert_refused(tmp_path / "run.mcap", "info", tmp_path / "run.mcap")


def test_a_file_of_six_gigabytes_in_a_folder(tmp_path):
    bombs.packed_file(tmp_path / "run", 6 * GB)
    assert_refused(tmp_path / "run", "info", tmp_path / "run")


COLUMNS = ("--time", "t", "--map", "velocity=v,friction=f")


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".parquet"])
def test_a_column_of_a_gigabyte_that_nobody_mapped_costs_nothing(tmp_path, suffix):
    bombs.table(tmp_path / f"run{suffix}", 9 << 24, mapped=False)
    code, lines, largest_mb = run("import", tmp_path / f"run{suffix}", "--out", tmp_path / "out", *COLUMNS)
    assert (code, lines) == (0, [])
    assert largest_mb < 400
    print(f"{suffix}: {(tmp_path / f'run{suffix}').stat().st_size} bytes, {largest_mb} MB")


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".parquet"])
def test_a_mapped_column_of_a_gigabyte_is_refused(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    bombs.table(path, 9 << 24, mapped=True)
    assert_refused(path, "import", path, "--out", tmp_path / "out", *COLUMNS)
