"""Add up the parts list of docs/hardware: what costs what, from where, and what has no price.

    python tools/parts.py        the total, and every row without a price

The documentation shows the whole list (`page`, called by docs/_ext/generated.py).

A price is one that its seller's page, or a list that somebody published, showed on the date beside
it. Sums stay in the sellers' currencies: a rate of exchange would be one more number that ages.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path

HARDWARE = Path(__file__).resolve().parents[1] / "docs" / "hardware"
LISTS = {"The robot": "parts.csv", "A Pico in place of the Mega": "pico-parts.csv"}
NO_PRICE = "no public price found"
PRINTED = "printed"

Row = dict[str, str]


def read(name: str) -> list[Row]:
    """Rows of one list."""
    with (HARDWARE / name).open() as file:
        return list(csv.DictReader(file))


def is_priced(row: Row) -> bool:
    """Whether the row states a price."""
    return row["price"] not in (NO_PRICE, PRINTED)


def totals(rows: Iterable[Row]) -> dict[str, Decimal]:
    """Sum of price times count over the rows with a price, for each currency."""
    sums: defaultdict[str, Decimal] = defaultdict(Decimal)
    for row in rows:
        if is_priced(row):
            amount, currency = row["price"].split()
            sums[currency] += Decimal(amount) * int(row["count"])
    return dict(sums)


def summary(rows: list[Row]) -> str:
    """The total in a sentence, with what it leaves out."""
    priced = [row for row in rows if is_priced(row)]
    missing = sum(row["price"] == NO_PRICE for row in rows)
    printed = sum(row["price"] == PRINTED for row in rows)
    days = sorted(row["dated"] for row in priced if row["dated"])
    sums = " and ".join(f"{amount:.2f} {unit}" for unit, amount in sorted(totals(rows).items()))
    text = f"{len(priced)} of {len(rows)} rows have a price: together {sums}, without tax and "
    text += f"shipping, by prices of {days[0]} to {days[-1]}. "
    return f"{text}Rows without a price: {missing}; printed: {printed}. {_without_order(rows)}"


def _without_order(rows: list[Row]) -> str:
    """The rows that have neither an order number nor a file to print, in a sentence."""
    refs = [row["ref"] for row in rows if not row["order"] and row["price"] != PRINTED]
    if not refs:
        return "Every row that is not printed has an order number."
    return f"Rows without an order number ({len(refs)}): {', '.join(refs)}."


def page() -> str:
    """Both lists as Markdown tables, each below its total."""
    lines = []
    for title, name in LISTS.items():
        rows = read(name)
        lines += [f"## {title}", "", f"{summary(rows)} The list as a file: [{name}]({name}).", ""]
        lines += ["| part | count | what | order number | each | dated |", "| --- " * 6 + "|"]
        for row in rows:
            price = row["price"]
            if row["source"]:
                price = f"[{price if is_priced(row) else 'seller'}]({row['source']})"
                price += "" if is_priced(row) else f", {row['price']}"
            description = "; ".join(filter(None, (row["what"], row["part"])))
            cells = (row["ref"], row["count"], description, row["order"], price, row["dated"])
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Print the totals and every row without a price."""
    for title, name in LISTS.items():
        rows = read(name)
        print(f"{title}: {summary(rows)}")
        for row in rows:
            if row["price"] == NO_PRICE:
                print(f"  {row['ref']:10} {row['order'] or 'no order number'}: {row['what']}")


if __name__ == "__main__":
    main()
