"""`torchbrdf render`."""

from torchbrdf.cli.common import Commands, Options, described, load_files
from torchbrdf.errors import UsageError

DESCRIPTION = """\
Draw measured BRDFs, or the fits of a fits.json, under a light probe, to PNG (and linear EXR) files.

  torchbrdf render nickel.binary --out pictures/
  torchbrdf render fits/fits.json --environment rnl_probe.hdr --shape sphere --rotate 15
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("render", help="draw measured BRDFs or fits"), DESCRIPTION)
    parser.add_argument("files", nargs="+", help="measured BRDFs, or a fits.json")
    parser.add_argument(
        "--environment", default="grove", help="grove (default), studio, none, or .exr or .hdr: lat-long or angular map"
    )
    parser.add_argument("--shape", default="blob", help="blob (default), sphere, or a mesh file")
    parser.add_argument("--rotate", type=float, default=0.0, help="turn the view by so many degrees (default 0)")
    parser.add_argument("--elevation", type=float, default=0.0, help="degrees to look down from (default 0)")
    parser.add_argument("--size", type=int, default=400, help="pixels of a side (default 400)")
    parser.add_argument(
        "--lamp", action="append", default=[], help="directional:X,Y,Z:COLOR or point:X,Y,Z:COLOR; may come again"
    )
    parser.add_argument("--shadows", action="store_true", help="the object casts shadows on itself (needs embreex)")
    parser.add_argument(
        "--backend", default="auto", help="pyrender (OpenGL), software, or auto (default): OpenGL where it works"
    )
    parser.add_argument("--out", default=".", help="folder for the pictures (default: here)")
    parser.set_defaults(command=command)


def command(options: Options) -> int:
    """`torchbrdf render`."""
    from torchbrdf.files import writable
    from torchbrdf.images import ToneMap, composite, write_exr, write_png
    from torchbrdf.render import Camera, Environment, Scene, find_mesh, parse_light, render

    out = writable(options.out)
    if options.environment == "none" and not options.lamp:
        raise UsageError("render: expected an environment or a lamp, found neither")
    light = None if options.environment == "none" else Environment.find(options.environment)
    scene = Scene(
        find_mesh(options.shape),
        Camera(options.rotate, elevation=options.elevation),
        light,
        size=options.size,
        punctual_lights=[parse_light(text) for text in options.lamp],
        shadows=options.shadows,
        backend=options.backend,
    )
    groups, complete = load_files(options.files)
    for group in groups:
        pictures = render(group, scene)
        tone = ToneMap.from_images(pictures, scene.mask.expand(pictures.shape[:-1]))
        for name, picture in zip(group.names, pictures, strict=True):
            path = out / f"{name}.png"
            write_png(path, composite(tone(picture), scene.coverage))
            write_exr(path.with_suffix(".exr"), picture)
            print(path)
    return 0 if complete else 1
