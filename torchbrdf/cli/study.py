"""`torchbrdf study`: ask people which fit looks closer, and scale what they answer."""

from contextlib import closing
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.bounds import SEEDS
from torchbrdf.cli.common import Commands, Options, described, number, whole
from torchbrdf.cli.progress import progress_bar
from torchbrdf.errors import DataError, UsageError
from torchbrdf.kinds import SCALINGS, check_word

if TYPE_CHECKING:
    from torchbrdf.study import Plan
    from torchbrdf.study.store import Store

DESCRIPTION = """\
Ask people which fit looks closer to the measured material, and turn their answers into scales.

  torchbrdf study serve runs/fores2012 --experiment 2        a page for observers, in a browser
  torchbrdf study scale runs/fores2012                       scales, figures and a page from their answers
  torchbrdf study scale answers.csv                          the same for any paired comparisons
  torchbrdf study power --difference 0.5                     how many observers a study needs
"""

SERVE = """\
Serve the page of an experiment to observers. Each gets a link of their own, and can leave and come back with it.

  torchbrdf study serve runs/fores2012                       experiment 1: models and error metrics
  torchbrdf study serve runs/fores2012 --experiment 2        experiment 2: models and the measured material
  torchbrdf study serve runs/fores2012 --host 0.0.0.0        for other computers of a lab's network
  torchbrdf study serve runs/fores2012 --url https://study.example/fits     behind a proxy such as nginx

Requests under other names than this computer's and the URL's are refused. Ctrl-C, SIGTERM and SIGHUP end it well.
The words shown, and who may take part, are in RUN_DIR/study.json; answers go to RUN_DIR/study.sqlite at once.
"""

ADD = """\
Add an experiment to the study.json of a run, with any of its stimuli and pairs.

  torchbrdf study add runs/fores2012 ward --stimuli 'ward-*' --repeats 5
  torchbrdf study add runs/fores2012 few --pairs ward-rms:ward-cube_root,ward-rms:measured --catch 4
  torchbrdf study add runs/fores2012 many --stimuli '*' --compare 4
"""

EXPORT = """\
Write the answers of a run's observers to a CSV file: observer, session, scene, condition_1, condition_2, selection (1
or 2) and more, and beside it, as JSON, what observers said of themselves and their screens.

  torchbrdf study export runs/fores2012 --out answers.csv
"""

SCALE = """\
Scale the answers of a run's observers, or of a CSV file with a row an answer: observer, scene, condition_1,
condition_2, selection (1, 2 or the name); or pwcmp's observer, scene, condition_A, condition_B, is_A_selected (1 or 0);
or observer, material, left, right, chosen. Selections mean the same in all rows; where a file leaves open what they
mean, call the column chosen_place or chosen_name.

  torchbrdf study scale runs/fores2012
  torchbrdf study scale answers.csv --out scales/

Writes scales.csv, scales.json, observers.csv, figures and scales.html.
"""

SIMULATE = """\
Answer an experiment with observers who are no people: they see image differences, with noise.

  torchbrdf study simulate runs/fores2012 --experiment 1 --observers 15 --out simulated.csv
"""

POWER = """\
Say how many observers are needed to tell two stimuli apart that differ by so much on the scale, in standard deviations
of a difference: 0.67 is a difference that 75 % see.

  torchbrdf study power --difference 0.5
  torchbrdf study power --difference 0.5 --stimuli 9 --power 0.9
"""


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    parser = described(commands.add_parser("study", help="ask people, and scale their answers"), DESCRIPTION)
    parts = parser.add_subparsers(metavar="PART", required=True)

    serve = described(parts.add_parser("serve", help="serve the page for observers"), SERVE)
    serve.add_argument("run", help="folder of a run, with a study.json")
    serve.add_argument("--experiment", help="its name (default: the first)")
    serve.add_argument("--host", default="127.0.0.1", help="address to listen at (default 127.0.0.1: this computer)")
    serve.add_argument("--port", type=whole(0, 65535), default=8000, help="port; 0: a free one (default 8000)")
    serve.add_argument("--url", help="of the page, where observers come through a proxy: https://host/prefix")
    serve.add_argument("--observers", type=whole(1, 1_000_000), default=1000, help="so many may begin (default 1000)")
    serve.set_defaults(command=serve_command)

    new = described(parts.add_parser("add", help="add an experiment to a run"), ADD)
    new.add_argument("run", help="folder of a run, with a study.json")
    new.add_argument("name", help="the new experiment's name")
    new.add_argument("--stimuli", default="*", help="names, with * and ?, parted by commas (default: all)")
    new.add_argument("--pairs", help="only these pairs: a:b,c:d")
    new.add_argument(
        "--compare", type=whole(2, 100_000), help="each observer compares each stimulus with so many others"
    )
    new.add_argument("--repeats", type=whole(0, 100_000), default=0, help="trials that come twice (default 0)")
    new.add_argument("--catch", type=whole(0, 100_000), default=0, help="trials with a known answer (default 0)")
    new.add_argument("--title", help="for reports")
    new.set_defaults(command=add_command)

    simulate = described(parts.add_parser("simulate", help="answer with simulated observers"), SIMULATE)
    simulate.add_argument("run", help="folder of a run, with a study.json")
    simulate.add_argument("--experiment", help="its name (default: the first)")
    simulate.add_argument("--observers", type=whole(1, 1_000_000), default=15, help="how many (default 15)")
    noise = "of what they see, in units of the image difference (default 2)"
    simulate.add_argument("--noise", type=number(1e-6, 1e6), help=noise)
    simulate.add_argument("--seed", type=whole(*SEEDS), default=0, help="seed of their answers (default 0)")
    simulate.add_argument("--out", default="simulated.csv", help="the file (default: simulated.csv)")
    simulate.set_defaults(command=simulate_command)

    export = described(parts.add_parser("export", help="write the answers to a CSV file"), EXPORT)
    export.add_argument("run", help="folder of a run that was served")
    export.add_argument("--out", help="the file (default: RUN_DIR/answers.csv)")
    export.set_defaults(command=export_command)

    scale = described(parts.add_parser("scale", help="scales, figures and a page from answers"), SCALE)
    scale.add_argument("answers", help="a CSV file, or the folder of a run that was served")
    scale.add_argument("--method", default="likelihood", help="likelihood (default) or least_squares")
    scale.add_argument("--seed", type=whole(*SEEDS), default=0, help="seed of the bootstrap (default 0)")
    scale.add_argument("--out", help="folder for what is written (default: scales/ beside the answers)")
    scale.set_defaults(command=scale_command)

    power = described(parts.add_parser("power", help="how many observers are needed"), POWER)
    power.add_argument("--difference", type=number(-10, 10), required=True, help="on the scale")
    power.add_argument("--stimuli", type=whole(2, 1000), default=2, help="that are compared, all pairs (default 2)")
    power.add_argument("--power", type=number(0, 1), default=0.8, help="wanted probability to find it (default 0.8)")
    alpha = "probability to find what is not there (default 0.05)"
    power.add_argument("--alpha", type=number(1e-6, 0.5), default=0.05, help=alpha)
    power.set_defaults(command=power_command)


def serve_command(options: Options) -> int:
    """`torchbrdf study serve`."""
    from torchbrdf.study.server import serve

    _, experiment = _experiment(options)
    serve(
        Path(options.run),
        experiment,
        host=options.host,
        port=options.port,
        url=options.url,
        observers=options.observers,
    )
    return 0


def add_command(options: Options) -> int:
    """`torchbrdf study add`."""
    from torchbrdf.study import Experiment, Plan, trials

    plan = Plan.load(options.run)
    if options.name in [experiment.name for experiment in plan.experiments]:
        raise UsageError(f"{options.run}: there is an experiment {options.name!r}; give another name")
    pairs = None
    if options.pairs is not None:
        pairs = tuple(_pair(text) for text in options.pairs.split(","))
        names = list(dict.fromkeys(name for pair in pairs for name in pair))
    else:
        known = [name for name in plan.materials[0].stimuli if all(name in m.stimuli for m in plan.materials)]
        wanted = options.stimuli.split(",")
        for pattern in wanted:
            if not any(fnmatchcase(name, pattern) for name in known):
                raise UsageError(f"--stimuli: no stimulus is called {pattern}; expected {', '.join(known)}")
        names = [name for name in known if any(fnmatchcase(name, pattern) for pattern in wanted)]
    new = Experiment(
        options.name,
        options.title or options.name,
        tuple(names),
        pairs,
        options.compare,
        options.repeats,
        options.catch,
    )
    plan = replace(plan, experiments=(*plan.experiments, new))
    count = len(trials(plan, new, 0))
    path = plan.save(options.run)
    print(f"experiment {new.name}: {len(names)} stimuli, {len(plan.materials)} materials, {count} trials an observer")
    print(path)
    return 0


def simulate_command(options: Options) -> int:
    """`torchbrdf study simulate`."""
    from torchbrdf.files import writable_file
    from torchbrdf.study import simulate, write_answers
    from torchbrdf.study.simulation import NOISE

    plan, name = _experiment(options)
    writable_file(options.out)
    noise = NOISE if options.noise is None else options.noise
    progress = progress_bar("observers")
    answers = simulate(plan, plan.experiment(name), options.observers, noise, options.seed, progress)
    write_answers(options.out, answers)
    print(f"{len(answers)} answers of {options.observers} simulated observers, who are no people")
    print(options.out)
    return 0


def export_command(options: Options) -> int:
    """`torchbrdf study export`."""
    from torchbrdf.files import writable_file, write_json
    from torchbrdf.study import write_answers

    out = Path(options.out) if options.out else Path(options.run) / "answers.csv"
    observers = out.with_name(f"{out.stem}-observers.json")
    with _store_of(Path(options.run)) as store:
        for path in (out, observers):
            writable_file(path)
        answers, profiles = store.answers(), store.profiles()
    write_answers(out, answers)
    write_json(observers, profiles)
    print(f"{len(answers)} answers of {len(profiles)} observers; what they said of themselves and their screens")
    print(out)
    print(observers)
    return 0


def scale_command(options: Options) -> int:
    """`torchbrdf study scale`."""
    check_word("method of scaling", options.method, SCALINGS)

    from torchbrdf.files import destination, writable
    from torchbrdf.reading import exists
    from torchbrdf.report.observers import FILES, write_scales
    from torchbrdf.study import Plan, read_answers
    from torchbrdf.study.plan import PLAN

    source = Path(options.answers)
    served = exists(source) and source.is_dir()
    folder = source if served else source.parent
    if served:
        with _store_of(source) as store:
            answers = store.answers()
    else:
        answers = read_answers(source)
    plan = Plan.load(folder) if exists(folder / PLAN) else None
    out = writable(Path(options.out) if options.out else folder / "scales")
    for name in FILES:
        destination(out / name)
    settings = {"method": options.method, "seed": options.seed, "source": source.name}
    for line in write_scales(out, answers, plan, **settings, progress=progress_bar("draws")):
        print(line)
    print(out / "scales.html")
    return 0


def power_command(options: Options) -> int:
    """`torchbrdf study power`."""
    from torchbrdf.psychophysics import observers_needed

    needed = observers_needed(options.difference, power=options.power, alpha=options.alpha, stimuli=options.stimuli)
    what = "two stimuli" if options.stimuli == 2 else f"the two ends of {options.stimuli} stimuli"
    print(
        f"{needed} observers, each judging every pair once, tell {what} apart that differ by {options.difference:g} "
        f"(power {options.power:g}, alpha {options.alpha:g})"
    )
    return 0


def _experiment(options: Options) -> tuple["Plan", str]:
    """The plan of a run, and the name of one of its experiments."""
    from torchbrdf.study import Plan

    plan = Plan.load(options.run)
    if options.experiment is None:
        return plan, plan.experiments[0].name
    return plan, plan.experiment(options.experiment).name


def _store_of(run: Path) -> "closing[Store]":
    """A run's database, open for a block."""
    from torchbrdf.reading import exists
    from torchbrdf.study import Plan
    from torchbrdf.study.store import STORE, Store

    path = run / STORE
    if not exists(path):
        raise DataError(f"{path}: no such file; `torchbrdf study serve {run}` begins one")
    return closing(Store(path, Plan.load(run)))


def _pair(text: str) -> tuple[str, str]:
    left, separator, right = text.partition(":")
    if not separator:
        raise UsageError(f"--pairs: expected a:b,c:d, found {text!r}")
    return left.strip(), right.strip()
