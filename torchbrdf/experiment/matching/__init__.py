"""The simplest model that looks like a measurement: candidates, scenes that judge them, and the choice."""

from torchbrdf.experiment.matching.candidates import BUDGETS, Budget, Candidate, candidates_for, find_budget
from torchbrdf.experiment.matching.judge import Figures, Judge
from torchbrdf.experiment.matching.search import Match, Tried, find_matches

__all__ = [
    "BUDGETS",
    "Budget",
    "Candidate",
    "Figures",
    "Judge",
    "Match",
    "Tried",
    "candidates_for",
    "find_budget",
    "find_matches",
]
