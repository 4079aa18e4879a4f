"""The variables of MATLAB's .mat files (not v7.3) as columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.budget import check_table
from friction_estimator.bag.columns import Columns
from friction_estimator.core.errors import InputError

_NO_COLUMNS = ("function", "object", "opaque", "sparse", "unknown")

_Place = tuple[str, tuple[str, ...], int | None]
"""Variable, members on the way into it, and the column of a matrix (None: the whole is one column)."""


class MatFile:
    """A .mat file: variables, members of structures as `name.member`, columns of a matrix as `name[0]`, `name[1]`, ...

    Numbers and words are known by their heads; what a structure holds, only when it is read. To be used by `apart`:
    damaged files crash scipy's reader.

    Raises
    ------
    InputError for a v7.3 file, TooLargeError, and whatever scipy raises for damaged ones.
    """

    def __init__(self, path: Path) -> None:
        from scipy.io.matlab import loadmat, whosmat  # noqa: PLC0415 - slow to import

        self._path, self._load = path, loadmat
        try:
            kinds = {name: (shape, kind) for name, shape, kind in whosmat(path) if kind not in _NO_COLUMNS}
        except NotImplementedError as error:
            raise InputError(f"is a MATLAB v7.3 file; save it again with save('{path.name}', '-v7')") from error
        self._shapes = {name: shape[:1] if kind == "char" else shape for name, (shape, kind) in kinds.items()}
        self._tree = {name: self._variable(name) for name, (_, kind) in kinds.items() if kind == "struct"}
        self._places = _places({name: self._tree.get(name, shape) for name, shape in self._shapes.items()})
        self.names = list(self._places)

    def read(self, wanted: Sequence[str]) -> Columns:
        """Return some columns."""
        unread = {self._places[name][0] for name in wanted} - self._tree.keys()
        check_table(sum(8 * float(np.prod([float(size) for size in self._shapes[name]])) for name in unread))
        self._tree |= {name: self._variable(name) for name in unread}
        return {name: self._column(*self._places[name]) for name in wanted}

    def _variable(self, name: str) -> Any:
        return self._load(self._path, variable_names=[name], simplify_cells=True)[name]

    def _column(self, variable: str, members: tuple[str, ...], k: int | None) -> NDArray[Any]:
        value = self._tree[variable]
        for member in members:
            value = value[member]
        array = np.asarray(value)
        return array.ravel() if k is None else array[:, k]


def _places(tree: Mapping[str, Any]) -> dict[str, _Place]:
    """Return where each column is found; variables are given by their shape, structures by their content."""
    places: dict[str, _Place] = {}

    def walk(name: str, variable: str, members: tuple[str, ...], value: Any) -> None:
        if isinstance(value, Mapping):
            for member, inner in value.items():
                walk(f"{name}.{member}", variable, (*members, member), inner)
            return
        shape = value if isinstance(value, tuple) else np.shape(value)
        if len(shape) == 2 and min(shape) > 1:
            places.update({f"{name}[{k}]": (variable, members, k) for k in range(shape[1])})
        elif len(shape) <= 2:
            places[name] = (variable, members, None)

    for variable, value in tree.items():
        walk(variable, variable, (), value)
    return places
