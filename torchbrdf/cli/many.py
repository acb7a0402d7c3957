"""What `torchbrdf fit` does with many materials: where they are fitted, in which share, and what is said of them."""

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torchbrdf import bounds
from torchbrdf.cli.common import Options, Parser, read_settings, say, short
from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.kinds import EXECUTORS, check_word
from torchbrdf.progress import Progress

if TYPE_CHECKING:
    from torchbrdf.fitting import Batches
    from torchbrdf.fitting.blocks import Group
    from torchbrdf.lobes import FitRecord
    from torchbrdf.perception.discrimination.psychometric import Share

MOST_LINES = 1000
"""Fits of which each is printed, and said by how many it would be told apart; of more there is a summary."""


def add_working(parser: Parser) -> None:
    """The options that say where fits are made."""
    parser.add_argument(
        "--executor",
        help="where materials are fitted: processes or threads of this machine (by default whichever is quicker), dask",
    )
    parser.add_argument(
        "--scheduler", help="of --executor dask, such as tcp://login:8786; by default workers on this machine"
    )
    parser.add_argument(
        "--shard", metavar="I/N", help="only the I-th of N shares, for jobs side by side; needs --out, see collect"
    )
    parser.add_argument("--device", help="what torch works on: cpu (default), cuda, cuda:0, ...")
    parser.add_argument(
        "--parquet", action="store_true", help="write fits.parquet, too, of any number of fits (needs pyarrow)"
    )


def check_working(options: Options) -> None:
    """A UsageError for options that are none, or do not go together."""
    if options.executor is not None:
        check_word("--executor", options.executor, EXECUTORS)
    if options.scheduler is not None and options.executor != "dask":
        found = options.executor or "none"
        raise UsageError(f"--scheduler: expected --executor dask with it, found {found}")
    if options.shard is not None:
        bounds.share(options.shard)
    for name in ("shard", "parquet"):
        if getattr(options, name) and not options.out:
            raise UsageError(f"--{name}: expected --out, too, found none")
    if options.parquet:
        from torchbrdf.fitting.tables import check_parquet

        check_parquet()
    if options.device is not None:
        check_device(options.device, here=options.executor != "dask")


def check_device(name: str, *, here: bool = True) -> None:
    """A UsageError for a device that torch does not know, or that this machine does not have.

    Args:
        name: Of the device.
        here: Whether this machine is to have it.
    """
    import torch

    try:
        device = torch.device(name)
        if device.type not in ("cpu", "cuda"):
            raise RuntimeError("not of those that fits were made for")
        if here:
            torch.zeros(1, device=device, dtype=torch.float32).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        count = torch.cuda.device_count()
        there = ", ".join(["cpu", *(f"cuda:{k}" for k in range(count))])
        raise UsageError(f"--device: expected one of {there}, found {shown(name)}") from error


def load_files_later(options: Options) -> tuple[list["Group"], bool]:
    """The materials of files, unopened where that can be; and whether those are all; the rest is said."""
    from torchbrdf.measured import load_later

    bad: list[DataError] = []
    groups = load_later(options.files, bad=bad, device=options.device, settings=read_settings(options))
    _say_left_out(bad)
    return groups, not bad


def _say_left_out(bad: Sequence[DataError]) -> None:
    for error in bad:
        say(f"torchbrdf: left out: {error}", to=sys.stderr)


@dataclass
class Found:
    """What a command fitted.

    Args:
        records: In the order of the materials, where they are few enough to be said.
        statuses: How fits ended, of all.
        seconds: Of work on those that were made now.
        made: How many were made now.
        judged: How many observers would tell those from their materials, by these; asked where they were made.
    """

    records: list["FitRecord"] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    made: int = 0
    judged: dict[str, "Share | None"] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """How many fits there are."""
        return sum(self.statuses.values())

    def shares(self, groups: Sequence["Group"]) -> dict[str, "Share | None"]:
        """How many observers would tell each fit from its material, by the materials' names."""
        from torchbrdf.experiment.discrimination import shares_by_name
        from torchbrdf.measured import Unopened

        # Of fits of before, whose materials nobody has opened yet.
        by_name = {record.material: record for record in self.records if record.material not in self.judged}
        found = dict(self.judged)
        for group in groups:
            rows = [k for k, name in enumerate(group.names) if name in by_name]
            if not rows:
                continue
            part = group.batch(rows)
            for measured in part.opened([]) if isinstance(part, Unopened) else [part]:
                found |= shares_by_name(measured, [by_name[name] for name in measured.names])
        return found


def fit_all(batches: "Batches", groups: Sequence["Group"], options: Options, progress: Progress) -> tuple[Found, bool]:
    """Fit what there is to fit, and whether all could be; what could not is said as it comes."""
    from torchbrdf.executors import executor_of

    shard = (1, 1) if options.shard is None else bounds.share(options.shard)
    names = [name for group in groups for name in group.names]
    found, bad, complete = Found(), list[DataError](), True
    made: dict[str, FitRecord] = {}
    if len(names) <= MOST_LINES:  # of which each is said
        from torchbrdf.experiment.discrimination import shares_by_name

        batches.judge = shares_by_name
    with executor_of(options.executor, options.scheduler) as place:
        for records in batches.fits(groups, progress, executor=place, shard=shard, bad=bad):
            _say_left_out(bad)
            complete = complete and not bad
            bad.clear()
            found.made += len(records)
            found.seconds += sum(record.seconds for record in records)
            found.statuses.update(record.status for record in records)
            if len(names) <= MOST_LINES:
                made |= {record.material: record for record in records}
    _say_left_out(bad)
    found.judged = batches.judged
    if options.shard is None:
        batches.write_tables(parquet=options.parquet)
    before = batches.earlier
    found.statuses.update(before.values())
    if len(names) <= MOST_LINES:
        made |= {record.material: record for record in batches.stored(set(before))}
        found.records = [made[name] for name in names if name in made]
    return found, complete and not bad


def say_summary(found: Found) -> None:
    """Lines about more fits than anybody would read."""
    kinds = ", ".join(f"{count} {status}" for status, count in found.statuses.most_common())
    print(f"{found.count} fits: {kinds}")
    if found.made:
        print(f"{found.made} of them now, {short(1000 * found.seconds / found.made)} ms of work each")
