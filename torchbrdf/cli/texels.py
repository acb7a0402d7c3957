"""`torchbrdf texels`."""

from typing import TYPE_CHECKING

from torchbrdf import bounds
from torchbrdf.cli.common import Commands, Options, described, number, say, whole
from torchbrdf.cli.many import check_device
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import UsageError, shown
from torchbrdf.kinds import LOSSES, check_model

if TYPE_CHECKING:
    from torchbrdf.lobes import Lobe

DESCRIPTION = """\
Fit a model to every texel of a surface that was photographed under known lights, and write maps.

  torchbrdf texels lights.csv --normals normals.exr --out maps/
  torchbrdf texels lights.csv --saturation 0.98 --shadow 0.002 --hold f0 --smoothness 1e-3

lights.csv has a line for each light: the columns file (a linear OpenEXR or Radiance picture beside the table), x, y, z
(the direction to the light; z is to the camera), and irradiance, or r, g and b, if they are not 1. A texel is seen as
f cos_i times irradiance. Run it again with the same settings and folder, and it takes up what is finished.
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("texels", help="fit every texel of a photometric stack"), DESCRIPTION)
    parser.add_argument("lights", help="the table of lights and pictures")
    parser.add_argument("--normals", help="a picture of normals, x, y, z as r, g, b from -1 to 1 (default: +z)")
    parser.add_argument("--view", default="0,0,1", metavar="X,Y,Z", help="the direction to the camera (default 0,0,1)")
    parser.add_argument("--model", default="ggx", help="a lobe, or several joined by + (default ggx)")
    parser.add_argument("--lobes", type=whole(1, 8), help="how many, of one kind (default 1)")
    parser.add_argument("--loss", default="cosine_rms", help="what is minimised (default cosine_rms)")
    parser.add_argument(
        "--hold", action="append", default=[], metavar="NAME[=VALUE]", help="a parameter that stays; may come again"
    )
    parser.add_argument("--saturation", type=number(*bounds.FINITE), help="values of at least so much do not count")
    parser.add_argument(
        "--shadow", type=number(*bounds.FINITE), help="a light under which no channel has more does not count"
    )
    parser.add_argument("--max-theta", type=number(1, 90), default=80.0, help="degrees from the normal (default 80)")
    parser.add_argument(
        "--smoothness", type=number(0, 1e6), default=0.0, help="what differences of neighbours cost (default 0)"
    )
    parser.add_argument("--tile", type=whole(8, 512), default=64, help="texels of a side of a tile (default 64)")
    parser.add_argument("--formats", default="exr,png", help="of the maps: exr, png, zarr (default exr,png)")
    parser.add_argument("--device", help="what torch works on: cpu (default), cuda, cuda:0, ...")
    parser.add_argument("--out", default="texels", help="folder for the maps (default: texels)")
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf texels`."""
    check_model(options.model)
    LOSSES.check(options.loss)
    view = _view(options.view)
    if options.device is not None:
        check_device(options.device)

    from torchbrdf.files import writable
    from torchbrdf.images import read_image
    from torchbrdf.lobes.model import lobe_count, make_model
    from torchbrdf.losses import make_loss
    from torchbrdf.texels import fit_texels
    from torchbrdf.texels.pictures import read_lights, stacked
    from torchbrdf.texels.writing import check_formats

    formats = tuple(name.strip() for name in options.formats.split(",") if name.strip())
    check_formats(formats)
    model = make_model(options.model, options.lobes or lobe_count(options.model, 1))
    held = _hold(model, options.hold)
    loss = make_loss(options.loss)
    lights = read_lights(options.lights)
    normals = None if options.normals is None else read_image(options.normals).numpy()
    out = writable(options.out)
    with stacked(lights, out, progress_bar("pictures")) as (stack, problems):
        maps = fit_texels(
            stack,
            [light.direction for light in lights],
            views=view,
            normals=normals,
            irradiance=[light.irradiance for light in lights],
            saturation=options.saturation,
            shadow=options.shadow,
            model=model,
            loss=loss,
            held=held,
            smoothness=options.smoothness,
            max_theta=options.max_theta,
            tile=options.tile,
            out=out,
            formats=formats,
            device=options.device,
            progress=progress_bar("texels"),
        )
    for name, count in maps.counts().items():
        say(f"{count:12d} texels {name.lower()}")
    say(out)
    return 1 if problems or maps.failed else 0


def _view(text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3:
        raise UsageError(f"--view: expected X,Y,Z, found {shown(text)}")
    return found


def _hold(model: "Lobe", texts: list[str]) -> list[str]:
    """Names of parameters that stay, after their values, if they have some, are set in the model."""
    from torchbrdf.lobes.parameter_dict import component_names
    from torchbrdf.texels.solve import map_names

    names, found = map_names(model), []
    where = {
        names[full]: (lobe, own)
        for lobe, owned in zip(model.components(), component_names(model), strict=True)
        for own, full in owned.items()
    }
    for text in texts:
        name, given, value = text.partition("=")
        if name not in where:
            raise UsageError(f"--hold: expected one of {', '.join(where)}, found {shown(name)}")
        lobe, own = where[name]
        if given:
            spec = lobe.parameter_specs[own]
            try:
                setattr(lobe, own, bounds.number(value, spec.lower, spec.upper))
            except UsageError as error:
                raise UsageError(f"--hold: {name}: {error}") from None
        found.append(name)
    return found
