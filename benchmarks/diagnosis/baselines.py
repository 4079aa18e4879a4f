"""Lasso, forward orthogonal regression and a whiteness test on the exported records: `python baselines.py DIR`.

Runs in a virtual environment of its own: `pip install scikit-learn sysidentpy`.

lasso      LassoLarsIC (scikit-learn, BIC); named is the effect whose columns carry the most power
frols      error reduction ratio of SysIdentPy's FROLS; named is the first term; "nothing" where BIC prefers no term
whiteness  largest autocorrelation of the residual over 25 lags against +-2.58 / sqrt(n) (99 %), as MATLAB's resid; it
           names nothing
"""

import sys
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from sklearn.linear_model import LassoLarsIC
from sysidentpy.model_structure_selection import FROLS


def lasso(x: np.ndarray, y: np.ndarray, names: np.ndarray) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        noise = float(np.var(y))
        fitted = LassoLarsIC(criterion="bic", max_iter=60, noise_variance=noise).fit(x, y)
    power = defaultdict(float)
    for name, weight in zip(names, fitted.coef_, strict=True):
        power[name] += abs(weight)
    best = max(power, key=lambda n: power[n])
    return best if power[best] > 0.0 else ""


def frols(x: np.ndarray, y: np.ndarray, names: np.ndarray) -> str:
    model = FROLS(order_selection=False, n_terms=1)
    model.max_lag = 0
    _, pivot, _ = model.error_reduction_ratio(x, y[:, None], 1)
    first = int(np.ravel(pivot)[0])
    column = x[:, first]
    rest = y - column * (column @ y) / (column @ column)
    gain = y.size * np.log(float(y @ y) / float(rest @ rest))
    return str(names[first]) if gain > np.log(y.size) else ""


def white(residual: np.ndarray) -> bool:
    n = residual.size
    centred = residual - residual.mean()
    lags = [float(centred[k:] @ centred[: n - k]) / float(centred @ centred) for k in range(1, 26)]
    return max(map(abs, lags)) < 2.58 / np.sqrt(n)


def main() -> None:
    score: dict[str, dict[str, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted(Path(sys.argv[1]).glob("*.npz")):
        data = np.load(path)
        truth, condition = str(data["truth"]), str(data["condition"])
        x, y, names = data["columns"].astype(np.float64), data["residual"], data["names"]
        score[condition]["ours"].append(str(data["ours"]) == truth)
        score[condition]["lasso"].append(lasso(x, y, names) == truth)
        score[condition]["frols"].append(frols(x, y, names) == truth)
        # It can only say whether something is wrong.
        score[condition]["whiteness (right alarm)"].append(white(data["whole"]) == (truth == ""))
    for condition, row in score.items():
        count = len(row["ours"])
        print(f"{condition:24s} n {count:3d}  " + "  ".join(f"{k} {100 * np.mean(v):5.1f} %" for k, v in row.items()))


if __name__ == "__main__":
    main()
