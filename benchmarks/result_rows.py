"""Tables of results that grow row by row: what is measured again takes the place of its last measurement."""

from collections.abc import Sequence
from pathlib import Path


def store(table: Path, head: Sequence[str], row: str, named: int) -> None:
    """Put a row in the place of that whose first `named` characters are the same, or at the end.

    Parameters
    ----------
    table : text file, made where there is none
    head : its first lines
    row : to put
    named : characters of a row that say what was measured
    """
    lines = table.read_text(encoding="utf-8").splitlines() if table.exists() else list(head)
    same = [i for i, line in enumerate(lines) if line[:named] == row[:named]]
    if same:
        lines[same[0]] = row
    else:
        lines.append(row)
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
