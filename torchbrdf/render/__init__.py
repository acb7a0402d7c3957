"""What is drawn, how it is seen, and what lights it: pictures of BRDFs, and pictures as a loss."""

from torchbrdf.render.cache import cache_folder
from torchbrdf.render.draw import render
from torchbrdf.render.environment import Environment
from torchbrdf.render.lamps import DirectionalLight, PointLight, parse_lamp
from torchbrdf.render.mesh import Mesh, blob, find_mesh, sphere
from torchbrdf.render.raster import View
from torchbrdf.render.rendered import RenderedLoss
from torchbrdf.render.scene import Scene
from torchbrdf.render.transport import Transport

__all__ = [
    "DirectionalLight",
    "Environment",
    "Mesh",
    "PointLight",
    "RenderedLoss",
    "Scene",
    "Transport",
    "View",
    "blob",
    "cache_folder",
    "find_mesh",
    "parse_lamp",
    "render",
    "sphere",
]
