"""What is drawn, how it is seen, and what lights it: pictures of BRDFs, and pictures as a loss."""

from torchbrdf.render.draw import render
from torchbrdf.render.light.environment import Environment
from torchbrdf.render.light.punctual import DirectionalLight, PointLight, parse_light
from torchbrdf.render.loss import RenderedLoss
from torchbrdf.render.raster.camera import Camera
from torchbrdf.render.raster.mesh import Mesh, blob, find_mesh, sphere
from torchbrdf.render.scene import Scene, small_scene
from torchbrdf.render.side_by_side import SideBySide
from torchbrdf.render.transport.cache import cache_folder
from torchbrdf.render.transport.transport import Transport
from torchbrdf.render.unseen import unseen_scenes

__all__ = [
    "Camera",
    "DirectionalLight",
    "Environment",
    "Mesh",
    "PointLight",
    "RenderedLoss",
    "Scene",
    "SideBySide",
    "Transport",
    "blob",
    "cache_folder",
    "find_mesh",
    "parse_light",
    "render",
    "small_scene",
    "sphere",
    "unseen_scenes",
]
