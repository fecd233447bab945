"""The closed list of failure codes: a metric labelled by code has no more values than this list.

`tests/worker/jobs/test_kinds.py` compares the list with the codes that the sources name.
"""

OTHER = "other"
# The service's own trouble, and lost attempts (`attempts/failures.py` and `jobs/job_store.py` of the platform).
DEFECTS = frozenset({"attempt-crashed", "internal-error", "invalid-result"})
LOSSES = frozenset({"attempt-died", "attempt-stalled", "worker-lost"})
OUTAGES = frozenset({"disk-full", "storage-full", "storage-unavailable"})
LIMITS = frozenset({"file-too-large", "out-of-memory", "too-long", "too-many-files"})
FILES = frozenset(
    {
        "angles-malformed",
        "angles-mismatch",
        "angles-missing",
        "angles-repeated",
        "broken-file",
        "calibration-file",
        "contradiction",
        "dataset-ambiguous",
        "dataset-missing",
        "empty-file",
        "external-storage",
        "file-in-use",
        "flats-missing",
        "geometry-file",
        "linked-file-missing",
        "no-signal",
        "not-finite",
        "out-of-range",
        "picture-file",
        "picture-not-png",
        "rows-missing",
        "too-large",
        "truncated-file",
        "unknown-format",
        "unsafe-archive",
        "unsupported-storage",
        "volume-file",
        "wrong-shape",
        "wrong-type",
    }
)
# The request does not fit the data to which it applies.
ASKS = frozenset(
    {
        "baseline",
        "calibration",
        "calibration-deleted",
        "calibration-without-result",
        "counts",
        "detector-pitch-missing",
        "empty-slice",
        "fixed-pairs-deleted",
        "flat-scan",
        "geometry",
        "inspection-deleted",
        "log-cut-off",
        "log-not-found",
        "metal-in-log",
        "moved-too-far",
        "no-active-calibration",
        "no-geometry",
        "nothing-seen",
        "other-detector",
        "other-scanner",
        "outside-detector",
        "partial-turn",
        "phantom",
        "phantom-deleted",
        "phantom-not-seen",
        "phantom-outside-field",
        "phantom-refused",
        "physics",
        "result-damaged",
        "rows-not-aligned",
        "rows-outside",
        "rows-overlap",
        "scan-deleted",
        "scan-refused",
        "scanner-deleted",
        "sparse-views",
        "too-few-calibrations",
        "too-few-views",
        "turned-between-passages",
        "views-too-many",
        "without-error-bars",
    }
)
CODES = DEFECTS | LOSSES | OUTAGES | LIMITS | FILES | ASKS


def counted_as(code: str | None) -> str:
    """Return the code where the list has it, else `other`, for instance for a code of an older version."""
    return code if code in CODES else OTHER
