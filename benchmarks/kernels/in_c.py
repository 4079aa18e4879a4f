"""The laws in C (laws.c): compiled here, and called on what the compiled loop is called on."""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from friction_estimator.core.model.structure import Inputs
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.estimator import Estimator

SOURCE = Path(__file__).with_name("laws.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")


def compiled() -> ctypes.CDLL:
    """Return the library."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "laws.so"
        subprocess.run(["cc", *FLAGS, str(SOURCE), "-o", str(library), "-lm"], check=True)
        return ctypes.CDLL(str(library))


def compiler() -> str:
    """Return its name and version."""
    return subprocess.run(["cc", "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0]


class InC:
    """One law in C on the samples of an estimator that has seen none.

    Parameters
    ----------
    estimator : whose start, constants and prior are taken.
    """

    def __init__(self, library: ctypes.CDLL, estimator: Estimator, inputs: Inputs, velocity: np.ndarray) -> None:
        work, law = estimator.work, estimator.work.law
        taps, weights, theory_taps, beside = (int(v) for v in work.shape)
        assert not beside, "laws.c has neither load nor extension"
        name = estimator.config.model.law
        self._function = getattr(library, name)
        self._start = estimator.model.initial_theta()
        self._predicted = np.empty(velocity.size)
        self._arrays = [  # kept alive
            inputs.index,
            inputs.value,
            inputs.theory,
            inputs.target,
            np.ascontiguousarray(velocity),
            work.prior.copy(),
            work.mean.copy(),
            np.ascontiguousarray(work.information),
            np.ascontiguousarray(work.prior_root),
        ]
        index, value, theory, target, speed, metric, mean, information, root = map(_pointer, self._arrays)
        sizes = [ctypes.c_long(v) for v in (velocity.size, taps, weights, theory_taps, inputs.index.shape[1])]
        step, floor, least, residual = (ctypes.c_double(law[i]) for i in range(4))
        moving = speed, ctypes.c_double(law[at.LEAST_SPEED])
        own = {
            "lms": (step,),
            "nlms": (*moving, step, floor, metric),
            "rls": (*moving, least, residual, mean, information, root),
        }
        self._arguments = [*sizes, index, value, theory, target, *own[name]]

    def __call__(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what was learned and predicted, normalised."""
        theta = self._start.copy()
        self._function(*self._arguments, _pointer(theta), _pointer(self._predicted))
        return theta, self._predicted


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
