"""ColorVideoVDP, an extra, for tests."""

import importlib
import importlib.util
from types import ModuleType

import pytest
import torch

# Kept: what a library of operators defines goes with it.
_kept: list[torch.library.Library] = []


def color_video_vdp() -> ModuleType:
    """The library; skips the test if it is not installed.

    It imports torchvision for a blur. PyPI's has compiled operators for CUDA, which do not load beside a torch without
    CUDA, and then the import fails for want of two of their names. None is called: names are enough.
    """
    if importlib.util.find_spec("pycvvdp") is None:
        pytest.skip("needs cvvdp: pip install torchbrdf[cvvdp]")
    try:
        importlib.import_module("torchvision")
    except RuntimeError:
        names = torch.library.Library("torchvision", "FRAGMENT")
        for name in ("nms", "qnms"):
            names.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        _kept.append(names)
    return importlib.import_module("pycvvdp")
