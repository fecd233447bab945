"""The process of one attempt at a job of the mill, and its template: `python -m sawmill_worker.attempt`."""

from sawmill_platform.attempts import attempt
from sawmill_worker.jobs import running
from sawmill_worker.software import software


def main() -> None:
    """Run one attempt, or fork as many as are asked for."""
    software()
    attempt.main(running)


if __name__ == "__main__":
    main()
