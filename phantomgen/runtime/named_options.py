"""Functions whose options are the fields of a dataclass: ``help`` and notebooks show each option by its name."""

import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])
_ENTRY = re.compile(r"^\*\*options : .*(?:\n    .*)*", re.MULTILINE)
_SECTION = re.compile(r"Parameters\n-+\n((?:.+\n?)+)")


def named_options(*records: type) -> Callable[[Function], Function]:
    """Show the fields of dataclasses as the options of a function that takes ``**options``.

    Its signature gets a keyword parameter for each field, and its docstring their descriptions in place of the entry
    ``**options``. The function itself does not change.

    Parameters
    ----------
    *records : the dataclasses, whose docstrings have the section Parameters

    Returns
    -------
    a decorator
    """

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)
        known = [entry for entry in signature.parameters.values() if entry.kind is not inspect.Parameter.VAR_KEYWORD]
        named = {entry.name for entry in known}
        added = [_parameter(field) for record in records for field in fields(record) if field.name not in named]
        function.__signature__ = signature.replace(parameters=[*known, *added])  # type: ignore[attr-defined]
        if function.__doc__ is not None:
            described = "".join(_described(record) for record in records).rstrip("\n")
            function.__doc__ = _ENTRY.sub(lambda _: described, inspect.cleandoc(function.__doc__))
        return function

    return decorate


def _parameter(field: Field) -> inspect.Parameter:
    """A field as a keyword parameter."""
    default = field.default
    if default is MISSING and field.default_factory is not MISSING:
        default = field.default_factory()
    empty = inspect.Parameter.empty
    return inspect.Parameter(
        field.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=empty if default is MISSING else default,
        annotation=field.type,
    )


def _described(record: type) -> str:
    """The section Parameters of a docstring."""
    section = _SECTION.search(inspect.cleandoc(record.__doc__ or ""))
    return "" if section is None else section[1].rstrip("\n") + "\n"
