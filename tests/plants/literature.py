"""The numbers of the literature's plants on record: typed once, compared with their sources then, and kept since.

python -m tests.plants.literature    # records them anew in tests/data/literature.json, after a change that is meant
"""

import json
from pathlib import Path

from rhl.plants.benchmarks import benchmark, names

RECORD = Path(__file__).resolve().parents[1] / "data/literature.json"


def numbers(name: str) -> dict[str, object]:
    """The matrices, the initial state and the sampling time of a plant."""
    plant = benchmark(name)
    matrices = {part: getattr(plant, part).tolist() for part in ("A", "B", "C")}
    return matrices | {"z0": plant.z0.tolist(), "h": plant.h}


def main() -> None:
    """Record every plant, one on a line."""
    lines = (f" {json.dumps(name)}: {json.dumps(numbers(name))}" for name in names(collection="literature"))
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
