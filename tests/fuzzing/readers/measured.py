"""Measured BRDFs, fits in their place, and learned metrics."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from helpers.listed_files import (
    alta,
    angles,
    astm,
    bird,
    columns,
    cornell,
    fred,
    openmaterial,
    ssdd,
    unit_vectors,
    zemax,
)
from helpers.measured_files import anisotropic_bsdf, synthetic_bsdf, synthetic_raw, tensor_file, utia, write_raw_merl

from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_arrays import bsdf
from fuzzing.changes.of_formats import merl
from fuzzing.changes.of_json import JSON
from fuzzing.changes.of_table import TABLE
from fuzzing.readers import Reader
from fuzzing.sane import check_brdf, check_finite, check_line, check_name, check_pairs, expect, later
from torchbrdf import load
from torchbrdf.fitting.batches import Batches
from torchbrdf.fitting.result import write_fits_csv
from torchbrdf.lobes import LOBES, FitRecord, make_model, model_of, parameters, read_fits, write_fits
from torchbrdf.lobes.parts import FitFolder, Input
from torchbrdf.losses import LearnedLoss, RMSLoss
from torchbrdf.measured import describe
from torchbrdf.measured.listed import ListedFormat


def make_merl(folder: Path) -> None:
    write_raw_merl(folder / "fuzzed.binary", synthetic_raw(0))


def make_merl_single(folder: Path) -> None:
    path = write_raw_merl(folder / "fuzzed.binary", synthetic_raw(0))
    head, entries = path.read_bytes()[:12], synthetic_raw(0).astype("<f4")
    path.write_bytes(head + entries.tobytes())


def make_rgl(folder: Path) -> None:
    (folder / "fuzzed_rgb.bsdf").write_bytes(tensor_file(synthetic_bsdf()))


def make_rgl_anisotropic(folder: Path) -> None:
    (folder / "fuzzed_rgb.bsdf").write_bytes(tensor_file(anisotropic_bsdf(size=6, azimuths=5, angles=4)))


def make_spectral(folder: Path) -> None:
    fields = synthetic_bsdf()
    rgb = fields.pop("rgb")
    fields |= {"wavelengths": np.array([400, 500, 600, 700], "f4"), "spectra": rgb[:, :, [0, 1, 2, 0]]}
    (folder / "fuzzed_spec.bsdf").write_bytes(tensor_file(fields))


def make_astm(folder: Path) -> None:
    (folder / "fuzzed.astm").write_text(astm(angles(20)))


def make_alta(folder: Path) -> None:
    (folder / "fuzzed.alta").write_text(alta(angles(20), vs=1))


def make_alta_binary(folder: Path) -> None:
    (folder / "fuzzed.alta").write_bytes(alta(angles(20), name="CARTESIAN", place=unit_vectors, order="little"))


def make_openmaterial(folder: Path) -> None:
    (folder / "fuzzed.xompt").write_text(openmaterial(angles(30)))


def make_utia(folder: Path) -> None:
    (folder / "fuzzed.bin").write_bytes(utia().astype("<f8").tobytes())


def make_grain(folder: Path) -> None:
    """Light from two azimuths, half as bright from one of them."""
    first = astm(angles(20, (20, 50)))
    start = first.index("VARS")
    rows = [line.split(",") for line in first[start:].splitlines()[2:]]
    turned = [[*row[:4], *(f"{float(value) / 2:.9g}" for value in row[4:])] for row in rows]
    for row in turned:
        row[1], row[3] = (f"{float(angle) + 1.5707963:.9g}" for angle in (row[1], row[3]))
    (folder / "fuzzed.astm").write_text(first + "\n".join(",".join(row) for row in turned) + "\n")


def make_cornell(folder: Path) -> None:
    (folder / "fuzzed.brdf").write_text(cornell(angles(20)))


def make_fred(folder: Path) -> None:
    (folder / "fuzzed.txt").write_text(fred(angles(20)))


def make_zemax(folder: Path) -> None:
    (folder / "fuzzed.bsdf").write_text(zemax())


def make_ssdd(folder: Path) -> None:
    (folder / "fuzzed.ssdd").write_text(ssdd("specular", polar=(0, 30, 60)))


def make_ssdd_binary(folder: Path) -> None:
    (folder / "fuzzed.ssdd").write_bytes(ssdd("spherical", polar=(0, 30, 60), binary=True))


def make_columns(folder: Path) -> None:
    (folder / "fuzzed.csv").write_text(columns(angles(20)))


def make_bird(folder: Path) -> None:
    (folder / "fuzzed.brdf").write_text(bird(angles(30)))


def use_listed(path: Path) -> None:
    """As others, and as `info` and a fit use it."""
    use_measured(path)
    measured = load(path)
    if isinstance(measured.source, ListedFormat):  # and not, say, one of many fits, which take long to describe
        for fact in describe(path).values():
            check_line(str(fact)[:250], "fact")
    check_finite(measured.distance_at(check_pairs()), "distance")


def use_bands(path: Path) -> None:
    """As a fit of bands uses it, and as RGB of these."""
    use_measured(path)
    use_measured(path, "keep")
    kept = load(path, dtype=torch.float64, bands="keep")
    expect(kept.has_colors, "bands without wavelengths")
    check_finite(kept.to_rgb().at(check_pairs()), "colours")
    check_finite(torch.tensor(kept.luminance_shares), "luminance")


def use_measured(path: Path, bands: str = "rgb") -> None:
    """As a fit and a picture use it: some samples, and values anywhere."""
    measured = load(path, dtype=torch.float64, bands=bands)
    for name in measured.names:
        check_name(name, "name")
    sampled = measured.batch(range(min(2, len(measured))), samples=torch.arange(min(300, measured.pairs.shape[-1])))
    valid = sampled.weight > 0
    check_finite(sampled.weight, "weight")
    check_finite(sampled.values[valid.expand_as(sampled.values)], "values")
    found = sampled.at(check_pairs())
    check_finite(found, "at")
    if measured.source.format.startswith("merl"):  # others may be below 0: colours out of gamut, published fits
        check_brdf(found, "at")


def records() -> list[FitRecord]:
    """A fit with every lobe, diffuse terms beside Ward's."""
    found = []
    for k, kind in enumerate(LOBES):
        name = f"{kind}+ward" if LOBES[kind].is_diffuse else kind
        found.append(
            FitRecord(
                f"material-{k}", name, 1, parameters(make_model(name, 1)), loss="rms", strategy="global", error=0.01,
                subset_error=0.02, status="converged", reason="", starts=7, ties=1, at_bounds=["roughness[0] = 0.5"],
                seconds=0.5, max_theta=80.0, samples=200, seed=0, diffuse="45:0", iterations=12,
                errors={"rms": 0.01, "log": 0.3}, outlier=False, differences={"flip": 0.1},
                pictures={"a": {"flip": 0.2}},
            )
        )  # fmt: skip
    return found


def make_fits(folder: Path) -> None:
    write_fits(folder / "fits.json", records())


def make_bands(folder: Path) -> None:
    model = make_model("ward", 1, channels=5)
    found = [FitRecord("paint", "ward", 1, parameters(model), channels=5, wavelengths=[400.0, 450, 500, 600, 700])]
    write_fits(folder / "fits.json", found)


def make_ward(folder: Path) -> None:
    write_fits(folder / "fits.json", [record for record in records() if record.model == "ward"])


def use_fits(path: Path) -> None:
    """As pages and tables use it: names, numbers, each model's values, and the files again."""
    found = read_fits(path)
    pairs = check_pairs().to(dtype=torch.float32)
    for record in found:
        check_name(record.material, "material")
        for name in ("model", "loss", "strategy", "status", "diffuse"):
            check_line(getattr(record, name), name)
        expect(record.error != float("inf"), "error is infinite")
        with later(), torch.no_grad():
            check_finite(model_of([record])(pairs), "values of the model")
    folder = path if path.is_dir() else path.parent
    write_fits(folder / "again.json", found)
    write_fits_csv(folder / "again.csv", found)
    again = [record.material for record in read_fits(folder / "again.json")]
    expect(again == [record.material for record in found], "written again it is another")


def use_continued(path: Path) -> None:
    """As a fit that is taken up uses it."""
    batches = Batches(make_model("ward", 1), RMSLoss(), out=path.parent, samples=200, max_theta=80.0, seed=0)
    for name, record in batches.done.items():
        check_name(name, "material")
        expect((record.model, record.lobes, record.loss) == ("ward", 1, "rms"), "another fit was taken up")


def make_parts(folder: Path) -> None:
    """A folder of fits in two parts."""
    made, parts = records(), FitFolder(folder)
    parts.register({"model": "any"}, [[Input(one.material, "", "") for one in own] for own in (made[:3], made[3:])])
    parts.add(0, made[:3])
    parts.add(1, made[3:])


def use_part(path: Path) -> None:
    """A part, read with its folder."""
    use_fits(path.parent.parent)


def make_metric(folder: Path) -> None:
    bundled = files("torchbrdf.assets") / "learned_metric.json"
    (folder / "metric.json").write_bytes(bundled.read_bytes())


def use_metric(path: Path) -> None:
    """Distances of two materials, and of one from itself."""
    loss, pairs = LearnedLoss("none", weights=path), check_pairs()
    values = torch.linspace(0.01, 2, 3 * len(pairs), dtype=torch.float64).reshape(1, -1, 3)
    far, none = loss(values, values.flip(1), pairs), loss(values, values, pairs)
    check_finite(far, "distance")
    expect(bool((far >= 0).all()) and bool((none == 0).all()), "distances from itself, or below 0")
    check_line(str(loss), "repr")


READERS = (
    Reader("merl", "fuzzed.binary", make_merl, use_measured, (merl,), share=0.2, renamed=True),
    Reader("merl_single", "fuzzed.binary", make_merl_single, use_measured, (merl,), share=0.1, renamed=True),
    Reader("rgl", "fuzzed_rgb.bsdf", make_rgl, use_measured, (bsdf, bsdf), renamed=True),
    Reader("rgl-anisotropic", "fuzzed_rgb.bsdf", make_rgl_anisotropic, use_measured, (bsdf, bsdf), renamed=True),
    Reader("alta", "fuzzed.alta", make_alta, use_listed, (*TABLE, *TEXT), renamed=True),
    Reader("alta-binary", "fuzzed.alta", make_alta_binary, use_listed, TEXT, renamed=True),
    Reader("rgl-spectral", "fuzzed_spec.bsdf", make_spectral, use_bands, (bsdf, bsdf), renamed=True),
    Reader("astm", "fuzzed.astm", make_astm, use_listed, (*TEXT, *TABLE), renamed=True),
    Reader("astm-grain", "fuzzed.astm", make_grain, use_listed, (*TEXT, *TABLE), renamed=True),
    Reader("bird", "fuzzed.brdf", make_bird, use_listed, (*JSON, *TEXT), renamed=True),
    Reader("columns", "fuzzed.csv", make_columns, use_listed, (*TABLE, *TEXT), renamed=True),
    Reader("cornell", "fuzzed.brdf", make_cornell, use_listed, TEXT, renamed=True),
    Reader("cornell-bands", "fuzzed.brdf", make_cornell, use_bands, TEXT, renamed=True),
    Reader("fred", "fuzzed.txt", make_fred, use_listed, TEXT, renamed=True),
    Reader("ssdd", "fuzzed.ssdd", make_ssdd, use_listed, TEXT, renamed=True),
    Reader("ssdd-binary", "fuzzed.ssdd", make_ssdd_binary, use_listed, TEXT, renamed=True),
    Reader("openmaterial", "fuzzed.xompt", make_openmaterial, use_listed, (*JSON, *TEXT), renamed=True),
    Reader("utia", "fuzzed.bin", make_utia, use_listed, (), share=0.3, renamed=True),
    Reader("zemax", "fuzzed.bsdf", make_zemax, use_listed, TEXT, renamed=True),
    Reader("fits", "fits.json", make_fits, use_fits, (*JSON, *TEXT)),
    Reader("standins", "fits.json", make_fits, use_measured, (*JSON, *TEXT)),
    Reader("fits-bands", "fits.json", make_bands, use_bands, (*JSON, *TEXT)),
    Reader("continued", "fits.json", make_ward, use_continued, (*JSON, *TEXT)),
    Reader("manifest", "manifest.json", make_parts, use_fits, (*JSON, *TEXT), share=0.5),
    Reader("parts", "fits/part-00000.jsonl", make_parts, use_part, TEXT, share=0.5),
    Reader("metric", "metric.json", make_metric, use_metric, (*JSON, *TEXT)),
)
