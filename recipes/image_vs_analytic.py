"""Analytic metrics beside losses of pictures: what fits under each look like, in scenes seen and unseen."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.errors import UsageError
from torchbrdf.experiment.settings import PICTURE_SIDES, FitGridRecipe, load_materials
from torchbrdf.kinds import DIFFERENCES, LOSSES
from torchbrdf.recipe import RECIPES, RunFolder

if TYPE_CHECKING:
    from torchbrdf.losses import Loss

TRAINING, UNSEEN = "training", "unseen"


@RECIPES.register("image_vs_analytic")
@dataclass(frozen=True)
class ImageVsAnalytic(FitGridRecipe):
    """Fit every material and model under every loss, analytic, rendered and both, and compare the pictures."""

    name = "image_vs_analytic"

    losses: tuple[str, ...] = ("rms", "cosine_rms", "cube_root", "compressed", "log", "learned")
    rendered: tuple[str, ...] = field(
        default=("log_hdr", "delta_e76"), metadata={"help": "image differences that are losses, too"}
    )
    combined: tuple[str, ...] = field(
        default=("learned",), metadata={"help": "metrics that are losses with a small rendered difference beside, too"}
    )
    chosen_by: tuple[str, ...] = field(
        default=("delta_e76",), metadata={"help": "image differences that choose among fits under several metrics"}
    )
    differences: tuple[str, ...] = field(
        default=("delta_e76", "delta_e2000", "flip", "ssim", "psnr", "log_hdr"),
        metadata={"help": "image differences that fits are judged by"},
    )
    diffuse: str = field(default="fit", metadata={"help": "fit: every loss chooses its own; or 45:0"})
    environment: str = field(default="grove", metadata={"help": "training scene: grove, studio, or a light probe"})
    shape: str = field(default="blob", metadata={"help": "training scene: blob, sphere, or a mesh file"})
    train_size: int = field(
        default=128, metadata={"help": "pixels of a side that rendered losses see", "low": 16, "high": 1024}
    )
    combined_size: int = field(
        default=24, metadata={"help": "pixels of a side that combined losses see", "low": 8, "high": 1024}
    )
    lights: int = field(default=1024, metadata={"help": "lights that rendered losses see", "low": 1, "high": 16384})
    unseen_environment: str = field(default="studio", metadata={"help": "the scene that no fit was made for"})
    unseen_shape: str = "sphere"
    unseen_turn: float = field(default=140.0, metadata={"help": "degrees", "low": -360, "high": 360})
    unseen_elevation: float = field(default=20.0, metadata={"help": "degrees", "low": -89, "high": 89})
    size: int = field(
        default=256, metadata={"help": "pixels of a side of the pictures that are compared", **PICTURE_SIDES}
    )

    def __post_init__(self) -> None:
        optional = [key for key in ("combined", "chosen_by") if getattr(self, key)]  # `combined=` is without any
        self.expect_names("rendered", *optional, "differences")
        for name in self.combined:
            LOSSES.check(name)
        for name in (*self.rendered, *self.chosen_by, *self.differences):
            DIFFERENCES.check(name)
        if "delta_e76" not in map(DIFFERENCES.canonical, self.differences):
            raise UsageError(f"{self.name}: differences: expected delta_e76 among them, by which the report sorts")
        super().__post_init__()
        for key in (*self.rendered, *self.chosen_by, *self.differences):
            least = DIFFERENCES[key].least_side
            sizes = {"train_size": self.train_size} if key in (*self.rendered, *self.chosen_by) else {}
            for name, size in {**sizes, "size": self.size}.items():
                if size < least:
                    raise UsageError(f"{self.name}: {name}: {key} needs {least} pixels of a side, found {size}")

    def steps(self, folder: RunFolder) -> Path:
        """References and tone maps, fits, pictures, report."""
        from torchbrdf.experiment import Pictures
        from torchbrdf.fitting import ImageDriven
        from torchbrdf.losses import CombinedLoss, make_loss
        from torchbrdf.render import Camera, Environment, RenderedLoss, Scene, find_mesh, small_scene
        from torchbrdf.report import write_images_report

        size, train, lights = self.size, self.train_size, self.lights
        models, rendered, chooser = self.models, self.rendered, ImageDriven()
        if self.quick:
            size, train, lights = min(size, 48), min(train, 32), 128
            own = type(self)  # what somebody asked for is not left out
            models = models[:1] if models == own.models else models
            rendered = rendered[-1:] if rendered == own.rendered else rendered
            chooser = ImageDriven(metrics=("compressed", "learned"))
        groups, bad = load_materials(self.materials, folder, self.quick)
        light, mesh = Environment.find(self.environment), find_mesh(self.shape)
        turned = Camera(self.unseen_turn, elevation=self.unseen_elevation)
        other = find_mesh(self.unseen_shape), turned, Environment.find(self.unseen_environment)
        scenes = {TRAINING: Scene(mesh, Camera(), light, size=size), UNSEEN: Scene(*other, size=size)}
        losses: dict[str, Loss] = {LOSSES.canonical(name): make_loss(name) for name in self.losses}
        grid = self.make_grid(folder, groups, losses, models=models)
        pictures = Pictures(grid, scenes, self.differences, maps=True)
        pictures.draw(fits=False)
        pictures.measure_tones(fits=False)
        small = Scene(mesh, Camera(), light, size=train, light_samples=lights, cache=folder.path / "cache")
        for name in rendered:
            loss = RenderedLoss(small, name, tone=pictures.tones[TRAINING])
            losses[loss.registered_name] = loss
        little = small_scene(mesh, light, size=self.combined_size, light_samples=lights, cache=folder.path / "cache")
        for name in self.combined:
            both = CombinedLoss(make_loss(name), RenderedLoss(little, tone=pictures.tones[TRAINING]))
            losses[both.registered_name] = both
        for name in map(DIFFERENCES.canonical, self.chosen_by):
            same = losses.get(f"rendered_{name}")
            losses[f"image_driven_{name}"] = same or RenderedLoss(small, name, tone=pictures.tones[TRAINING])
            grid.own_strategies[f"image_driven_{name}"] = chooser
        grid.fit()
        pictures.draw(materials=False)
        pictures.compare()
        said = {
            TRAINING: f"{self.shape}, {self.environment}",
            UNSEEN: f"{self.unseen_shape}, {self.unseen_environment}, turned by {self.unseen_turn:g}° and from above",
        }
        used = (
            f"Rendered-image losses and the image-driven choice saw the training scene, {train} x {train} pixels with "
            f"{small.nodes} directions around the mirror's and {lights} lights a pixel; combined losses saw it with "
            f"{little.size} x {little.size} pixels and {little.nodes} directions."
        )
        return write_images_report(pictures, said, used, bad)
