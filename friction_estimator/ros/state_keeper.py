"""When the state file is written and read: periodically, on request, at start and at exit."""

import time
from collections.abc import Callable
from typing import Any

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, InputError
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.groups import StateConfig
from friction_estimator.output.paths import resolved
from friction_estimator.output.staging import InUseError, Staging
from friction_estimator.ros.background import Background
from friction_estimator.ros.state import Standing, dumps, read_state, set_aside, standing, write_state

LONGEST_WRITE_S = 10.0
"""Time that a save is waited for: a disk that does not answer must not keep the node from ending."""

FAILURE = "state file failure"
"""Key of `StateKeeper.report` where something is wrong; diagnostics then warn."""


class StateKeeper:
    """Owns the state file of one node.

    It holds the file's lock as long as the node has the file: a second node of the same file goes on without saving,
    says who holds it, and takes over when it is free. Periodic saves are of one moment, and packed and written by a
    thread: a sample can wait for neither, and a disk may take longer than any queue.

    Parameters
    ----------
    logger : of the node.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._config = StateConfig()
        self._staging: Staging | None = None
        self._due = 0.0
        self._writer = Background("state file", lambda name, error: self._failed(f"not saved: {name}: {error}"))
        self._saved_samples = -1
        self._saved_at = 0.0
        self._failure = ""

    def configure(self, config: StateConfig) -> None:
        """Use this file and period from now on."""
        if config.file != self._config.file:
            self.changed()
            self._give_up()
            self._config = config
            self._failure = ""
            if config.file:
                self._guarded(self._take, "not saving")
        self._config = config
        self._due = time.monotonic() + config.period

    def start(self) -> bool:
        """Return whether there is a state file to load; say why not."""
        if not self._config.file:
            return False
        try:
            found = standing(self._config.file)
        except InputError as error:
            self._failed(f"starting cold and not saving: {error}")
            return False
        if found is Standing.NOTHING:
            self._logger.info(f"no state file {self._config.file} yet: starting cold")
        return found is Standing.STATE

    def refuse(self, error: FrictionEstimatorError) -> None:
        """Report a state file that cannot be used and keep it aside, where it is this node's to keep."""
        if self._staging is None:
            self._failed(f"starting cold: {error} ({self._failure})")
            return
        try:
            told = f"kept as {set_aside(self._staging.target)}"
        except InputError as reason:
            told = str(reason)
        self._failed(f"starting cold: {error} ({told})")

    def changed(self) -> None:
        """Note that the state differs from the saved one although no sample came."""
        self._saved_samples = -1

    def load(self, restored: Callable[[dict[str, Any]], Estimator]) -> str:
        """Hand the state in the file to `restored`, which returns its estimator; raises why that is impossible."""
        path = self._path()
        state = read_state(path)
        try:
            estimator = restored(state)
        except ConfigError as error:
            error.where = error.where or path
            raise
        self._saved_samples = estimator.health.samples
        return f"restored {path}: {estimator.health.samples} samples learned from"

    def save(self, estimator: Estimator) -> str:
        """Write the state now; raises the reason where that is impossible."""
        path = self._path()
        self._join()
        try:
            self._write(self._held(), estimator)
        except FrictionEstimatorError as error:
            self._failed(f"not saved: {error}")
            raise
        self._saved_samples = estimator.health.samples
        return f"saved {path}"

    def tick(self, estimator: Estimator) -> None:
        """Save where it is time to."""
        config = self._config
        if not config.file or not config.period or time.monotonic() < self._due:
            return
        self._due = time.monotonic() + config.period
        if self._writer.busy or estimator.health.samples == self._saved_samples:
            return
        self._guarded(lambda: self._begin_writing(estimator), "not saved")

    def close(self, estimator: Estimator | None) -> None:
        """Save at exit if anything changed, and give the file up."""
        if self._config.file and estimator is not None:
            self._guarded(lambda: self._last_save(estimator), "not saved")
        self._give_up()

    def report(self) -> dict[str, Any]:
        """Return what diagnostics say about the state file."""
        if not self._config.file:
            return {"state file": "none"}
        values: dict[str, Any] = {"state file": self._config.file}
        if self._saved_at:
            values["state saved (s ago)"] = f"{time.monotonic() - self._saved_at:.0f}"
        if self._failure:
            values[FAILURE] = self._failure
        return values

    # --- the lock --------------------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Hold the lock of the state file; raises InputError where it cannot be had."""
        standing(self._config.file)
        staging = Staging(resolved(self._config.file))
        try:
            staging.take()
        except InUseError as error:
            raise InUseError(f"{error}; saving begins when it is free") from error
        self._staging = staging

    def _give_up(self) -> None:
        if self._staging is not None and not self._writer.busy:  # what still writes keeps it until the process ends
            self._staging.release()
        self._staging = None

    # --- writing ---------------------------------------------------------------------------------------------------

    def _held(self) -> Staging:
        """Return where to write, once the lock is held; raises InputError where it cannot be had."""
        if self._staging is None:
            self._take()
        assert self._staging is not None
        return self._staging

    def _begin_writing(self, estimator: Estimator) -> None:
        staging, moment = self._held(), estimator.snapshot()
        self._saved_samples = moment.health.samples
        self._writer.begin(lambda: self._guarded(lambda: self._write(staging, moment), "not saved"))

    def _last_save(self, estimator: Estimator) -> None:
        self._join()
        if estimator.health.samples != self._saved_samples:
            self._write(self._held(), estimator)
            self._saved_samples = estimator.health.samples

    def _write(self, staging: Staging, estimator: Estimator) -> None:
        """Write what the estimator is; raises FrictionEstimatorError where that is impossible."""
        estimator.check_state()
        write_state(staging, dumps(estimator.state()))
        self._saved_at = time.monotonic()
        self._failure = ""

    def _guarded(self, act: Callable[[], None], what: str) -> None:
        """Do it; a failure is reported, and what was to be saved is due again."""
        try:
            act()
        except (FrictionEstimatorError, OSError) as error:
            self._saved_samples = -1
            self._failed(f"{what}: {error}")

    def _failed(self, words: str) -> None:
        if words != self._failure:
            self._logger.error(words)
        self._failure = words

    def _path(self) -> str:
        if not self._config.file:
            raise ConfigError("state.file is empty: set it to the path of the state file")
        return self._config.file

    def _join(self) -> None:
        """Wait for the save that is under way; raises InputError where it takes too long."""
        if not self._writer.join(LONGEST_WRITE_S):
            raise InputError(f"{self._config.file} has been written to for {LONGEST_WRITE_S:g} s without an end")
