"""What is read: for each reader valid files of our own, and a use of what was read."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path

from fuzzing.changes import Change

MODULES = ("measured", "tables", "pictures", "people", "runs", "texels")


@dataclass(frozen=True)
class Reader:
    """A reader and how it is tried.

    Args:
        name: What it is called in reports.
        file: What is changed, in the folder.
        make: Writes valid files into a folder.
        use: Reads the file at a path, uses what was read, and raises InsaneError if that cannot be.
        changes: What is done to the file, beside changes of bytes.
        share: How many inputs it gets, in units of most readers'.
        named: What messages have to say; by default the file's name.
        renamed: Whether the file may have any name.
        is_file: Whether it is read as a file, and so may be none.
    """

    name: str
    file: str
    make: Callable[[Path], None]
    use: Callable[[Path], None]
    changes: tuple[Change, ...] = field(default=())
    share: float = 1.0
    named: str = ""
    renamed: bool = False
    is_file: bool = True


@cache
def readers() -> dict[str, Reader]:
    """All readers, by name."""
    found = [reader for name in MODULES for reader in import_module(f"fuzzing.readers.{name}").READERS]
    return {reader.name: reader for reader in found}


# Without the imports that readers need, so that asking for names is quick.
NAMES = (
    *("merl", "rgl", "alta", "alta-binary", "astm", "bird", "columns", "cornell", "fred", "openmaterial", "zemax"),
    *("astm-grain", "utia", "merl_single", "rgl-anisotropic", "ssdd", "ssdd-binary"),
    *("fits", "standins", "continued", "manifest", "parts", "metric", "rgl-spectral", "cornell-bands", "fits-bands"),
    *("hdr", "exr", "exr-plain", "obj", "ply", "stl", "glb", "off"),
    *("study", "png", "store", "answers", "opinions", "jod", "ratings", "triplets", "discrimination", "published"),
    *("mat", "factors", "trainings", "distances", "cache", "recipe", "asked", "asked-fits", "settings", "lights"),
    *("fourier", "fourier-gz", "klems", "lighttools", "mbsdf", "speos", "speos-binary", "speos-brdf", "tensor-tree"),
    "stack",
)
