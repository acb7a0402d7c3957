"""What this machine offers: Python, torch, and what pictures are made with."""

import importlib.metadata
import importlib.util
import platform

import torch

from torchbrdf.render.raster.backends import find_opengl


def system_facts() -> dict[str, object]:
    """Name -> what was found."""
    found = find_opengl()
    cuda = torch.cuda.get_device_name() if torch.cuda.is_available() else "not available"
    return {
        "python": f"{platform.python_version()}, {platform.platform()}",
        "torch": f"{torch.__version__}, {torch.get_num_threads()} threads",
        "cuda": cuda,
        "pyrender": _version("pyrender"),
        "opengl": found.renderer or f"does not work: {found.reason}",
        "embreex": _version("embreex"),
    }


def _version(package: str) -> str:
    """Of what is installed, without importing it."""
    if importlib.util.find_spec(package) is None:
        return "not installed"
    return importlib.metadata.version(package)
