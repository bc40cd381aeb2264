"""YAML that would hang, fill memory or mean something else is refused at its place."""

import pytest

from phantomgen.runtime.yaml_text import YamlTextError, parse_yaml

BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 10)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_plain_values_and_aliases_are_read():
    text = "base: &base {a: 1, b: 1e-3}\nother: {<<: *base, b: [true, null, 2.5, text]}\n"
    assert parse_yaml(text).values["other"] == {"a": 1, "b": [True, None, 2.5, "text"]}
    assert parse_yaml("").values is None


@pytest.mark.parametrize(
    ("text", "words", "place"),
    [
        (BOMB, "its aliases stand for more than 2000000 values", (1, 1)),
        ("x: &a [*a]", "an alias stands inside of what it stands for", (1, 4)),
        ("[" * 100 + "]" * 100, "more than 60 deep", (1, 61)),
        ("[" * 100_000 + "]" * 100_000, "more than 60 deep", (1, 1)),
        ("a: !!int abc", "a value cannot be read", (1, 1)),
        ("a:\n  b: !!timestamp x", "the type 'timestamp' has no use here: put it in quotes", (2, 6)),
        ("a: 2020-01-01", "the type 'timestamp' has no use here: put it in quotes", (1, 4)),
        ("a: !!set {b, c}", "the type 'set' has no use here", (1, 4)),
        ("a: !!python/object:os.system x", "the type 'python/object:os.system' has no use here", (1, 4)),
        ("? [a]\n: b", "a key must be a text or a number", (1, 3)),
        ("a: [", "this is no YAML", (1, 5)),
        ("a: \x00", "unacceptable character", (1, 1)),
        ("a: " + "9" * 5000, "a value cannot be read", (1, 1)),
    ],
    ids=[
        "bomb",
        "loop",
        "deep",
        "deeper",
        "int",
        "timestamp",
        "date",
        "set",
        "python",
        "key",
        "open",
        "null",
        "digits",
    ],
)
def test_other_texts_are_refused(text, words, place):
    with pytest.raises(YamlTextError, match=words) as caught:
        parse_yaml(text)
    assert (caught.value.line, caught.value.column) == place
