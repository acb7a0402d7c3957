"""The simplest model that looks like a measurement: candidates, scenes that judge them, and the choice."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
    from torchbrdf.experiment.matching.candidates import BUDGETS, Budget, Candidate, candidates_for, find_budget
    from torchbrdf.experiment.matching.judge import Figures, Judge
    from torchbrdf.experiment.matching.search import Match, Tried, find_matches

# Imported at first use: a budget's name costs no torch.
_HOME = {
    "BUDGETS": "candidates",
    "Budget": "candidates",
    "Candidate": "candidates",
    "candidates_for": "candidates",
    "find_budget": "candidates",
    "Figures": "judge",
    "Judge": "judge",
    "Match": "search",
    "Tried": "search",
    "find_matches": "search",
}
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

__getattr__, __dir__ = exports(__name__, _HOME)
