"""The compiled prediction is the sum that its documentation says, whatever the number of taps and weights is."""

import numpy as np
import pytest

from friction_estimator.core.model.prediction import delay_lines, predict_fixed


@pytest.mark.parametrize("weights", [3, 8, 21])
@pytest.mark.parametrize("theory_taps", [0, 2])
@pytest.mark.parametrize("taps", range(1, 9))
def test_prediction_of_fixed_parameters(taps, theory_taps, weights):
    rng = np.random.default_rng(taps)
    n, width = 40, 3
    shape = np.array([taps, weights, theory_taps, 1])
    theta = rng.standard_normal(shape.sum())
    index = np.argsort(rng.random((n, weights)), axis=1)[:, :width].astype(np.int32)
    value, theory, beside = rng.standard_normal((n, width)), rng.standard_normal(n), rng.standard_normal((n, 1))
    begins = np.array([0, 17])
    restart = np.isin(np.arange(n), begins)
    predicted = np.empty(n)
    lines = delay_lines(shape)
    for part in (slice(0, 25), slice(25, n)):
        arrays = index[part], value[part], theory[part], beside[part].copy(), np.zeros((n, 0))[part]
        predict_fixed(*arrays, 0, restart[part], predicted[part], shape, theta, *lines)

    rows = np.zeros((n, weights))
    np.put_along_axis(rows, index.astype(np.int64), value, axis=1)
    a, w, b, c = np.split(theta, np.cumsum(shape)[:-1])
    for k in range(n):
        lag = lambda count, k=k: np.maximum(k - np.arange(count), begins[begins <= k].max())  # noqa: E731
        expected = a @ (rows[lag(taps)] @ w) + b @ theory[lag(theory_taps)] + c @ beside[k]
        assert predicted[k] == pytest.approx(expected, abs=1e-12)
