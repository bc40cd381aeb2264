"""Checks of types in tests: functions, methods and fields of dataclasses, each call with its own names of axes.

The import hook of jaxtyping does the same, but it binds and checks the arguments of every call twice, and decorates
functions within functions anew in every call of the outer one: tests took twice as long.
"""

import ast
import functools
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType
from typing import Any, TypeVar, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import config, jaxtyped

Kind = TypeVar("Kind", bound=type)
# An int may stand for a float. A wrong type is a TypeError, which is what the function would raise without checks: code
# that reads damaged files answers it.
SETTINGS = BeartypeConf(is_pep484_tower=True, violation_type=TypeError)
# Functions that are called often get few new kinds of arguments: of so many calls all are checked, then one of so many.
# Checks of all calls take a third of the time of the tests.
ALL_OF, ONE_OF = 30, 50
DECORATOR = f"__import__({__name__!r}, fromlist=['']).{{}}"


TYPING_ONLY: dict[str, list[ast.stmt]] = {}  # by module: what stands under `if TYPE_CHECKING`


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Check arguments and results, of all calls at first and later of some, unless `jaxtyping.config` says not to."""
    checking = None

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        nonlocal checking
        if config.jaxtyping_disable or sys.is_finalizing():
            return function(*args, **kwargs)
        call.calls += 1
        if call.calls > ALL_OF and call.calls % ONE_OF:
            with jaxtyped("context"):  # what it calls has no names of axes in common with what called it
                return function(*args, **kwargs)
        if checking is None:  # in the first call, as annotations may name what is defined further below
            checking = beartype(conf=SETTINGS)(_resolved(function))
        with jaxtyped("context"):  # an axis of the same name has the same length within one call
            return checking(*args, **kwargs)

    call.calls = 0
    return call


def _resolved(function: Callable[..., Any]) -> Callable[..., Any]:
    """Replace names in annotations that the module imports for type checkers only."""
    if function.__module__ in TYPING_ONLY:
        names = _all_names(function.__module__)
        function.__annotations__ = get_type_hints(function, names, include_extras=True)
    return function


def _all_names(module: str) -> dict[str, Any]:
    """Names of a module, with those that it has for type checkers only."""
    names = dict(vars(sys.modules[module]))
    for line in TYPING_ONLY.get(module, []):
        if isinstance(line, ast.ImportFrom) and line.module in TYPING_ONLY:
            hidden = _all_names(line.module)
            names |= {each.asname or each.name: hidden[each.name] for each in line.names}
        else:
            exec(compile(ast.Module([line], []), module, "exec", dont_inherit=True), names)
    return names


def checked_fields(kind: Kind) -> Kind:
    """Check the fields of a dataclass when an object is made."""
    if "__dataclass_fields__" in vars(kind) and not hasattr(kind.__init__, "__wrapped__"):
        kind.__init__ = checked(kind.__init__)
    return kind


def check_types(packages: Sequence[str]) -> None:
    """Check all modules of packages that are imported from now on."""
    sys.meta_path.insert(0, _Finder(packages))


class _Finder(PathFinder):
    """Finds modules of some packages."""

    def __init__(self, packages: Sequence[str]) -> None:
        self.packages = packages

    def find_spec(self, fullname: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        """Find a module; None leaves it to the other finders."""
        found = PathFinder.find_spec(fullname, path, target) if fullname.partition(".")[0] in self.packages else None
        if found is None or not isinstance(found.loader, SourceFileLoader):
            return None
        found.loader = _Loader(found.loader.name, found.loader.path)
        return found


class _Loader(SourceFileLoader):
    """Loads a module with a decorator at each function and class; its code never gets into ``__pycache__``."""

    def get_code(self, fullname: str) -> CodeType:
        """Compile the source with decorators."""
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path), path)
        hidden = [line for node in tree.body if _is_typing_only(node) for line in node.body]
        if hidden:
            TYPING_ONLY[fullname] = hidden
        _decorate(tree.body)
        return compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)


def _is_typing_only(node: ast.stmt) -> bool:
    """Whether a statement is `if TYPE_CHECKING:`."""
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _decorate(body: list[ast.stmt]) -> None:
    """Add the decorators in a module or class; functions within functions get none."""
    for node in body:
        if isinstance(node, ast.FunctionDef):
            if all("no_type_check" not in ast.unparse(each) for each in node.decorator_list):
                node.decorator_list.append(_named("checked", node))
        elif isinstance(node, ast.ClassDef):
            node.decorator_list.insert(0, _named("checked_fields", node))
            _decorate(node.body)
        elif isinstance(node, ast.If | ast.Try | ast.With):
            _decorate(node.body)


def _named(name: str, place: ast.stmt) -> ast.expr:
    """Expression of one of the decorators."""
    expression = ast.parse(DECORATOR.format(name), mode="eval").body
    return ast.copy_location(expression, place)
