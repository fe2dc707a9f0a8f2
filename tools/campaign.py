"""Run or resume the campaigns whose results come with the library, and write their condensed results."""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from rhl.study.shipped import CAMPAIGNS, condense
from rhl.study.store import load

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "rhl" / "study" / "data" / "many_plants.json"


def main() -> int:
    """Run the missing campaigns; the command itself refuses a folder of other settings or versions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the folder for the stores")
    parser.add_argument("--workers", default="1")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    kept = {}
    for name in CAMPAIGNS:
        started, store = time.monotonic(), options.folder / name
        file = KEPT.parent / f"{name}.toml"
        call = [
            sys.executable,
            "-m",
            "rhl",
            "campaign",
            str(file),
            "--output",
            str(store),
            "--workers",
            options.workers,
        ]
        done = subprocess.run([*call, *(["--resume"] if store.exists() else [])], check=False, stdout=sys.stderr)
        if done.returncode:
            return done.returncode
        print(f"{name}: {time.monotonic() - started:.0f} s", file=sys.stderr)
        kept[name] = condense(load(store))
    KEPT.write_text(as_text(kept), encoding="utf-8")
    return 0


def as_text(kept: dict) -> str:
    """One row of a table per line, so that diffs are readable."""
    lines = []
    for name, found in kept.items():
        parts = []
        for part, rows in found.items():
            entries = rows if isinstance(rows, list) else [rows]
            inner = ",\n   ".join(json.dumps(entry) for entry in entries)
            parts.append(f'  "{part}": [\n   {inner}\n  ]' if isinstance(rows, list) else f'  "{part}": {inner}')
        lines.append(f' "{name}": {{\n' + ",\n".join(parts) + "\n }")
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    sys.exit(main())
