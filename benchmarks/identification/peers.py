"""SysIdentPy's polynomial NARX and NFIR on one record. Runs in the environment of requirements.txt.

    python peers.py RECORD.npz RESULT.json

RECORD holds velocity_m_s, friction_N and `learn`, the number of leading samples to learn from. Models see the velocity,
or the velocity and its sign; NARX is simulated (its own past outputs are fed back), as a friction model is used.
"""

import json
import sys
import time
import warnings

import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

LAGS = 9
TERMS = 25


def nrmse(measured, predicted):
    with np.errstate(all="ignore"):
        return float(np.sqrt(np.mean(np.square(measured - predicted))) / np.std(measured))


def fit(kind, degree, inputs, target, learn):
    narx = kind == "NARX"
    model = FROLS(
        order_selection=True,
        n_info_values=TERMS,
        info_criteria="bic",
        ylag=LAGS if narx else 1,
        xlag=[list(range(1, LAGS + 1))] * inputs.shape[1] if inputs.shape[1] > 1 else LAGS,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=degree),
        model_type="NARMAX" if narx else "NFIR",
    )
    # A lag of one is the shortest the package has: shifting the input gives it the present velocity.
    ahead = np.vstack([inputs[1:], inputs[-1:]])
    begin = time.perf_counter()
    model.fit(X=ahead[:learn], y=target[:learn])
    seconds = time.perf_counter() - begin
    tail = slice(learn - LAGS, None)
    free = model.predict(X=ahead[tail], y=target[tail] if narx else target[tail][: model.max_lag])
    row = {
        "nrmse_frozen": nrmse(target[learn:, 0], free[-(target.shape[0] - learn) :, 0]),
        "terms": len(model.theta),
        "fit_s": seconds,
    }
    if narx:
        one = model.predict(X=ahead[tail], y=target[tail], steps_ahead=1)
        row["nrmse_one_step"] = nrmse(target[learn:, 0], one[-(target.shape[0] - learn) :, 0])
    return row


def main():
    record = np.load(sys.argv[1])
    velocity, friction, learn = record["velocity_m_s"], record["friction_N"], int(record["learn"])
    scale = np.abs(velocity[:learn]).max(), np.abs(friction[:learn]).max()
    columns = {"v": velocity[:, None] / scale[0]}
    columns["v, sign v"] = np.column_stack([columns["v"], np.sign(velocity)])
    target = friction[:, None] / scale[1]
    rows = []
    for kind in ("NFIR", "NARX"):
        for name, inputs in columns.items():
            for degree in (1, 2, 3):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    row = fit(kind, degree, inputs, target, learn)
                rows.append({"kind": kind, "inputs": name, "degree": degree} | row)
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    with open(sys.argv[2], "w", encoding="utf-8") as handle:
        json.dump(rows, handle)


if __name__ == "__main__":
    main()
