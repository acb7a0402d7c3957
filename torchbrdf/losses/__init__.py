"""How values on Pairs are compared: formulas, and a learned metric. A loss a file. Importing them costs little."""

from torchbrdf.losses.base import LOSSES, LeastSquares, Loss, Problem
from torchbrdf.losses.compressed import CompressedLoss
from torchbrdf.losses.cosine import CosineRMSLoss
from torchbrdf.losses.cube_root import CubeRootLoss
from torchbrdf.losses.grouped import GroupedLoss, Grouping
from torchbrdf.losses.learned import LearnedLoss
from torchbrdf.losses.log import LogLoss
from torchbrdf.losses.observed import ObservedLoss
from torchbrdf.losses.rms import RMSLoss
from torchbrdf.losses.solid_angle import SolidAngleCosineRMSLoss

__all__ = [
    "LOSSES",
    "CompressedLoss",
    "CosineRMSLoss",
    "CubeRootLoss",
    "GroupedLoss",
    "Grouping",
    "LearnedLoss",
    "LeastSquares",
    "LogLoss",
    "Loss",
    "ObservedLoss",
    "Problem",
    "RMSLoss",
    "SolidAngleCosineRMSLoss",
]
