"""Fitting models to measured materials: strategies, the batched solver, scores, results."""

from torchbrdf.fitting.batches import Batches
from torchbrdf.fitting.data import stratified
from torchbrdf.fitting.fit import fit
from torchbrdf.fitting.lbfgs import Solution, Status, minimize
from torchbrdf.fitting.levenberg import minimize_squares
from torchbrdf.fitting.quadratic import minimize_quadratic
from torchbrdf.fitting.result import FitResult, write_fits_csv
from torchbrdf.fitting.score import cross_score, local_minima, score
from torchbrdf.fitting.strategy import STRATEGIES

__all__ = [
    "STRATEGIES",
    "Batches",
    "FitResult",
    "Solution",
    "Status",
    "cross_score",
    "fit",
    "local_minima",
    "minimize",
    "minimize_quadratic",
    "minimize_squares",
    "score",
    "stratified",
    "write_fits_csv",
]
