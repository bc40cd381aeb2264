"""Words for methods and what is changed about them, budgets, and the paper's studies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.comparison.contenders.contender import GAUSSIAN, PAPER, Contender, contender, contenders
from recon.comparison.outcome import parse_budgets
from recon.comparison.studies import STUDIES, Scan
from recon.comparison.tables.published_numbers import TABLE_4C
from recon.published_methods.paper.recipe import COMPONENTS
from recon.runs.methods import METHODS, method_named
from recon.voxel.method import CountsMethod, ViewMethod
from spectra.errors import InputError

KEDGE = Scan(("bin0", "bin1", "bin2", "bin3"), bases=3, views=75)
FEW = Scan(("low", "middle", "high"), bases=2, views=9)

anything = st.builds(
    Contender,
    method=st.sampled_from([GAUSSIAN, *METHODS]),
    bases=st.sampled_from([None, 2, 3]),
    views=st.none() | st.integers(1, 10**4),
    blind=st.none() | st.from_regex(r"[a-z][\w.-]{0,8}", fullmatch=True).filter(str.isascii),
)


@given(anything)
def test_a_contender_is_its_word(who):
    assert contender(str(who)) == who


@given(st.booleans(), st.booleans())
def test_a_fit_with_its_recipe_and_kernel_is_its_word(best, plain):
    who = Contender(GAUSSIAN, best=best, plain=plain)
    assert contender(str(who)) == who


@given(st.lists(st.sampled_from(list(COMPONENTS)), unique=True))
def test_the_paper_without_components_is_its_word(names):
    who = Contender(PAPER, without=tuple(names))
    assert set(contender(str(who)).without) == set(names)


def test_methods_of_one_channel_are_on_the_curve_without_a_word():
    assert [contender(word).on_curve for word in ("nmar", "one-step+curve", "one-step")] == [True, True, False]
    assert str(contender("one-step+curve")) == "one-step+curve"


def test_contenders_come_once_each_in_their_order():
    assert [*map(str, contenders(["sart", " fdk+image", "sart", ""]))] == ["sart", "fdk+image"]


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("tv", "there is no method 'tv' to compare: choose from gaussian, paper, fdk"),
        ("fdk+4", "fdk+4: '4' is no change of the method fdk: choose from best, plain, image, curve, 2, 3, views-N"),
        ("nmar+curve", "'curve' is no change of the method nmar"),
        ("gaussian+image", "'image' is no change of the method gaussian"),
        ("gaussian+without-tv", "'without-tv' is no change of the method gaussian"),
        ("paper+without-colour", "--without colour: there is no such component"),
        ("fdk+views-0", "'views-0' is no change"),
        ("fdk+image+blind-bin0", "takes every channel by itself"),
        ("", "a comparison needs methods"),
    ],
)
def test_words_that_mean_nothing_are_refused(word, sentence):
    with pytest.raises(InputError, match=sentence.replace("+", r"\+")):
        contenders([word])


@pytest.mark.parametrize(
    ("text", "seconds"), [("60s,240s", (60, 240)), ("2m", (120,)), ("30,7.5s", (7.5, 30)), ("5s,5", (5,))]
)
def test_budgets_are_seconds_in_ascending_order(text, seconds):
    assert parse_budgets(text) == seconds


@pytest.mark.parametrize("text", ["", "0s", "-3s", "fast", "nan", "inf", "10s,"])
def test_budgets_that_are_no_times_are_refused(text):
    with pytest.raises(InputError, match="--budget takes times above 0"):
        parse_budgets(text)


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("scan", [KEDGE, FEW])
def test_every_study_has_contenders_that_the_scan_allows_and_a_table_without_results(name, scan):
    study = STUDIES[name](scan)
    assert len(set(study.contenders)) == len(study.contenders)
    assert all((who.bases or 0) <= scan.bases for who in study.contenders)
    assert all((who.views or 0) <= scan.views for who in study.contenders)
    header, *lines = study.rows({}, "honest")
    assert lines
    assert all(len(line) == len(header) for line in lines)


@pytest.mark.parametrize("name", STUDIES)
def test_no_study_asks_for_volumes_of_channels_that_a_method_does_not_make(name):
    methods = [method_named(who.method) for who in STUDIES[name](KEDGE).contenders if who.image]
    assert not any(isinstance(method, CountsMethod | ViewMethod) for method in methods)


def test_the_studies_are_those_of_the_papers_tables():
    methods = {str(who) for who in STUDIES["views-and-volumes"](KEDGE).contenders}
    assert {"fdk+image", "sart+image", "cgls+image", "pdhg-tv+image", "paper+2", "paper+3", "gaussian+3"} <= methods
    blind = [who.blind for who in STUDIES["held-out-channel"](KEDGE).contenders if who.blind]
    assert set(blind) == set(KEDGE.channels)
    assert {w.views for w in STUDIES["few-views"](KEDGE).contenders} == {75, 50, 25, 10}
    left_out = {w.without for w in STUDIES["ablation"](KEDGE).contenders}
    assert left_out == {(name,) if name else () for name in TABLE_4C}


@pytest.mark.parametrize(("channels", "losses"), [("abc", ["-2.94", "-0.88", "-8.17"]), ("abcd", ["-"] * 4)])
def test_the_papers_losses_stand_only_beside_scans_of_as_many_channels(channels, losses):
    header, *lines = STUDIES["held-out-channel"](Scan(tuple(channels), bases=2, views=9)).rows({}, "honest")
    assert header[-1] == "in the paper"
    assert [line[-1] for line in lines if line[0] == "gaussian+2"] == losses


def test_no_channel_can_be_spared_where_there_are_no_more_than_bases():
    with pytest.raises(InputError, match="of 2 channels none can be left out: 2 bases need as many"):
        STUDIES["held-out-channel"](Scan(("low", "high"), bases=2, views=9))
