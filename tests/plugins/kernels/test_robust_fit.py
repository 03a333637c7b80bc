"""Reweighted least squares against the same in plain NumPy, and against what was drawn."""

from __future__ import annotations

import numpy as np

from roemetry_kernels.robust_fit import robust_fit


def test_a_fifth_that_lies_far_off_hardly_moves_the_fit(rng: np.random.Generator) -> None:
    x = np.linspace(-1.0, 1.0, 201)
    rows = np.stack([np.ones_like(x), x, x * x])
    wanted = np.array([2.0, -1.0, 0.5]) @ rows + 0.01 * rng.standard_normal(x.size)
    wanted[::5] += 3.0
    base, ridge = 0.5 + rng.random(x.size), np.array([0.0, 1e-6, 1e-6])
    fit, weight, off = robust_fit(rows, wanted, base, ridge, 0.005, 20)
    np.testing.assert_allclose(fit, [2.0, -1.0, 0.5], rtol=0, atol=0.02)
    expected, found = base, np.zeros(3)
    for _ in range(20):
        found = np.linalg.solve((rows * expected) @ rows.T + np.diag(ridge), (rows * expected) @ wanted)
        left = wanted - found @ rows
        expected = base / (1.0 + (left / (2.0 * max(1.4826 * np.median(np.abs(left)), 0.005))) ** 2)
    np.testing.assert_allclose(fit, found, rtol=0, atol=1e-10)
    np.testing.assert_allclose(off, left, rtol=0, atol=1e-10)
    np.testing.assert_allclose(weight, expected, rtol=0, atol=1e-8)
