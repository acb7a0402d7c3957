"""`export`: one call from a fit or a measured file to a material that a renderer reads."""

import copy
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from torchbrdf.errors import DataError, TorchbrdfError, UsageError, shown
from torchbrdf.export.bands import in_rgb
from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, refuse_grain
from torchbrdf.export.tables import TableExporter, reach
from torchbrdf.files import writable
from torchbrdf.lobes import FitRecord, Lobe, read_fits
from torchbrdf.lobes.parameter_dict import get_parameters, named_specs, outside_bounds
from torchbrdf.measured import Measured, StandIn, load
from torchbrdf.measured.bands import DEFAULT_ILLUMINANT, KEEP
from torchbrdf.measured.find import find_files, format_of
from torchbrdf.measured.load import check_settings
from torchbrdf.measured.standin import is_rgb
from torchbrdf.measured.tables import check_rgb
from torchbrdf.names import check_name, clean_name
from torchbrdf.render import Mesh, find_mesh

# Of what is given without one.
NAMELESS = "material"
# The list of `match`, whose page and numbers are of the files that it wrote itself.
MATCHES = "match.json"


def export(
    brdf: Brdf | FitRecord | str | os.PathLike[str],
    to: str,
    out: str | os.PathLike[str],
    *,
    name: str | None = None,
    mesh: Mesh | str | os.PathLike[str] | None = None,
    settings: Mapping[str, str] | None = None,
) -> Exported:
    """Write a BRDF as a material of a renderer.

    Args:
        brdf: A lobe or a sum of lobes, not batched; a `Measured` of one material; a record of a fit; or the path of a
            file with one of either.
        to: For what: a registered exporter, such as "mitsuba" or "pbrt".
        out: The folder, which is made if it is not there.
        name: Of the material and its files; by default that of the record or the measurement.
        mesh: The object that wears the material, where an object is written, too ("gltf"): a mesh, "blob", "sphere", or
            a file.
        settings: What a file does not say and its reader is to take, as of `torchbrdf.load`; of a fit in bands also the
            `illuminant` under which it becomes linear RGB.

    Returns:
        The files, whether they are exact, notes on what was refitted or written as a table, and the BRDF that will be
        seen.

    Raises:
        UsageError: There is no such exporter, the model is batched or the Measured has several materials, or the
            exporter writes no mesh or needs a package that is not installed.
        DataError: The file or the folder cannot be read or written, a parameter lies outside its bounds, or the
            exporter cannot show such a material.

    Example:
        >>> from torchbrdf.export import export
        >>> from torchbrdf.lobes import Lambert
        >>> done = export(Lambert(albedo=0.5), "mitsuba", "out", name="chalk")
        >>> [path.name for path in done.files], done.exact
        (['chalk.xml'], True)
    """
    exporter = find_exporter(to, find_mesh(os.fspath(mesh)) if isinstance(mesh, str | os.PathLike) else mesh)
    material = material_of(brdf, name, settings)
    refuse_matches(exporter, material, out)
    return write(exporter, material, out)


def find_exporter(name: str, mesh: Mesh | None = None) -> Exporter:
    """Make the exporter of a name.

    Args:
        name: Registered.
        mesh: The object, of exporters that write one.
    """
    if not isinstance(name, str):
        raise UsageError(f"to: expected one of {', '.join(EXPORTERS)}, found {shown(name)}")
    return EXPORTERS[name](mesh)


def refuse_matches(exporter: Exporter, material: Material, out: str | os.PathLike[str]) -> None:
    """Refuse to write over what `match` wrote, which its list and page would go on to describe.

    Args:
        exporter: By which it would be written.
        material: What.
        out: The folder.

    Raises:
        DataError: There is such a file.
    """
    if not (Path(out) / MATCHES).exists():
        return
    for suffix in (exporter.suffix, *exporter.beside):
        path = material.path(Path(out), suffix)
        if path.exists():
            raise DataError(f"{path}: expected another folder, found a match's file, which {MATCHES} there describes")


def write(exporter: Exporter, material: Material, out: str | os.PathLike[str]) -> Exported:
    """Write a material by an exporter, but never in the place of the file that it is made of."""
    if isinstance(exporter, TableExporter):
        material = exporter.suited(material)
    elif exporter.no_grain:
        refuse_grain(material, EXPORTERS.name_of(type(exporter)) or type(exporter).__name__, exporter.no_grain)
    if isinstance(material.brdf, Measured) and not exporter.keeps_bands:
        material.brdf.check_rgb("export")
    folder = writable(Path(out))
    for suffix in (exporter.suffix, *exporter.beside):
        path = material.path(folder, suffix)
        for source in sources(material):
            if path.exists() and source.exists() and path.samefile(source):
                raise DataError(f"{path}: expected another folder or name, found the file that is exported")
    with torch.no_grad():
        done = _written(exporter, material, folder)
    rest = [] if done.exact else reach(material.brdf)
    return replace(done, notes=[*material.notes, *done.notes, *rest])


def _written(exporter: Exporter, material: Material, folder: Path) -> Exported:
    """What an exporter wrote; whatever one of another package raises is an error that names it."""
    kind = type(exporter)
    try:
        done = exporter.write(material, folder)
    except TorchbrdfError:
        raise
    except Exception as error:
        if kind.__module__.startswith("torchbrdf."):
            raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise DataError(f"{material.name}: {kind.__name__} of {kind.__module__} failed: {reason}") from error
    if not isinstance(done, Exported):
        raise UsageError(f"{kind.__name__} of {kind.__module__}: expected to get an Exported, found {shown(done)}")
    return done


def material_of(
    brdf: Brdf | FitRecord | str | os.PathLike[str],
    name: str | None = None,
    settings: Mapping[str, str] | None = None,
) -> Material:
    """One material of whatever `export` takes.

    Args:
        brdf: As for `export`.
        name: Of the material; by default its own.
        settings: As for `export`.

    Raises:
        UsageError: It is none of what can be exported, or several materials.
        DataError: A file cannot be read, the name is none, or a parameter lies outside its bounds.
    """
    if isinstance(brdf, str | os.PathLike):
        return _of_file(Path(brdf) if os.fspath(brdf) else brdf, name, settings)
    if isinstance(brdf, FitRecord):
        own = brdf.material if name is None else check_name(name, "export: name")
        if (settings or {}).get("bands") == KEEP and not is_rgb(brdf):
            return Material(own, Measured(StandIn([brdf], [], settings)))
        shown_as, notes = in_rgb(brdf, (settings or {}).get("illuminant", DEFAULT_ILLUMINANT))
        return Material(own, _checked(shown_as, own) if isinstance(shown_as, Lobe) else shown_as, tuple(notes))
    if isinstance(brdf, Measured):
        if len(brdf) != 1:
            raise UsageError(
                f"export: expected one material, found {len(brdf)}; export each of them: measured.batch([k])"
            )
        if isinstance(brdf.source, StandIn):  # a model in a measurement's place
            own = brdf.names[0] if name is None else name
            record = brdf.source.records[brdf.materials[0]]
            found = material_of(record, clean_name(own) if name is None else own, brdf.source.told)
            return replace(found, files=tuple(_files_of(brdf)))
        own = clean_name(brdf.names[0]) if name is None else name
        return Material(own, brdf.to("cpu"), files=tuple(_files_of(brdf)))
    if isinstance(brdf, Lobe):
        own = NAMELESS if name is None else check_name(name, "export: name")
        check_rgb(brdf, own)
        return Material(own, _checked(copy.deepcopy(brdf).cpu(), own))
    raise UsageError(f"export: expected a lobe, a Measured, a FitRecord or a path, found {shown(brdf)}")


def _of_file(path: str | os.PathLike[str], name: str | None, settings: Mapping[str, str] | None) -> Material:
    """The only material of a measured file, or of a `fits.json`."""
    (file, *more) = find_files(path)
    if not more and format_of(file) == StandIn.format:
        check_settings([StandIn.format], settings)
        records = read_fits(file)
        if len(records) == 1:
            return replace(material_of(records[0], name, settings), files=(file,))
        found = f"{len(records)} fits"
    elif not more:
        measured = load(file, settings=settings)
        if len(measured) == 1:
            return material_of(measured, name)
        found = f"{len(measured)} materials"
    else:
        found = f"{1 + len(more)} files"
    raise UsageError(f"{path}: expected one material, found {found}; `torchbrdf export` takes them all")


def sources(material: Material) -> list[Path]:
    """The files that a material is read from."""
    if material.files or not isinstance(material.brdf, Measured):
        return list(material.files)
    return _files_of(material.brdf)


def _files_of(measured: Measured) -> list[Path]:
    paths = measured.source.paths
    return [paths[row] for row in measured.materials if row < len(paths)]


def _checked(model: Lobe, where: str) -> Lobe:
    """The model, if it is one material with parameters within their bounds."""
    values = get_parameters(model)
    for name, spec in named_specs(model).items():
        if values[name].dim() > len(spec.shape):
            count = values[name].shape[0]
            raise UsageError(f"{where}: expected one material, found a model of {count}; see torchbrdf.lobes.model_of")
    outside = outside_bounds(model)
    if outside:
        raise DataError(f"{where}: expected parameters within their bounds, found {outside[0]}")
    return model
