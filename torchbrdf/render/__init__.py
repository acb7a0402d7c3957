"""What is drawn, how it is seen, and what lights it: pictures of BRDFs, in software."""

from torchbrdf.render.draw import render
from torchbrdf.render.environment import Environment
from torchbrdf.render.mesh import Mesh, blob, find_mesh, sphere
from torchbrdf.render.raster import View
from torchbrdf.render.scene import Scene, Transport

__all__ = ["Environment", "Mesh", "Scene", "Transport", "View", "blob", "find_mesh", "render", "sphere"]
