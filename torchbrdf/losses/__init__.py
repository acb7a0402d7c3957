"""How values on Pairs are compared: formulas, and a learned metric. A loss a file. Importing them costs little."""

from torchbrdf.losses import functional
from torchbrdf.losses.base import LOSSES, Loss
from torchbrdf.losses.combined import CombinedLoss
from torchbrdf.losses.compressed import CompressedLoss
from torchbrdf.losses.cosine import CosineRMSLoss
from torchbrdf.losses.cube_root import CubeRootLoss
from torchbrdf.losses.function import FunctionLoss, as_loss, make_loss
from torchbrdf.losses.image import ImageLoss
from torchbrdf.losses.learned import LearnedLoss
from torchbrdf.losses.log import LogLoss
from torchbrdf.losses.problem import Problem
from torchbrdf.losses.rms import RMSLoss
from torchbrdf.losses.solid_angle import SolidAngleCosineRMSLoss

__all__ = [
    "LOSSES",
    "CombinedLoss",
    "CompressedLoss",
    "CosineRMSLoss",
    "CubeRootLoss",
    "FunctionLoss",
    "ImageLoss",
    "LearnedLoss",
    "LogLoss",
    "Loss",
    "Problem",
    "RMSLoss",
    "SolidAngleCosineRMSLoss",
    "as_loss",
    "functional",
    "make_loss",
]
