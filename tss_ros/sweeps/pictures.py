"""The picture of a sweep: a map of verdicts, or curves over rates or over a parameter."""

import math

import numpy as np
import pyarrow as pa
import pyarrow.compute

from tss_ros import plots
from tss_ros.core.stability.law_words import laws_in_words
from tss_ros.scenarios.parameters import label
from tss_ros.sweeps.jobs import CRITICAL_RATES, MULTIPLIERS, Question
from tss_ros.sweeps.store import Store

#: Most spin rates for which there is a curve each.
MOST_CURVES = 6


def laws(question: Question, store: Store) -> str:
    """The laws asked about, and how often taut tethers push in the motions computed."""
    asked = [(system.tether_law, math.nan) for _, _, system in question.systems]
    found = points(question, store, "tether_law", "pushing_share")
    motions = zip(found["tether_law"].to_pylist(), found["pushing_share"].to_pylist())
    return laws_in_words([*asked, *motions])


def points(question: Question, store: Store, *columns: str) -> pa.Table:
    """Multipliers that there are, by the motion's own method if it was asked for."""
    found = store.table(MULTIPLIERS, [*columns, "method"]).drop_null()
    return found.filter(pa.compute.field("method") == question.methods[0])


def _draw_curves(question, store):
    """Multipliers of one system against the spin rate, with its critical rates."""
    names = ["spin_rate_ratio", "max_modulus", "max_modulus_nontrivial", "verdict"]
    rows = [r for r in store.table(MULTIPLIERS).to_pylist() if r["method"] == question.methods[0]]
    critical = store.table(CRITICAL_RATES, ["spin_rate_ratio", "cause"]).drop_null().to_pylist()
    law = laws(question, store)
    return plots.stability(
        *([row[name] for row in rows] for name in names), question.methods[0], law,
        [row["deciding_modulus"] for row in rows],
        [(row["spin_rate_ratio"], row["cause"]) for row in critical],
    )  # fmt: skip


def _draw_values(question, store):
    """The modulus that decided over the values of a parameter, for each of a few spin rates."""
    columns = "job", "spin_rate_ratio", "deciding_modulus", "verdict"
    found = points(question, store, *columns).to_pydict()
    shape = len(question.ratios), len(question.systems)
    moduli, verdicts = np.full(shape, np.nan), np.full(shape, "", dtype=object)
    for job, ratio, modulus, verdict in zip(*(found[name] for name in columns)):
        place = question.ratios.index(ratio), question.system_index(job)
        moduli[place], verdicts[place] = modulus, verdict
    return plots.stability_over_parameter(
        label(question.parameter),
        np.array([value for _, value, _ in question.systems]),
        np.array(question.ratios), moduli, verdicts, question.methods[0], laws(question, store),
    )  # fmt: skip


def draw(question: Question, store: Store) -> plots.Figure:
    """The map of verdicts and critical rates.

    Of one system: curves of its multipliers. Of a scenario with several values of a parameter at
    no more than `MOST_CURVES` rates: curves of the modulus that decided.

    Parameters
    ----------
    question : Question
    store : Store

    Returns
    -------
    matplotlib.figure.Figure
    """
    if len(question.systems) == 1 and question.ratios:
        return _draw_curves(question, store)
    several = len({name for name, _, _ in question.systems}) > 1
    named = question.varies_text or not question.parameter or several
    few = question.ratios and len(question.ratios) <= MOST_CURVES
    if few and not named and question.interval is None:
        return _draw_values(question, store)
    place = np.array([i if named else v for i, (_, v, _) in enumerate(question.systems)])

    def arrays(found, *columns):
        jobs, *values = (found[column].to_numpy() for column in ("job", *columns))
        return place[question.system_index(jobs)], *values

    shown = ("spin_rate_ratio", "uncertainty", "cause")
    return plots.stability_map(
        label(question.parameter) if question.parameter else "scenario",
        arrays(
            points(question, store, "job", "spin_rate_ratio", "verdict"),
            "spin_rate_ratio",
            "verdict",
        ),
        arrays(store.table(CRITICAL_RATES, ["job", *shown]).drop_null(), *shown),
        [_label(name, v) for name, v, _ in question.systems] if named else (),
        laws(question, store),
    )


def _label(name, value):
    """What a system is called on the abscissa."""
    if value is None:
        return name
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
