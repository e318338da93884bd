"""HTML of a notebook: tables, cards, and a strip along the body."""

from __future__ import annotations

from collections.abc import Sequence

from thigmo.display.bars import OTHER_COLOR, Bar


def html_table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table, its cells escaped."""
    from html import escape  # its list of entities takes time, and `import thigmo` comes by here

    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_card(title: str, statement: str, *parts: str) -> str:
    """A bold title, a sentence, and finished parts (tables, strips) below."""
    from html import escape

    return (
        f'<div style="max-width: 46em"><strong>{escape(title)}</strong>'
        f"<div>{escape(statement)}</div>{''.join(parts)}</div>"
    )


def body_strip(
    length: float,
    edges: Sequence[float],
    probability: Sequence[float],
    bars: Sequence[Bar],
) -> str:
    """The body as a line from base to tip, the posterior above it, the contacts on it.

    Args:
        length: of the body.
        edges: (M + 1,) edges of the cells of the last contact's posterior; empty without one.
        probability: (M,) their masses.
        bars: the contacts, base to tip.

    Returns:
        An SVG picture that takes the page's text colour.
    """
    width, ground, top = 560.0, 62.0, 8.0
    start, end = 12.0, 548.0

    def x(arc: float) -> float:
        return start + (end - start) * min(max(arc / length, 0.0), 1.0)

    drawn = []
    density = [
        mass / (high - low)
        for mass, low, high in zip(probability, edges[:-1], edges[1:], strict=True)
    ]
    if density and max(density) > 0.0:
        scale = (ground - 10.0 - top) / max(density)
        color = bars[-1].color if bars else OTHER_COLOR
        steps = "".join(
            f"L{x(low):.1f} {ground - 8 - d * scale:.1f}L{x(high):.1f} {ground - 8 - d * scale:.1f}"
            for d, low, high in zip(density, edges[:-1], edges[1:], strict=True)
        )
        drawn.append(
            f'<path d="M{x(edges[0]):.1f} {ground - 8:.1f}{steps}L{x(edges[-1]):.1f} '
            f'{ground - 8:.1f}Z" fill="{color}" fill-opacity="0.28"/>'
        )
    drawn.append(
        f'<line x1="{start}" x2="{end}" y1="{ground}" y2="{ground}" stroke="currentColor" '
        'stroke-opacity="0.25" stroke-width="9" stroke-linecap="round"/>'
    )
    for bar in bars:
        drawn += [
            f'<line x1="{x(low):.1f}" x2="{x(high):.1f}" y1="{ground}" y2="{ground}" '
            f'stroke="{bar.color}" stroke-opacity="0.55" stroke-width="7"/>'
            for low, high in bar.pieces
        ]
        drawn.append(f'<circle cx="{x(bar.arc):.1f}" cy="{ground}" r="5" fill="{bar.color}"/>')
    style = 'fill="currentColor" font-size="11" font-family="sans-serif"'
    drawn.append(f'<text x="{start}" y="{ground + 20}" {style}>base 0</text>')
    drawn.append(
        f'<text x="{end}" y="{ground + 20}" text-anchor="end" {style}>tip {length:.4g}</text>'
    )
    return (
        f'<svg viewBox="0 0 {width:g} {ground + 26:g}" width="{width:g}" role="img" '
        f'aria-label="posterior along the body" style="max-width: 100%">{"".join(drawn)}</svg>'
    )
