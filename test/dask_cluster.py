"""A Dask cluster as a user starts one: a scheduler and its workers, each a process of its own."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from test_workers import until

ROOT = Path(__file__).parents[1]


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield the address of a scheduler and the process whose children are its workers; docs/many.md has one such."""
    environment = {
        **os.environ,
        "PYTHONPATH": f"{ROOT}:{ROOT / 'test'}",
        "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "1h",
        "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
    }
    told = folder / "scheduler.json"
    common = ["--scheduler-file", str(told), "--no-dashboard"]
    commands = [
        ["scheduler", "--port", "0", "--host", "127.0.0.1", *common],
        ["worker", "--nworkers", str(workers), "--nthreads", "1", "--local-directory", str(folder), *common],
    ]
    started = []
    try:
        for name, *words in commands:
            with (folder / f"{name}.log").open("wb") as log:
                program = [sys.executable, "-m", "dask", name, *words]
                options = {"stdout": log, "stderr": log, "start_new_session": True}
                started.append(subprocess.Popen(program, env=environment, cwd=folder, **options))
            until(lambda: told.exists() and told.stat().st_size > 0)
        address = next(word for word in told.read_text().split('"') if word.startswith("tcp://"))
        yield address, started[1]
    finally:
        for process in reversed(started):  # a nanny may wait long for a worker that it starts just now
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
