"""Fitting models to measured materials: strategies, the batched solver, scores, results."""

from torchbrdf.fitting.fit import fit, stratified
from torchbrdf.fitting.lbfgs import Solution, Status, minimize
from torchbrdf.fitting.result import FitResult, write_csv
from torchbrdf.fitting.score import local_minima, score
from torchbrdf.fitting.strategy import STRATEGIES

__all__ = [
    "STRATEGIES",
    "FitResult",
    "Solution",
    "Status",
    "fit",
    "local_minima",
    "minimize",
    "score",
    "stratified",
    "write_csv",
]
