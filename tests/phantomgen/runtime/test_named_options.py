"""Options of functions as `help` shows them."""

import inspect
from dataclasses import dataclass, field, fields

import pytest

import phantomgen
from phantomgen.degradation.settings import Degradation
from phantomgen.runtime.named_options import named_options


@dataclass(frozen=True)
class Options:
    """Options of a toy.

    Parameters
    ----------
    width : of the toy [mm],
        in two lines
    out : replaced by the parameter of the function
    names : of its parts
    """

    width: float = 2.0
    out: str = ""
    names: tuple[str, ...] = field(default_factory=tuple)


@named_options(Options)
def toy(count, *, out=None, **options):
    """Make toys.

    Parameters
    ----------
    count : how many
    out : where
    **options : fields of
        the options

    Returns
    -------
    the options
    """
    return Options(**options)


def test_fields_become_keyword_parameters_but_for_those_the_function_has():
    parameters = inspect.signature(toy).parameters
    assert list(parameters) == ["count", "out", "width", "names"]
    assert (parameters["width"].default, parameters["width"].annotation, parameters["names"].default) == (
        2.0,
        float,
        (),
    )
    assert parameters["width"].kind is inspect.Parameter.KEYWORD_ONLY
    assert toy(1, width=3.0) == Options(width=3.0)


def test_a_name_that_is_no_option_is_refused_by_python():
    with pytest.raises(TypeError, match="unexpected keyword argument 'wdith'"):
        toy(1, wdith=3.0)


def test_descriptions_of_the_fields_replace_the_entry_of_the_options():
    assert "**options" not in toy.__doc__
    assert "width : of the toy [mm],\n    in two lines\n" in toy.__doc__
    assert toy.__doc__.index("names : of its parts") < toy.__doc__.index("Returns")


@pytest.mark.parametrize("function", [phantomgen.degrade, phantomgen.import_scan])
def test_public_functions_name_and_describe_all_their_options(function):
    parameters = inspect.signature(function).parameters
    assert all(entry.kind is not inspect.Parameter.VAR_KEYWORD for entry in parameters.values())
    section = inspect.getdoc(function).split("Returns\n")[0]
    described = {
        name.strip() for line in section.splitlines() if " : " in line for name in line.split(" : ")[0].split(",")
    }
    assert set(parameters) == described & set(parameters)


def test_degrade_takes_every_field():
    assert {field.name for field in fields(Degradation)} < set(inspect.signature(phantomgen.degrade).parameters)
