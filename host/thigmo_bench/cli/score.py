"""`thigmo score`: answers to the public benchmark against its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thigmo.cli.output import JsonOption, show


def score(
    answers: Annotated[
        Path, typer.Argument(help="CSV: frame, arc_cm, low_cm, high_cm, localized.")
    ],
    truth: Annotated[
        Path | None, typer.Option(help="File of true contacts; the published one if omitted.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Score answers to the public benchmark: errors, coverage and overclaiming, by group.

    docs/benchmark.md has the format of frames and answers, and what is counted.
    """
    from dataclasses import asdict

    from thigmo.errors import DataError
    from thigmo_bench.benchmark.score import FOLDER, AnswersError, table
    from thigmo_bench.benchmark.score import score as scored

    try:
        scores = scored(answers, truth or FOLDER / "truth.csv")
    except AnswersError as error:
        raise DataError(str(error), "see docs/benchmark.md for the format") from error
    show(as_json, [asdict(group) for group in scores], table(scores))
