"""Quadratic problems with bounds beside scipy's solver."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from torchbrdf.solvers import solve_bounded_qp


def linear(count, size, seed, samples=20):
    """Least-squares problems, matrices and right sides, in boxes many of whose bounds are active."""
    random = np.random.default_rng(seed)
    matrix, right = random.normal(size=(count, samples, size)), 3 * random.normal(size=(count, samples))
    return matrix, right, -random.random((count, size)) * 0.3, random.random((count, size)) * 0.3


@settings(max_examples=20, deadline=None)
@given(size=st.integers(1, 9), seed=st.integers(0, 10_000))
def test_parabolas_end_where_scipy_does(size, seed):
    matrix, right, lower, upper = linear(20, size, seed)
    gram, slope = np.einsum("kni,knj->kij", matrix, matrix), -np.einsum("kni,kn->ki", matrix, right)
    found = solve_bounded_qp(gram, slope, lower, upper)
    assert ((found >= lower) & (found <= upper)).all()
    for k in range(20):
        expected = lsq_linear(matrix[k], right[k], (lower[k], upper[k]), method="bvls", tol=1e-14)
        np.testing.assert_allclose(found[k], expected.x, atol=1e-8)


def test_parabolas_of_any_leading_shape_and_singular_ones():
    matrix, right, lower, upper = linear(6, 4, 0)
    gram, slope = np.einsum("kni,knj->kij", matrix, matrix), -np.einsum("kni,kn->ki", matrix, right)
    flat = solve_bounded_qp(gram, slope, lower, upper)
    shaped = solve_bounded_qp(*(part.reshape(2, 3, *part.shape[1:]) for part in (gram, slope, lower, upper)))
    np.testing.assert_array_equal(shaped.reshape(6, 4), flat)
    gram[0] = 0
    gram[1] = np.nan
    assert np.isfinite(solve_bounded_qp(gram, slope, lower, upper)).all()
    np.testing.assert_array_equal(solve_bounded_qp(gram, slope, lower, upper)[2:], flat[2:])
