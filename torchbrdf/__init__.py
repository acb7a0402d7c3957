"""torchbrdf: fit BRDF models to measured materials, and measure how far apart two materials look.

The parts are imported at first use, so that `import torchbrdf.losses` costs no more than torch.
"""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

__version__ = "0.1.0"

if TYPE_CHECKING:
    from torchbrdf.export.convert import convert
    from torchbrdf.fitting import FitResult, fit
    from torchbrdf.lobes import FitRecord, Lobe, Sum, model_of, read_fits, write_fits
    from torchbrdf.losses import Loss, Problem
    from torchbrdf.measured import Measured, load, load_all
    from torchbrdf.pairs import Pairs
    from torchbrdf.recipe import Recipe, run
    from torchbrdf.render import Environment, Scene
    from torchbrdf.report.compare import compare
    from torchbrdf.report.match import match

_HOME = {
    "Pairs": "pairs",
    "Lobe": "lobes",
    "Sum": "lobes",
    "FitRecord": "lobes",
    "model_of": "lobes",
    "read_fits": "lobes",
    "write_fits": "lobes",
    "Loss": "losses",
    "Problem": "losses",
    "Measured": "measured",
    "load": "measured",
    "load_all": "measured",
    "fit": "fitting",
    "FitResult": "fitting",
    "Scene": "render",
    "Environment": "render",
    "Recipe": "recipe",
    "run": "recipe",
    "convert": "export.convert",
    "compare": "report.compare",
    "match": "report.match",
}
__all__ = [
    "Environment",
    "FitRecord",
    "FitResult",
    "Lobe",
    "Loss",
    "Measured",
    "Pairs",
    "Problem",
    "Recipe",
    "Scene",
    "Sum",
    "compare",
    "convert",
    "fit",
    "load",
    "load_all",
    "match",
    "model_of",
    "read_fits",
    "run",
    "write_fits",
]

__getattr__, __dir__ = exports(__name__, _HOME)
