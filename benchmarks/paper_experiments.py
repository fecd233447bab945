"""The paper's own experiments (arXiv 2206.14444), for docs/understand/paper.md.

    python benchmarks/paper_experiments.py [--only EXPERIMENT ...] [--full] [--work build/paper]

Each experiment writes `benchmarks/results/paper-EXPERIMENT.json` and draws its pictures in docs/paper. Every run leaves
a small file in the work folder, and the same commit does not repeat it while that is there: an interrupted command goes
on where it was. --full also runs the published pipeline in ODL and the `paper` method on images as large as the
paper's, hours.
"""

import argparse
from pathlib import Path

from measurement import RESULTS
from paper.conduct import Places, conduct
from paper.experiment import FULL, Plan
from paper.registry import EXPERIMENTS

PICTURES = Path(__file__).resolve().parents[1] / "docs/pictures/paper"


def main() -> None:
    """Run what is wanted and write its figures."""
    names = [experiment.name for experiment in EXPERIMENTS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="EXPERIMENT", help=", ".join(names))
    parser.add_argument("--full", action="store_true", help="ODL as well, and images of the full size (hours)")
    parser.add_argument("--work", type=Path, default=Path("build/paper"), help="where the results of runs are kept")
    options = parser.parse_args()
    experiments = [experiment for experiment in EXPERIMENTS if experiment.name in options.only]
    conduct(experiments, FULL if options.full else Plan(), Places(options.work, RESULTS, PICTURES))


if __name__ == "__main__":
    main()
