"""`thigmo bench`: speed against accuracy, stability where methods fail, scaling, and honesty.

One module a study; `STUDIES` names them in the order in which they run. Studies load on use: some
need the extra packages of `pip install thigmo[bench]`.
"""

from __future__ import annotations

from importlib import import_module

from thigmo_bench.studies.engine import Context, Outcome, Study

STUDIES: dict[str, str] = {
    "speed-accuracy": "speed against accuracy of every method",
    "stability": "error and failures of each method as conditions get harder",
    "accuracy": "coverage and wrong answers, each error stated and not stated",
    "mistakes": "wrong answers under the mistakes of labs, stated and not",
    "loads": "few sensors, two contacts, held ends, kinks, near the base",
    "number": "how many contacts, and where, against what can be known",
    "space": "contacts in space, against an independent rod",
    "scaling": "time of `localize` and of batches, over sensors and rows",
    "camera": "errors of the overhead camera over painted rooms",
    "field": "the fit to whole sweeps, by sweeps of an independent rod",
    "exploration": "pegs found, empty rooms silent, maps true; calibrated or not",
    "maps": "a given map: true, stale or none; error, robot time, contacts",
    "robots": "other robots by description: 30 to 200 cm, one muscle",
    "gallery": "docs/robots: explored or pushed, beside what check says",
    "faults": "single failures: what notices them, how soon, what it costs",
    "trigger": "contact trigger's latency against its false alarms",
    "watch": "how late the page shows a reading, and what three pages cost",
    "stopping": "how soon each way to stop has the outputs off",
    "crowd": "how soon a stop is confirmed among hostile connections",
    "plant-models": "time against error of each rung of plant and localizer",
}

__all__ = ["STUDIES", "Context", "Outcome", "load"]


def load(name: str) -> Study:
    """The study of that name (a key of STUDIES)."""
    study: Study = import_module(f"thigmo_bench.studies.{name.replace('-', '_')}").run
    return study
