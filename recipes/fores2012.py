"""The study of Fores, Ferwerda and Gu (2012): three models, three metrics, ten materials."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from torchbrdf.errors import UsageError
from torchbrdf.losses import LOSSES
from torchbrdf.recipe import RECIPES, Recipe, RunFolder
from torchbrdf.render import Environment, Scene, View, find_mesh
from torchbrdf.report import STANDINS, Study, ask_simulated, gather, write_report
from torchbrdf.study.simulation import NOISE

GROVE = "grove"


@RECIPES.register("fores2012")
@dataclass(frozen=True)
class Fores2012(Recipe):
    """Fit, score, draw, ask simulated observers and report.

    Its defaults are the paper's, on the bundled stand-ins and the bundled light.
    """

    name = "fores2012"

    materials: str = field(default=STANDINS, metadata={"help": "a file or a folder of measured BRDFs; or stand-ins"})
    models: tuple[str, ...] = ("ward", "cook_torrance", "ashikhmin_shirley")
    losses: tuple[str, ...] = ("rms", "cosine_rms", "cube_root")
    lobes: int = field(default=2, metadata={"help": "specular lobes; 1 also fits two and compares"})
    strategy: str = field(default="global", metadata={"help": "global finds the best fit; staged is the paper's"})
    beside: str | None = field(default="staged", metadata={"help": "another strategy to compare with, or none"})
    diffuse: str = field(default="45:0", metadata={"help": "45:0 as in the paper, or fit"})
    max_theta: float = field(default=80.0, metadata={"help": "only pairs with both directions below this angle"})
    samples: int | None = field(default=20_000, metadata={"help": "pairs that the solver sees; none: all"})
    environment: str = field(default=GROVE, metadata={"help": "grove, studio, or an .exr or .hdr light probe"})
    shape: str = field(default="blob", metadata={"help": "blob, sphere, or a mesh file"})
    size: int = field(default=400, metadata={"help": "pixels of a side"})
    turn: float = field(default=15.0, metadata={"help": "degrees between the reference's view and the fits'"})
    observers: tuple[int, ...] = field(default=(15, 20), metadata={"help": "simulated, of experiments 1 and 2"})
    noise: float = field(default=NOISE, metadata={"help": "of what simulated observers see, in Delta E"})

    # What people who are asked are told, where it is not `torchbrdf.study.plan.TEXTS`, and who may take part.
    texts: ClassVar[Mapping[str, str]] = {}
    screening: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __post_init__(self) -> None:
        for key in ("models", "losses"):
            if not getattr(self, key):
                raise UsageError(f"fores2012: {key}: expected at least one name, found none")
        if self.lobes < 1:
            raise UsageError(f"fores2012: lobes: expected at least 1, found {self.lobes}")
        if len(self.observers) != 2 or min(self.observers) < 2:
            raise UsageError(f"fores2012: observers: expected two numbers, at least 2 each, found {self.observers}")
        if not self.noise > 0:
            raise UsageError(f"fores2012: noise: expected a number above 0, found {self.noise}")
        if not 16 <= self.size <= 4096:
            raise UsageError(f"fores2012: size: expected 16 to 4096 pixels, found {self.size}")

    def steps(self, folder: RunFolder) -> Path:
        """Fits, pictures, observers, report."""
        mesh, environment = find_mesh(self.shape), Environment.find(self.environment)
        size = min(self.size, 96) if self.quick else self.size
        scene, turned = (Scene(mesh, View(turn), environment, size=size) for turn in (0.0, self.turn))
        groups, bad = gather(self.materials, folder, self.quick)
        samples = min(self.samples or 4000, 4000) if self.quick else self.samples
        study = Study(
            folder=folder,
            groups=groups,
            models=self.models,
            losses={LOSSES.canonical(name): LOSSES[name]() for name in self.losses},
            lobes=(1, 2) if self.lobes == 1 else (self.lobes,),
            strategy=self.strategy,
            beside=self.beside,
            diffuse=self.diffuse,
            max_theta=self.max_theta,
            samples=samples,
            seed=self.seed,
        )
        study.fit()
        study.draw(scene, turned)
        asked = ask_simulated(study, (self.observers[0], self.observers[1]), self.noise, self.texts, self.screening)
        light = "Light: " + (
            "the project's own grove." if self.environment == GROVE else Path(self.environment).name + "."
        )
        return write_report(study, "Which error metric looks right?", light, self.turn, bad, asked)
