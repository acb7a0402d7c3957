"""Measured BRDFs in tables that tools of lighting and rendering write."""

from collections.abc import Callable
from pathlib import Path

from helpers.table_files import fourier, klems, lighttools, mbsdf, speos, speos_binary, speos_spectral, tensor_tree

from fuzzing.changes import Change
from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_table import TABLE
from fuzzing.changes.of_xml import XML
from fuzzing.readers import Reader
from fuzzing.readers.measured import use_listed


def maker(name: str, data: bytes | str) -> Callable[[Path], None]:
    """What writes a file with these bytes, or this text, into a folder."""

    def make(folder: Path) -> None:
        (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())

    return make


TABLES: dict[str, tuple[str, bytes | str, tuple[Change, ...]]] = {
    "fourier": ("fuzzed.bsdf", fourier(cosines=6), ()),
    "fourier-gz": ("fuzzed.bsdf.gz", fourier(cosines=6, packed=True), ()),
    "klems": ("fuzzed.xml", klems("two rings"), (*XML, *TEXT)),
    "lighttools": ("fuzzed.bsdf", lighttools(), (*TEXT, *TABLE)),
    "mbsdf": ("fuzzed.mbsdf", mbsdf(4, 5, rgb=True), ()),
    "speos": ("fuzzed.anisotropicbsdf", speos(parts=(1, 1)), TEXT),
    "speos-binary": ("fuzzed.anisotropicbsdf", speos_binary(), ()),
    "speos-brdf": ("fuzzed.brdf", speos_spectral(), TEXT),
    "tensor-tree": ("fuzzed.xml", tensor_tree(3), (*XML, *TEXT)),
}
READERS = tuple(
    Reader(name, file, maker(file, data), use_listed, changes, share=0.5, renamed=True)
    for name, (file, data, changes) in TABLES.items()
)
