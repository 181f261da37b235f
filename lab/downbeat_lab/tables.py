"""Prints tables row by row while an experiment runs."""


def figure(value):
    """A cell as text: numbers with a fraction get at least three digits, or two decimals if they are less than 10."""
    if not isinstance(value, float):
        return str(value)
    decimals = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:.{decimals}f}"


class Table:
    """Prints its headings before the first row. The first `left` columns are aligned to the left, the others to the right."""

    def __init__(self, *headings, widths=None, width=9, left=0):
        self.headings, self.left, self.begun = headings, left, False
        widths = widths or [width] * len(headings)
        self.widths = [max(len(heading), width) for heading, width in zip(headings, widths, strict=True)]

    def row(self, *cells):
        if not self.begun:
            self.begun = True
            self.line(self.headings)
        self.line([figure(cell) for cell in cells])

    def line(self, texts):
        aligned = [text.ljust(width) if column < self.left else text.rjust(width)
                   for column, (text, width) in enumerate(zip(texts, self.widths, strict=True))]
        print("  ".join(aligned).rstrip(), flush=True)
