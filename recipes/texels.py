"""A made-up surface whose maps are known: photographed under many lights, fitted texel by texel, and lit anew."""

from dataclasses import dataclass, field
from pathlib import Path

from torchbrdf.errors import UsageError
from torchbrdf.recipe import RECIPES, Recipe, RunFolder


@RECIPES.register("texels")
@dataclass(frozen=True)
class Texels(Recipe):
    """Make up a surface, photograph it under many lights with noise, fit a GGX lobe and diffuse to every texel."""

    name = "texels"

    size: int = field(default=512, metadata={"help": "texels of a side", "low": 16, "high": 8192})
    lights: int = field(default=64, metadata={"help": "lights, evenly over a dome", "low": 4, "high": 1024})
    max_theta: float = field(
        default=70.0, metadata={"help": "how far from the camera lights are, degrees", "low": 10, "high": 80}
    )
    noise: float = field(
        default=0.01, metadata={"help": "of photographs, as a share of the value", "low": 0, "high": 1}
    )
    floor: float = field(default=0.001, metadata={"help": "noise without light", "low": 1e-6, "high": 1})
    smoothness: float = field(
        default=0.0, metadata={"help": "what differences of neighbours cost, such as 1e-3", "low": 0, "high": 1e6}
    )
    tile: int = field(default=64, metadata={"help": "texels of a side of a tile", "low": 8, "high": 512})
    formats: tuple[str, ...] = field(default=("exr", "png"), metadata={"help": "of the maps: exr, png, zarr"})

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.formats:
            if name not in ("exr", "png", "zarr"):
                raise UsageError(f"{self.name}: formats: expected exr, png or zarr, found {name!r}")

    def steps(self, folder: RunFolder) -> Path:
        """Surface, photographs, fits, report."""
        from torchbrdf.report import write_texels_report
        from torchbrdf.texels import dome, fit_texels, synthetic_surface

        size, count = (min(self.size, 48), min(self.lights, 32)) if self.quick else (self.size, self.lights)
        surface, lights = synthetic_surface(size, self.seed), dome(count, self.max_theta)
        camera = surface.camera(lights, self.noise, self.floor, self.seed)
        maps = fit_texels(
            camera,
            lights,
            normals=surface.normals,
            smoothness=self.smoothness,
            size=(size, size),
            tile=min(self.tile, 24) if self.quick else self.tile,
            out=folder.path / "maps",
            formats=self.formats,
            progress=folder.progress("texels"),
        )
        folder.log(", ".join(f"{count} {name.lower()}" for name, count in maps.counts().items()))
        return write_texels_report(folder.path, maps, camera)
