"""Docstrings against the rules of numpydoc: exits with 1 when a public function or class breaks one.

The checks and the folders are in ``[tool.numpydoc_validation]`` of pyproject.toml. numpydoc reads the source without
importing it, so that it does not know dataclasses, properties or commands; this file adds them: fields of dataclasses
and named tuples are parameters, properties need no section, and the docstring of a command is its help text.

    python -m benchmarks.check_docstrings            # the folders of pyproject.toml
    python -m benchmarks.check_docstrings recon      # others
"""

import argparse
import ast
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

from numpydoc import validate
from numpydoc.hooks.validate_docstrings import AstValidator

ROOT = Path(__file__).parents[1]


class Validator(AstValidator):
    """Validator of numpydoc that knows the fields of dataclasses and named tuples."""

    @property
    def signature_parameters(self) -> tuple[str, ...]:
        """Parameters of a function, or fields of a class."""
        if not isinstance(self.node, ast.ClassDef) or not has_fields(self.node):
            return super().signature_parameters
        return tuple(field for field in fields(self.node) if not field.startswith("_"))


def has_fields(node: ast.ClassDef) -> bool:
    """Whether the fields of a class are the parameters of its constructor."""
    return any("dataclass" in ast.unparse(d) for d in node.decorator_list) or is_named_tuple(node)


def is_named_tuple(node: ast.ClassDef) -> bool:
    """Whether a class is a named tuple."""
    return any(ast.unparse(base).endswith("NamedTuple") for base in node.bases)


def fields(node: ast.ClassDef) -> list[str]:
    """Names of the fields that a constructor takes."""
    found = [item for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)]
    return [
        item.target.id
        for item in found
        if isinstance(item.target, ast.Name)
        and "ClassVar" not in ast.unparse(item.annotation)
        and "init=False" not in (ast.unparse(item.value) if item.value else "")
    ]


def findings(path: Path, checks: set[str]) -> list[tuple[int, str, str, str]]:
    """Line, name, check and sentence of each rule that a file breaks."""
    found: list[tuple[int, str, str, str]] = []

    def visit(node: Any, ancestry: list[Any]) -> None:
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.ClassDef | ast.FunctionDef) or child.name.startswith("_") or free(child):
                continue
            name = ".".join([*(a.name for a in ancestry[1:]), child.name])
            report = validate.validate(name, Validator, ast_node=child, filename=str(path), ancestry=ancestry)
            wrong = [(c, text) for c, text in report["errors"] if c in checks and not exempt(child, c)]
            found.extend((child.lineno, name, check, text) for check, text in wrong)
            if isinstance(child, ast.ClassDef):
                visit(child, [*ancestry, child])

    tree = ast.parse(path.read_text(encoding="utf-8"))
    visit(tree, [tree])
    return found


def free(node: ast.ClassDef | ast.FunctionDef) -> bool:
    """Whether no rule holds: overloads, and commands, whose docstring is their help text."""
    return any(word in ast.unparse(d) for d in node.decorator_list for word in ("overload", ".command", ".group"))


def exempt(node: ast.ClassDef | ast.FunctionDef, check: str) -> bool:
    """Whether one rule does not hold: sections of properties, and inherited fields as parameters."""
    if isinstance(node, ast.FunctionDef):
        is_property = any("property" in ast.unparse(d) for d in node.decorator_list)
        is_context = any("contextmanager" in ast.unparse(d) for d in node.decorator_list)
        return (is_property and check in ("RT01", "YD01")) or (is_context and check == "RT01")
    inherits = bool(node.bases) and not is_named_tuple(node)
    return check in ("PR02", "PR03") and inherits


def main() -> int:
    """Print what is wrong, and how often."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path, help="folders or files in place of those of pyproject.toml")
    arguments = parser.parse_args()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["numpydoc_validation"]
    count: Counter[str] = Counter()
    for top in arguments.folders or [ROOT / folder for folder in settings["folders"]]:
        for path in sorted(top.rglob("*.py")) if top.is_dir() else [top]:
            shown = path.resolve().relative_to(ROOT).as_posix()
            for line, name, check, text in findings(path, set(settings["checks"])):
                count[check] += 1
                print(f"{shown}:{line}: {check} {name}: {text}")
    print(f"{sum(count.values())} findings {dict(sorted(count.items()))}" if count else "docstrings: no findings")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
