from enum import StrEnum


class Verdict(StrEnum):
    FAIL = "fail"
    PASS = "pass"
    WATCH = "watch"

    def __str__(self) -> str:
        return str(self.value)
