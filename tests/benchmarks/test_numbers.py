"""Numbers of documents: each has a command, its words still stand, and what is stored agrees with what is stated."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.check_numbers import CommandRunner, differing, judged, selected, words_of
from benchmarks.claims import Claim, NumbersFile, Run, Value, numbers_of, numbers_of_line, read, read_numbers_file

ROOT = Path(__file__).parents[2]
NUMBERS_FILE = read_numbers_file()
CLAIMS = NUMBERS_FILE.all_claims()
README_ROWS = [line for line in read("README.md").splitlines() if line.startswith("|") and numbers_of(line)]


def runner(tmp_path: Path, *runs: Run, **options: bool) -> CommandRunner:
    return CommandRunner(NumbersFile({run.name: run for run in runs}, (), (), ()), tmp_path, **options)


@pytest.mark.parametrize("document", sorted({claim.document for claim in CLAIMS}))
def test_the_words_of_every_claim_stand_in_its_document(document):
    text = read(document)
    gone = [claim.words for claim in CLAIMS if claim.document == document and not claim.stands(text)]
    assert not gone, f"benchmarks/numbers.yaml has words that are not in {document} any more: {gone}"


def test_every_claim_states_the_numbers_that_its_runs_give():
    assert not [(claim.words, claim.unstated) for claim in CLAIMS if claim.unstated]
    assert not {value.run for claim in CLAIMS for value in claim.values} - set(NUMBERS_FILE.runs)
    assert not {needed for run in NUMBERS_FILE.runs.values() for needed in run.after} - set(NUMBERS_FILE.runs)


@pytest.mark.parametrize("row", README_ROWS)
def test_every_number_in_a_table_of_the_readme_has_a_command(row):
    claims = [claim for claim in CLAIMS if claim.document == "README.md" and claim.words == row]
    assert claims, f"benchmarks/numbers.yaml has no command for this row: {row}"
    assert claims[0].uncovered == []


def test_every_number_of_a_row_of_results_has_its_place():
    rows = [claim for table in NUMBERS_FILE.tables for claim in table.claims(read(table.document))]
    assert rows
    assert not [(claim.words, claim.uncovered) for claim in rows if claim.uncovered]


def test_what_documents_state_is_what_is_stored(tmp_path, capsys):
    stored = CommandRunner(NUMBERS_FILE, tmp_path, stored=True)
    wrong, _ = judged(CLAIMS, stored)
    capsys.readouterr()
    assert not {claim.words: reasons for claim, reasons in wrong.items()}
    assert not differing(NUMBERS_FILE.same, stored)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("stated", "within", "measured", "holds"),
    [
        ("50.7", "", 50.74, True),
        ("50.7", "", 50.76, False),
        ("50.7", "0.1", 50.84, True),
        ("50.7", "0.1", 50.86, False),
        ("2e-4", "20%", 2.8e-4, True),
        ("2e-4", "20%", 3.0e-4, False),
        ("131822", "", 131822, True),
    ],
)
def test_a_number_holds_within_its_tolerance_and_its_last_digit(stated, within, measured, holds):
    assert Value(stated, "run", within=within).holds(measured) == holds


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("| K-edge 63.3 keV | 47.1 | **47.2** |", ["63.3", "47.1", "47.2"]),
        ("128^3 voxels, rms 1e-4, `--tol 1e-4`", ["128", "1e-4"]),
        ("[three](results/1.txt) of 4", ["4"]),
        ("bin0 and FDK2 are names; -0.2 dB is none", ["-0.2"]),
    ],
)
def test_numbers_are_found_as_they_are_written(text, numbers):
    assert numbers_of(text) == numbers


def test_a_line_of_results_is_found_by_all_of_its_words():
    text = "head\nfast, slow    1.5 / 2.5  3\nfast     7.0  8\n"
    assert numbers_of_line(text, "fast") == [7.0, 8.0]
    assert numbers_of_line(text, "fast, slow", below="head") == [1.5, 2.5, 3.0]
    with pytest.raises(LookupError, match="no line starts with 'best'"):
        numbers_of_line(text, "best")


def test_runs_come_after_what_they_need_and_only_once(tmp_path):
    write = "python -c \"import json, pathlib; p = pathlib.Path('n.json'); n = json.loads(p.read_text()) if p.exists() else 0; p.write_text(json.dumps(n + 1))\""  # fmt: skip # noqa: E501
    made = Run("made", (write,), file="n.json")
    fitted = Run("fitted", ("python -c \"print(open('n.json').read())\"",), ("made",))
    works = runner(tmp_path, made, fitted)
    assert float(works.text("fitted") or "nan") == 1
    works.text("made")
    assert json.loads((tmp_path / "n.json").read_text()) == 1
    again = CommandRunner(works.numbers_file, tmp_path, resume=True)
    assert float(again.text("fitted") or "nan") == 1
    assert json.loads((tmp_path / "n.json").read_text()) == 1


def test_a_command_that_fails_is_reported_and_what_needs_it_is_not_run(tmp_path):
    works = runner(
        tmp_path, Run("bad", ("python -c \"raise SystemExit('no beam')\"",)), Run("next", ("true",), ("bad",))
    )
    claim = Claim("README.md", "words 1", (Value("1", "next", find="(1)"),))
    wrong, _ = judged([claim], works)
    assert wrong == {claim: ["1: failed"]}
    assert "no beam" in works.failed["bad"]
    assert works.failed["next"] == "bad failed"


def test_slow_commands_are_not_run_unless_asked_for(tmp_path):
    works = runner(tmp_path, Run("slow", ("python -c 'print(2)'",), slow=True))
    assert works.text("slow") is None
    assert runner(tmp_path, *works.numbers_file.runs.values(), slow=True).text("slow") == "2\n"


def test_commands_are_those_of_this_checkout():
    assert words_of("python -m benchmarks.reconstruction.ablation pin")[:2] == [
        sys.executable,
        "-m",
    ]
    assert words_of("recon fit kedge.h5")[:4] == [sys.executable, "-m", "recon", "fit"]


def test_claims_are_chosen_by_a_word():
    chosen = selected(CLAIMS, ["readme"])
    assert {claim.document for claim in chosen} == {"README.md"}


def test_the_exit_code_says_that_a_sentence_does_not_hold():
    command = [sys.executable, "-m", "benchmarks.check_numbers", "--stored", "--only", "readme"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert " 0 do not hold" in ended.stdout
