"""When the state file is written and read: periodically, on request, at start and at exit."""

import threading
import time
from collections.abc import Callable
from typing import Any

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, InputError
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.groups import StateConfig
from friction_estimator.ros.state import dumps, read_state, set_aside, sweep, write_state


class StateKeeper:
    """Owns the state file of one node.

    Periodic saves are written by a thread, since a disk may take longer than a queue can wait.

    Parameters
    ----------
    logger : of the node.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._config = StateConfig()
        self._due = 0.0
        self._writer: threading.Thread | None = None
        self._saved_samples = -1
        self._saved_at = 0.0
        self._failure = ""

    def configure(self, config: StateConfig) -> None:
        """Use this file and period from now on."""
        if config.file != self._config.file:
            self.changed()
        self._config = config
        self._due = time.monotonic() + config.period

    def start(self) -> bool:
        """Tidy up beside the state file; return True where there is one to load."""
        if not self._config.file:
            return False
        sweep(self._config.file)
        try:
            read_state(self._config.file)
        except InputError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                self._logger.info(f"no state file {self._config.file} yet: starting cold")
                return False
            self.refuse(error)
            return False
        return True

    def refuse(self, error: FrictionEstimatorError) -> None:
        """Report a state file that cannot be used and keep it aside."""
        aside = set_aside(self._config.file)
        self._failure = str(error)
        self._logger.error(f"starting cold: {error} (kept as {aside})")

    def changed(self) -> None:
        """Note that the state differs from the saved one although no sample came."""
        self._saved_samples = -1

    def load(self, restored: Callable[[dict[str, Any]], Estimator]) -> str:
        """Hand the state in the file to `restored`, which returns its estimator; raises why that is impossible."""
        path = self._path()
        estimator = restored(_part(read_state(path), path))
        self._saved_samples = estimator.health.samples
        return f"restored {path}: {estimator.health.samples} samples learned from"

    def save(self, estimator: Estimator) -> str:
        """Write the state now; raises the reason where that is impossible."""
        path = self._path()
        self._join()
        self._write(dumps(self._state(estimator)), path)
        return f"saved {path}"

    def tick(self, estimator: Estimator) -> None:
        """Save where it is time to."""
        config = self._config
        if not config.file or not config.period or time.monotonic() < self._due:
            return
        self._due = time.monotonic() + config.period
        if self._busy() or estimator.health.samples == self._saved_samples:
            return
        data = dumps(self._state(estimator))
        self._writer = threading.Thread(target=self._write_quietly, args=(data, config.file), daemon=True)
        self._writer.start()

    def close(self, estimator: Estimator) -> None:
        """Save at exit if anything changed."""
        self._join()
        if self._config.file and estimator.health.samples != self._saved_samples:
            self._write_quietly(dumps(self._state(estimator)), self._config.file)

    def report(self) -> dict[str, Any]:
        """Return what diagnostics say about the state file."""
        if not self._config.file:
            return {"state file": "none"}
        values: dict[str, Any] = {"state file": self._config.file}
        if self._saved_at:
            values["state saved (s ago)"] = f"{time.monotonic() - self._saved_at:.0f}"
        if self._failure:
            values["state file failure"] = self._failure
        return values

    def _state(self, estimator: Estimator) -> dict[str, Any]:
        self._saved_samples = estimator.health.samples
        return {"estimator": estimator.state()}

    def _path(self) -> str:
        if not self._config.file:
            raise ConfigError("state.file is empty: set it to the path of the state file")
        return self._config.file

    def _write(self, data: bytes, path: str) -> None:
        write_state(path, data)
        self._saved_at = time.monotonic()
        self._failure = ""

    def _write_quietly(self, data: bytes, path: str) -> None:
        try:
            self._write(data, path)
        except FrictionEstimatorError as error:
            self._failure = str(error)
            self._saved_samples = -1
            self._logger.error(str(error), throttle_duration_sec=60.0)

    def _busy(self) -> bool:
        return self._writer is not None and self._writer.is_alive()

    def _join(self) -> None:
        if self._writer is not None:
            self._writer.join()


def _part(state: dict[str, Any], path: str) -> dict[str, Any]:
    part = state.get("estimator")
    if not isinstance(part, dict):
        raise InputError(f"{path} is damaged: it holds no estimator")
    return part
