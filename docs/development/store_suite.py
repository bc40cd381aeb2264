"""Stores what the scans of a suite must be, for others to compare theirs with.

    python docs/development/store_suite.py suite-v1-minutes suite-v1-hour

takes folders of `phantomgen suite`, one per tier, records their files anew, and writes
`phantomgen/suite/definitions/v1-expected.json`. Tiers that are not named stay as they are.
"""

import json
import sys
from pathlib import Path

from phantomgen.suite.definition import read_suite
from phantomgen.suite.record import record
from phantomgen.suite.run import MANIFEST, expected_of

FOLDER = Path(__file__).parents[2] / "phantomgen" / "suite" / "definitions"


def store(folder: Path) -> Path:
    """Store the scans of one tier; the folder must have been made by the definition as it is now."""
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    suite = read_suite(manifest["suite"], manifest["tier"])
    if manifest["sha256"] != suite.sha256:
        sys.exit(f"{folder} was made by another definition of the suite {suite.name}: make it anew")
    manifest["cases"] = [case | record(folder / case["file"]) for case in manifest["cases"]]
    path = FOLDER / f"{suite.name}-expected.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    content[suite.tier] = expected_of(manifest)
    path.write_text(_text(content), encoding="utf-8")
    return path


def _text(content: dict) -> str:
    """JSON with one line per case."""
    tiers = []
    for tier, cases in content.items():
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(case)}" for name, case in cases.items())
        tiers.append(f" {json.dumps(tier)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(tiers) + "\n}\n"


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(store(Path(name)))
