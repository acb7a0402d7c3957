"""Analytic metrics beside rendered-image loss: what fits under each look like, in scenes seen and unseen."""

from dataclasses import dataclass, field
from pathlib import Path

from torchbrdf.errors import UsageError
from torchbrdf.images import DIFFERENCES
from torchbrdf.losses import LOSSES, Loss
from torchbrdf.recipe import RECIPES, Recipe, RunFolder
from torchbrdf.render import Environment, RenderedLoss, Scene, View, find_mesh
from torchbrdf.report import STANDINS, Gallery, Study, gather, write_images_report

TRAINING, UNSEEN = "training", "unseen"


@RECIPES.register("image_vs_analytic")
@dataclass(frozen=True)
class ImageVsAnalytic(Recipe):
    """Fit every material and model under every loss, analytic and rendered, and compare the pictures."""

    name = "image_vs_analytic"

    materials: str = field(default=STANDINS, metadata={"help": "a file or a folder of measured BRDFs; or stand-ins"})
    models: tuple[str, ...] = ("ward", "cook_torrance", "ashikhmin_shirley")
    losses: tuple[str, ...] = ("rms", "cosine_rms", "cube_root", "compressed", "log")
    rendered: tuple[str, ...] = field(
        default=("log_hdr", "delta_e"), metadata={"help": "image differences that are losses, too"}
    )
    differences: tuple[str, ...] = field(
        default=("delta_e", "delta_e2000", "flip", "ssim", "psnr", "log_hdr"),
        metadata={"help": "image differences that fits are judged by"},
    )
    lobes: int = field(default=2, metadata={"help": "specular lobes"})
    strategy: str = "global"
    diffuse: str = field(default="fit", metadata={"help": "fit: every loss chooses its own; or 45:0"})
    max_theta: float = field(default=80.0, metadata={"help": "analytic losses: only pairs below this angle"})
    samples: int | None = field(default=20_000, metadata={"help": "analytic losses: pairs that the solver sees"})
    environment: str = field(default="grove", metadata={"help": "training scene: grove, studio, or a light probe"})
    shape: str = field(default="blob", metadata={"help": "training scene: blob, sphere, or a mesh file"})
    train_size: int = field(default=128, metadata={"help": "pixels of a side that rendered losses see"})
    lights: int = field(default=1024, metadata={"help": "lights that rendered losses see"})
    unseen_environment: str = field(default="studio", metadata={"help": "the scene that no fit was made for"})
    unseen_shape: str = "sphere"
    unseen_turn: float = field(default=140.0, metadata={"help": "degrees"})
    unseen_elevation: float = field(default=20.0, metadata={"help": "degrees"})
    size: int = field(default=256, metadata={"help": "pixels of a side of the pictures that are compared"})

    def __post_init__(self) -> None:
        for key in ("models", "losses", "rendered", "differences"):
            if not getattr(self, key):
                raise UsageError(f"{self.name}: {key}: expected at least one name, found none")
        if "delta_e" not in self.differences:
            raise UsageError(f"{self.name}: differences: expected delta_e among them, by which the report sorts")
        for key in (*self.rendered, *self.differences):
            least = DIFFERENCES[key].least_side
            sizes = {"train_size": self.train_size} if key in self.rendered else {}
            for name, size in {**sizes, "size": self.size}.items():
                if not max(least, 16) <= size <= 4096:
                    raise UsageError(f"{self.name}: {name}: {key} needs {max(least, 16)} to 4096 pixels, found {size}")

    def steps(self, folder: RunFolder) -> Path:
        """References and tone maps, fits, pictures, report."""
        size, train, lights = self.size, self.train_size, self.lights
        samples, models, rendered = self.samples, self.models, self.rendered
        if self.quick:
            size, train, lights, samples = min(size, 48), min(train, 32), 128, min(samples or 4000, 4000)
            models, rendered = models[:1], rendered[-1:]
        groups, bad = gather(self.materials, folder, self.quick)
        light, mesh = Environment.find(self.environment), find_mesh(self.shape)
        turned = View(self.unseen_turn, elevation=self.unseen_elevation)
        other = find_mesh(self.unseen_shape), turned, Environment.find(self.unseen_environment)
        scenes = {TRAINING: Scene(mesh, View(), light, size=size), UNSEEN: Scene(*other, size=size)}
        losses: dict[str, Loss] = {LOSSES.canonical(name): LOSSES[name]() for name in self.losses}
        study = Study(
            folder=folder,
            groups=groups,
            models=models,
            losses=losses,
            lobes=(self.lobes,),
            strategy=self.strategy,
            diffuse=self.diffuse,
            max_theta=self.max_theta,
            samples=samples,
            seed=self.seed,
        )
        small = Scene(mesh, View(), light, size=train, lights=lights, cache=folder.path / "cache")
        gallery = Gallery(study, scenes, self.differences)
        gallery.draw_references()
        for name in rendered:
            loss = RenderedLoss(small, name, tone=gallery.tones[TRAINING])
            losses[loss.registered_name] = loss
        study.fit()
        gallery.draw_fits()
        said = {
            TRAINING: f"{self.shape}, {self.environment}",
            UNSEEN: f"{self.unseen_shape}, {self.unseen_environment}, turned by {self.unseen_turn:g}° and from above",
        }
        used = f"{train} x {train} pixels, {small.nodes} directions around the mirror's and {lights} lights a pixel"
        return write_images_report(gallery, said, used, bad)
