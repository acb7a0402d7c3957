"""A recipe."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from torchbrdf.lobes import LOBES
from torchbrdf.recipe import Recipe, RunFolder


@dataclass(frozen=True)
class MyRecipe(Recipe):
    """Says which lobes there are."""

    name: ClassVar[str] = "myrecipe"

    word: str = field(default="lobes", metadata={"help": "the report's heading"})

    def steps(self, folder: RunFolder) -> Path:
        """Write the names."""
        report = folder.path / "report.txt"
        names = list(LOBES)[: 3 if self.quick else None]
        report.write_text(f"{self.word}: {', '.join(names)}\n", encoding="utf-8")
        return report
