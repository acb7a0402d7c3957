"""report.html of losses scored against human answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.experiment.discrimination import Calibrated
from torchbrdf.experiment.labels import caveat, loss_label
from torchbrdf.files import write_csv, write_text
from torchbrdf.losses import LearnedLoss
from torchbrdf.perception import Appearance, BenchmarkData, JodTable, Table
from torchbrdf.perception.agreement.appearance import LABELS as MEASURED_LABELS
from torchbrdf.perception.agreement.jod import PICTURES
from torchbrdf.perception.agreement.table import CLOSE_METHOD, HEADS, LABELS, ODD_METHOD, span
from torchbrdf.perception.datasets.synthetic import SYNTHETIC
from torchbrdf.report.embed import embed_png, template
from torchbrdf.report.meaning import meaning
from torchbrdf.report.people_figures import appearance_figure, attribute_label, jod_figure
from torchbrdf.report.style import COLORS, new_figure
from torchbrdf.report.tables import Column, table
from torchbrdf.report.tables import Table as PageTable

TITLE = "Which BRDF metric agrees with people?"
RIVALS = ("cube_root", "compressed", "mean_log_difference")
THEIRS = "lagunas_"
# Columns from which on the cells of a table may take two lines.
WIDE = 5
NO_BREAK = "\u00a0"
_THEIRS = {
    "lagunas_rms": "Lagunas' RMS",
    "lagunas_rms_cos": "Lagunas' cosine RMS",
    "lagunas_rms_cos_cube": "Lagunas' cube root",
    "lagunas_dist_L2_lab": "Lagunas' pictures, L2 in Lab",
    "lagunas_dist_L4_lab": "Lagunas' pictures, L4 in Lab",
}


@dataclass(frozen=True)
class HumanPage:
    """What the page has to say beside the numbers."""

    synthetic: bool
    stand_in: bool
    images: bool
    left_out: Sequence[str]
    pairs: int
    max_theta: float
    replicates: int
    appearance: Appearance | None = None
    jod: JodTable | None = None


def write_human_report(
    folder: Path, table: Table, data: BenchmarkData, said: HumanPage, calibrated: Calibrated
) -> Path:
    """Draw the figures and write `report.html`; gives its path."""
    figure, mark = folder / "figures" / "agreement.png", caveat(said.stand_in, SYNTHETIC if said.synthetic else "")
    agreement_figure(figure, table, mark)
    opinions, triplets = data.opinions, data.triplets
    gloss, jod = _other_figures(folder / "figures", said, caveat(said.stand_in))
    page = template("human.html").render(
        title=TITLE,
        said=said,
        findings=[*findings(table), *([] if said.synthetic else trained(table))],
        figure=embed_png(figure),
        meaning=meaning(folder / "figures" / "reliability.png", calibrated, mark, label),
        tables=[
            *_agreement_tables(table),
            *(_difference_table(table, rival) for rival in RIVALS if rival in table.losses),
        ],
        gloss=gloss,
        gloss_table=said.appearance and [_appearance_table(said.appearance)],
        jod=jod,
        jod_table=said.jod and [_jod_table(said.jod)],
        questions=f"{len(triplets):,}",
        ties=f"{int((~triplets.decided).sum()):,}",
        materials=len(triplets.materials),
        rows=len(opinions),
        approximated=len(set(opinions.materials)),
        methods=list(dict.fromkeys(opinions.methods)),
        without=data.left_out,
        close=CLOSE_METHOD if CLOSE_METHOD in opinions.methods else "",
        odd=ODD_METHOD if ODD_METHOD in opinions.methods else "",
        record=(folder / "recipe.json").read_text(encoding="utf-8"),
    )
    path = folder / "report.html"
    write_text(path, page)
    for name, records in (
        ("appearance", said.appearance and said.appearance.records()),
        ("jod", said.jod and said.jod.table.records()),
    ):
        if records:
            write_csv(folder / f"{name}.csv", records)
    return path


def _other_figures(folder: Path, said: HumanPage, mark: str) -> tuple[str, str]:
    """Figures of ratings and of JOD scores, to be embedded; empty where there are none."""
    gloss, jod = folder / "appearance.png", folder / "jod.png"
    if said.appearance:
        appearance_figure(gloss, said.appearance, mark)
    if said.jod:
        jod_figure(jod, said.jod.scores)
    return embed_png(gloss) if said.appearance else "", embed_png(jod) if said.jod else ""


def _appearance_table(found: Appearance) -> PageTable:
    """Rank correlations of what is measured with every attribute."""
    rows = range(len(found.ratings.attributes))
    names = list(found.measured)

    def correlation(s: int) -> Column[int]:
        def value(row: int) -> Sequence[Any]:
            return found.correlation[s, row], found.low[s, row], found.high[s, row]

        return Column(
            MEASURED_LABELS[names[s]], value, lambda own: _unbroken(*own, sign="+"), max, "strength", _strength
        )

    columns = [
        Column[int]("people: how", lambda row: attribute_label(found.ratings.attributes[row])),
        *map(correlation, range(len(names))),
        Column[int]("all together", lambda row: found.correlation[-1, row], _signed),
        Column[int]("ceiling: people", lambda row: found.ceiling[row], ".3f"),
    ]
    note = (
        f"Spearman's rank correlation over {len(found.materials)} materials, with its 95 % interval over materials. "
        "Bold: the strongest. All together: ranks predicted from all of them, each material from the others. Ceiling: "
        "what the noise of mean ratings lets anything reach."
    )
    return table("Gloss and what people call it", note, rows, columns)


def _signed(value: Any) -> str:
    return f"{float(value):+.3f}" if np.isfinite(float(value)) else "none"


def _strength(found: Sequence[Any]) -> float:
    return abs(float(found[0]))


def _jod_table(found: JodTable) -> PageTable:
    """Agreement with JOD scores."""
    scores = found.table

    def agreement(s: int) -> Column[int]:
        one = scores.statistics[s]
        return Column(
            f"{one.label} ({one.count:,})",
            lambda row: (scores.value[row, s], scores.low[row, s], scores.high[row, s]),
            lambda own: _unbroken(*own),
        )

    def name(row: int) -> str:
        return "ΔE of the study's pictures" if scores.losses[row] == PICTURES else label(scores.losses[row])

    note = "Share of comparisons ordered as people do, with its 95 % interval over materials; 0.5 is chance."
    columns = [Column[int]("what", name), *map(agreement, range(len(scores.statistics)))]
    return table("JOD scores", note, range(len(scores.losses)), columns)


def label(name: str) -> str:
    """A row's name for people."""
    return _THEIRS.get(name) or loss_label(name)


def findings(table: Table) -> list[str]:
    """What the numbers say, in sentences."""
    lines = []
    own = [k for k, name in enumerate(table.losses) if not name.startswith(THEIRS)]
    for s, one in enumerate(table.statistics):
        known = [k for k in own if bool(table.value[k, s].isfinite())]
        if not known or one.variant:
            continue
        best = max(known, key=lambda k: float(table.value[k, s]))
        limit = "" if one.ceiling is None else f"; people's own disagreement lets nothing pass {table.ceiling[s]:.3f}"
        first = table.losses[best]
        others = [table.losses[k] for k in known if k != best]
        level = [label(name) for name in others if table.difference(first, name)[1][s] <= 0]
        tied = f" Not clearly worse: {', '.join(level)}." if level else " It is clearly ahead of all others."
        lines.append(
            f"{one.label[0].upper()}{one.label[1:]}: best is {label(first)} with "
            f"{table.value[best, s]:.3f} ({table.low[best, s]:.3f} to {table.high[best, s]:.3f}){limit}.{tied}"
        )
    return lines


def trained(table: Table) -> list[str]:
    """What has to be said of a metric that these answers may have trained."""
    if "learned" not in table.losses:
        return []
    known = LearnedLoss().provenance.get("held_out", {})
    shares = [
        f"{LABELS[name]} {share:.3f} ({low:.3f} to {high:.3f})"
        for name, (share, low, high) in known.items()
        if name in LABELS
    ]
    methods = f" (across materials with {CLOSE_METHOD})" if "across" in known else ""
    unseen = f" On halves of the materials that it did not see{methods}: {'; '.join(shares)}." if shares else ""
    return [
        "The learned metric that comes with torchbrdf was trained on published answers of these studies, those about "
        f"{CLOSE_METHOD} too: here it is asked about what it may have seen.{unseen} Train one with torchbrdf run "
        "train_metric."
    ]


def agreement_figure(path: Path, table: Table, mark: str) -> None:
    """A panel for each statistic: agreement of every loss with its interval, chance, and the ceiling."""
    shown = _columns(table)
    rows, order = np.arange(len(table.losses)), table.ranked
    with new_figure(path, 2.35 * len(shown) + 1.6, 0.3 * len(rows) + 1.5, mark) as figure:
        panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for panel, s in zip(panels, shown, strict=True):
            for row, k in enumerate(order):
                value, low, high = (float(part[k, s]) for part in (table.value, table.low, table.high))
                if np.isfinite(value):
                    name = table.losses[k]
                    color = "#888888" if name.startswith(THEIRS) else COLORS.get(name, "#333333")
                    panel.plot([low, high], [row, row], color=color, lw=2, alpha=0.6, solid_capstyle="butt")
                    panel.plot(value, row, "o", color=color, ms=5)
            panel.axvline(0.5, color="grey", lw=0.8, ls=":")
            if table.statistics[s].ceiling is not None:
                panel.axvspan(
                    float(table.ceiling_low[s]), float(table.ceiling_high[s]), color="#9c3d00", alpha=0.12, lw=0
                )
                panel.axvline(float(table.ceiling[s]), color="#9c3d00", lw=1.2, ls="--")
            panel.set_title(_wrapped(table.statistics[s].label), fontsize=8)
            panel.set_xlabel("agreement")
        panels[0].set_yticks(rows, [label(table.losses[k]) for k in order])
        panels[0].invert_yaxis()


def _wrapped(text: str) -> str:
    """In two lines or three."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > 24:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines)


def _agreement_tables(scores: Table) -> list[PageTable]:
    """Agreement with intervals and the ceilings; then a table for each column whose methods can differ."""
    note = (
        "Share of comparisons that a loss orders as people do, with its 95 % interval over materials; 0.5 is chance. "
        "Bold: the best. In the head: how many comparisons. Ceiling: what disagreement between people lets anything "
        "reach."
    )
    main = _columns(scores)
    labels = {s: scores.statistics[s].label for s in main}
    tables = [_agreement_table(scores, "Agreement with people", note, labels)]
    for s in main:
        own = scores.statistics[s]
        varied = {k: one.variant for k, one in enumerate(scores.statistics) if one.main == own.key and one.variant}
        if varied:
            note = (
                f"The column of the first table, {own.label}, and what it is without one of its methods, or with one "
                "that it leaves out."
            )
            title = f"Methods left out: {HEADS[own.key]}"
            tables.append(_agreement_table(scores, title, note, {s: "as above", **varied}))
    return tables


def _columns(scores: Table) -> list[int]:
    """The main columns."""
    return [s for s, one in enumerate(scores.statistics) if not one.variant]


def _agreement_table(scores: Table, title: str, note: str, heads: Mapping[int, str]) -> PageTable:
    """Agreement of each loss by some columns, and the ceiling in the last row, which is no rival."""
    ceiling = len(scores.losses)

    def agreement_column(s: int) -> Column[int]:
        def value(row: int) -> Sequence[Any]:
            if row == ceiling:
                return scores.ceiling[s], scores.ceiling_low[s], scores.ceiling_high[s]
            return scores.value[row, s], scores.low[row, s], scores.high[row, s]

        best = scores.value[:, s].nan_to_num(-1).max()
        return Column(
            f"{heads[s]} ({scores.statistics[s].count:,})",
            value,
            lambda found: _unbroken(*found, wide=len(heads) > WIDE),
            bold=lambda row: row != ceiling and bool(scores.value[row, s] == best),
        )

    rows = [k for k in scores.ranked if bool(scores.value[k, list(heads)].isfinite().any())]
    head = Column[int]("loss", lambda row: "ceiling: people" if row == ceiling else label(scores.losses[row]))
    return table(title, note, [*rows, ceiling], [head, *map(agreement_column, heads)])


def _difference_table(scores: Table, rival: str) -> PageTable:
    """How much more often each loss agrees with people than one of them."""
    rows = [name for name in scores.losses if name != rival and not name.startswith(THEIRS)]
    found = {name: scores.difference(name, rival) for name in rows}

    def difference(s: int) -> Column[str]:
        return Column(
            scores.statistics[s].label,
            lambda name: [part[s] for part in found[name]],
            lambda own: _unbroken(*own, sign="+"),
            bold=lambda name: bool(found[name][1][s] > 0),
        )

    note = (
        f"Agreement minus that of {label(rival)}, with the paired 95 % interval: both see the same drawn materials. "
        "Bold: all of the interval is above 0."
    )
    columns = [Column("loss", label), *map(difference, _columns(scores))]
    return table(f"Better than {label(rival)}?", note, rows, columns)


def _unbroken(value: Any, low: Any, high: Any, *, sign: str = "", wide: bool = False) -> str:
    """A share and its interval in one line; in tables that are wide, or of differences, in one or two."""
    first, *interval = span(value, low, high, sign=sign).split(" ", 1)
    return (" " if sign or wide else NO_BREAK).join([first, *(part.replace(" ", NO_BREAK) for part in interval)])
