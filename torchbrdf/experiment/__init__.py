"""Experiments: grids of fits, their pictures, what observers are asked about them, and what all of that says.

The parts are imported at first use: a recipe's settings cost no torch.
"""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
    from torchbrdf.experiment.grid import FitGrid
    from torchbrdf.experiment.pictures import ONLY, SHOWN_DIFFERENCES, Pictures
    from torchbrdf.experiment.plan import Responses, make_plan, simulate_responses
    from torchbrdf.experiment.settings import STANDINS, FitGridRecipe, HumanAnswersRecipe, load_materials

_HOME = {
    "FitGrid": "grid",
    "ONLY": "pictures",
    "SHOWN_DIFFERENCES": "pictures",
    "Pictures": "pictures",
    "Responses": "plan",
    "make_plan": "plan",
    "simulate_responses": "plan",
    "STANDINS": "settings",
    "FitGridRecipe": "settings",
    "HumanAnswersRecipe": "settings",
    "load_materials": "settings",
}
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

__getattr__, __dir__ = exports(__name__, _HOME)
