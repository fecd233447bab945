"""The real process of an attempt over tasks without science: what it does stands in the uploaded file.

For jobs without one, in the name of its phantom or its scanner.
"""

import sys
from pathlib import Path
from typing import Any

from sawmill_contracts.handed_over import HandedOver
from sawmill_platform.attempts.attempt import main
from sawmill_platform.attempts.work import Attempt
from sawmill_platform.contracts.jobs import Job

sys.path.append(str(Path(__file__).parents[2] / "support"))


def attempt(job: Job, given_json: str, output: Path, report: Any, announce: Any) -> Attempt[HandedOver]:
    return Attempt(job, HandedOver.model_validate_json(given_json), output, report, announce)


if __name__ == "__main__":
    main(sys.modules[__name__])
