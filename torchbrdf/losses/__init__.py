"""How values on Pairs are compared: analytic losses. A loss a file. Importing them costs no more than torch."""

from torchbrdf.losses.base import LOSSES, LeastSquares, Loss, Problem
from torchbrdf.losses.compressed import CompressedLoss
from torchbrdf.losses.cosine import CosineRMSLoss
from torchbrdf.losses.cube_root import CubeRootLoss
from torchbrdf.losses.log import LogLoss
from torchbrdf.losses.observed import ObservedLoss
from torchbrdf.losses.rms import RMSLoss
from torchbrdf.losses.solid_angle import SolidAngleCosineRMSLoss

__all__ = [
    "LOSSES",
    "CompressedLoss",
    "CosineRMSLoss",
    "CubeRootLoss",
    "LeastSquares",
    "LogLoss",
    "Loss",
    "ObservedLoss",
    "Problem",
    "RMSLoss",
    "SolidAngleCosineRMSLoss",
]
