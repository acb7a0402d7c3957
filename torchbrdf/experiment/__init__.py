"""Experiments: grids of fits, their pictures, what observers are asked about them, and what all of that says."""

from torchbrdf.experiment.grid import FitGrid
from torchbrdf.experiment.pictures import ONLY, SHOWN_DIFFERENCES, Pictures
from torchbrdf.experiment.plan import Responses, make_plan, simulate_responses
from torchbrdf.experiment.settings import STANDINS, FitGridRecipe, HumanAnswersRecipe, load_materials

__all__ = [
    "ONLY",
    "SHOWN_DIFFERENCES",
    "STANDINS",
    "FitGrid",
    "FitGridRecipe",
    "HumanAnswersRecipe",
    "Pictures",
    "Responses",
    "load_materials",
    "make_plan",
    "simulate_responses",
]
