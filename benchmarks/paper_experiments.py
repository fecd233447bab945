"""The paper's own experiments (arXiv 2206.14444), and docs/paper.md written from their results.

    python benchmarks/paper_experiments.py [--only EXPERIMENT ...] [--full] [--work build/paper] [--page docs/paper.md]

Every run leaves a small file in the work folder and is not done again while that is there: an interrupted command goes
on where it was. --full also runs the published pipeline in ODL and the `paper` method on images as large as the
paper's, hours.
"""

import argparse
from pathlib import Path

from paper.conduct import Places, conduct
from paper.experiment import FULL, Plan
from paper.registry import EXPERIMENTS


def main() -> None:
    """Run what is wanted and write the page."""
    names = [experiment.name for experiment in EXPERIMENTS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="EXPERIMENT", help=", ".join(names))
    parser.add_argument("--full", action="store_true", help="ODL as well, and images of the full size (hours)")
    parser.add_argument("--work", type=Path, default=Path("build/paper"), help="where results are kept")
    parser.add_argument("--page", type=Path, default=Path("docs/paper.md"), help="what is written")
    options = parser.parse_args()
    conduct(EXPERIMENTS, options.only, FULL if options.full else Plan(), Places(options.work, options.page))


if __name__ == "__main__":
    main()
