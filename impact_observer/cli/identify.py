"""Learn a model's parameters from nothing but impact times, or check a model against them."""

import argparse
import json as json_module
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_model, add_namespace, not_negative, positive

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.identify.fit_check import Check
    from impact_observer.identify.identifying import Identified
    from impact_observer.model import Model
    from impact_observer.model.model_file import ModelText

_WIDTH = 100
"""Columns where there is no terminal."""
_CORRELATED = 0.9
"""Correlation of two parameters that is told."""
_SHOWN = 6
"""Impacts that are told by their times."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add_namespace(parser)
    parser.add_argument(
        "--free",
        metavar="LIST",
        default="",
        help="what to learn, with commas: restitution, gap, stiffness-scale, damping-scale,"
        " mass-scale, forcing-amplitude, forcing-phase, clock-offset, and of elements stiffness,"
        " damping, mass; or one of a kind, such as gap.stop or stiffness.ground-x1",
    )
    parser.add_argument(
        "--clock-error",
        metavar="S",
        type=not_negative,
        help="standard deviation of the stamps, s (default: the fit tells)",
    )
    parser.add_argument(
        "--horizon", metavar="S", type=positive, help="use the first so many seconds (default all)"
    )
    parser.add_argument(
        "--believe", action="store_true", help="take no impact for spurious or missing"
    )
    parser.add_argument(
        "--check", action="store_true", help="say whether the model fits the times; learns nothing"
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help="write the model as learnt, as YAML"
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write the errors of the stamps: PNG, SVG, PDF"
    )
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return identify(
        args.bag,
        tuple(name.strip() for name in args.free.split(",") if name.strip()),
        model=args.model,
        clock_error=args.clock_error,
        horizon=args.horizon,
        believe=args.believe,
        check=args.check,
        namespace=args.namespace,
        output=args.output,
        plot=args.plot,
        json=args.json,
    )


def identify(
    bag: Path,
    free: tuple[str, ...] = (),
    *,
    model: str | None = None,
    clock_error: float | None = None,
    horizon: float | None = None,
    believe: bool = False,
    check: bool = False,
    namespace: str = "",
    output: Path | None = None,
    plot: Path | None = None,
    json: bool = False,
) -> int:
    """Learn from the impacts in a bag and print what comes out.

    Args:
        bag: has impacts.
        free: parameters to learn; see ``parameters.parametric_family``.
        model: a model file or a sample's name; None for the model that the bag carries.
        clock_error: standard deviation of the stamps, s; None where the fit tells.
        horizon: seconds of the recording that count; None for all.
        believe: whether no impact is taken for spurious or missing.
        check: whether to check the model instead.
        namespace: of the rig that is meant; empty for the only one.
        output: the model file to make; None for none.
        plot: a picture to write; None for none.
        json: print JSON instead of tables and words.

    Returns:
        0; 1 where something is not told, the fit does not converge or the check refutes the model.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: the bag cannot be read, or contains no impact of the model's contacts.
        IdentificationError: too few impacts, or parameters that no impact tells.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.errors import BagError
    from impact_observer.identify import fit_check, identifying
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import events_in, text_of_model
    from impact_observer.model.free_parameters import parametric_family

    _check_usage(free, output, plot, check=check, clock=clock_error)
    with BagReader(bag, namespace) as reader:
        given = text_of_model(reader, model)
        parsed, document = _parsed(given)
        events = events_in(reader)
    family = parametric_family(parsed.system, free, parsed.elements)
    with Progress(sys.stderr if json else None) as progress:
        try:
            found = identifying.identify(
                family,
                events,
                clock=clock_error,
                horizon=horizon,
                believe=believe,
                progress=lambda what: progress.show(f"{family.system.name}: {what}"),
            )
        except BagError as error:
            raise BagError(f"{bag}: {error}") from None
    verdict = fit_check.checked(found)
    good = found.converged and not found.unknown and (verdict.fits or not check)
    if json:
        print(json_module.dumps(figures(found, verdict), indent=2, allow_nan=False))
    else:
        print_found(found, verdict, check=check)
    if output is not None and good:
        written = text_of(given.text, document, found, str(bag))
        _parsed(given._replace(text=written, source=str(output)))
        output.write_text(written, encoding="utf-8")
        print(f"model: {output}", file=sys.stderr if json else sys.stdout)
    if plot is not None:
        draw(found, plot)
        print(f"picture: {plot}", file=sys.stderr if json else sys.stdout)
    return 0 if good else 1


def _check_usage(
    free: tuple[str, ...],
    output: Path | None,
    plot: Path | None,
    *,
    check: bool,
    clock: float | None,
) -> None:
    """Raise UsageError before anything is done."""
    from impact_observer.errors import UsageError

    if check and (free or output):
        raise UsageError("--check: learns nothing; expected no --free and no -o beside it")
    if check and clock is None:
        raise UsageError(
            "--check: no --clock-error declared; expected the standard deviation of a stamp, s:"
            " without one an error of the model looks like one of the clock"
        )
    if not check and not free:
        raise UsageError("--free: names no parameter; expected some, such as restitution,gap")
    if output is not None and (output.exists() or not output.parent.is_dir()):
        found = "exists already" if output.exists() else "its folder does not exist"
        raise UsageError(f"{output}: {found}; expected the name of a file to make")
    if plot is not None:
        from impact_observer.draw.pictures import check_output

        check_output(plot)


def _parsed(given: "ModelText") -> tuple["Model", dict[str, object]]:
    """The model, and what its file says."""
    from impact_observer.model import parse_model
    from impact_observer.model.model_file import load_yaml

    model, document = parse_model(*given), load_yaml(given.text)
    assert isinstance(document, dict), "a model is a mapping"
    return model, document


def text_of(text: str, document: dict[str, object], found: "Identified", bag: str) -> str:
    """The model file as it was learnt, in its own form.

    Args:
        text: the given one.
        document: what it says.
        found: what was learnt.
        bag: of what, for the provenance.
    """
    from impact_observer import __version__
    from impact_observer.identify.model_edit import changes
    from impact_observer.model.model_file import edited

    rows = zip(found.family.names, found.values.tolist(), found.errors.tolist(), strict=True)
    learnt = {name: {"value": value, "standard_error": error} for name, value, error in rows}
    provenance: dict[str, object] = {
        "package": "impact_observer",
        "version": __version__,
        "identified_from": bag,
        "clock_error": found.clock,
        "parameters": learnt,
    }
    if "provenance" in document:
        provenance["before"] = document["provenance"]
    return edited(
        text, {**changes(document, found.family, found.values), ("provenance",): provenance}
    )


def draw(found: "Identified", plot: Path) -> None:
    """Draw the errors of the stamps over time."""
    from impact_observer.draw.pictures import save
    from impact_observer.identify.fit_picture import identification_figure

    title = f"{found.family.system.name}: how much earlier than the model's impacts the stamps are"
    save(identification_figure(found, title=title), plot)


def figures(found: "Identified", verdict: "Check") -> dict[str, object]:
    """What ``--json`` prints; SI units."""
    family = found.family
    names = family.system.contact_names
    told = zip(
        family.parameters,
        found.values.tolist(),
        found.errors.tolist(),
        strict=True,
    )
    return {
        "name": family.system.name,
        "converged": found.converged,
        "fits": verdict.fits and found.converged,
        "parameters": {
            each.name: {
                "given": each.value,
                "value": value,
                "standard_error": error,
                "unit": each.unit,
                "at_bound": each.name in found.bounded,
            }
            for each, value, error in told
        },
        "correlation": found.correlation.tolist(),
        "unknown": [{term.name: term.change for term in each} for each in found.unknown],
        "singular_values": found.singular.tolist(),
        "initial_state": found.start.tolist(),
        "initial_state_error": found.start_errors.tolist(),
        "initial_state_seconds": found.recording.start,
        "clock_error": found.clock,
        "clock_error_declared": found.declared,
        "residual": found.rms,
        "degrees_of_freedom": found.freedom,
        "impacts": len(found.shifts),
        "doubted": [[stamp, names[i]] for stamp, i in sorted(found.recording.doubted)],
        "inserted": [[stamp, names[i]] for stamp, i in sorted(found.recording.inserted)],
        "probability_of_size": verdict.size,
        "probability_of_whiteness": verdict.white,
        "contacts": {
            name: {"impacts": count, "mean": mean, "rms": rms}
            for name, (count, mean, rms) in verdict.by_contact.items()
        },
        "worst_contact": verdict.worst,
        "shifts": {
            "seconds": found.stamps.tolist(),
            "shift": found.shifts.tolist(),
            "contacts": [list(each) for each in found.contacts],
        },
    }


def print_found(found: "Identified", verdict: "Check", *, check: bool) -> None:
    """Print parameters, or how each contact fits, and what it comes down to."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, width=width)
    console.print(contact_table(verdict) if check else parameter_table(found))
    console.print()
    for sentence in [
        *_of_fit(found),
        *(_of_check(found, verdict) if check else _of_parameters(found)),
    ]:
        console.print(sentence)


def parameter_table(found: "Identified") -> "Table":
    """One row a parameter."""
    table = _new_table("parameter", "given", "learnt", "standard error", "unit")
    rows = zip(found.family.parameters, found.values, found.errors, strict=True)
    unknown = {term.name for each in found.unknown for term in each}
    for each, value, error in rows:
        shown = "not told" if each.name in unknown else f"{value:.10g}"
        own = "" if each.name in unknown else f"{error:.2g}"
        own = "at its bound" if each.name in found.bounded else own
        table.add_row(each.name, f"{each.value:.6g}", shown, own, each.unit)
    return table


def contact_table(verdict: "Check") -> "Table":
    """One row a contact."""
    table = _new_table("contact", "impacts", "mean [s]", "rms [s]")
    for name, (count, mean, rms) in verdict.by_contact.items():
        table.add_row(name, str(count), f"{mean:.3g}", f"{rms:.3g}")
    return table


def _new_table(*headings: str) -> "Table":
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for heading in headings:
        words = heading in {"parameter", "contact", "unit"}
        table.add_column(heading, justify="left" if words else "right", overflow="fold")
    return table


def _of_fit(found: "Identified") -> Iterator[str]:
    """How well the recording is explained."""
    said = f" ({found.clock:.3g} s declared)" if found.declared else ""
    yield f"{len(found.shifts)} stamps, {found.rms:.3g} s from the model's impacts (rms){said}."
    if not found.converged:
        yield "No motion of the model explains them: nothing here is to be trusted."
    for hits, words in (
        (found.recording.doubted, "taken for spurious"),
        (found.recording.inserted, "inserted, unheard"),
    ):
        if hits:
            yield f"{len(hits)} impacts {words}: {_times(found, hits)}."


def _times(found: "Identified", hits: "frozenset[tuple[int, int]]") -> str:
    """When, since the epoch."""
    from impact_observer.stamps import seconds_between

    names, epoch = found.family.system.contact_names, found.recording.told.epoch
    shown = [f"{names[i]} at {seconds_between(epoch, s):.3f} s" for s, i in sorted(hits)]
    more = len(shown) - _SHOWN
    return ", ".join(shown[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _of_parameters(found: "Identified") -> Iterator[str]:
    """What the data cannot tell, or can hardly tell apart."""
    from impact_observer.identify.identifying import combination

    for each in found.unknown:
        yield f"Not told by these impacts: {combination(each)}. Hold one of them fixed."
    for name in found.bounded:
        yield f"{name} ended at the bound of what it can be."
    names, correlation = found.family.names, found.correlation
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > _CORRELATED:
                yield f"{names[j]} and {names[i]} are correlated by {correlation[i, j]:.3f}."


def _of_check(found: "Identified", verdict: "Check") -> Iterator[str]:
    """What the check says."""
    if verdict.size is not None:
        yield f"Were the model right, shifts that large had a probability of {verdict.size:.2g}."
    yield (
        "Were the model right, neighbouring shifts so alike had a probability of"
        f" {verdict.white:.2g} ({verdict.lags} lags)."
    )
    good = verdict.fits and found.converged
    yield "The model fits." if good else f"The model does not fit; worst: {verdict.worst}."
