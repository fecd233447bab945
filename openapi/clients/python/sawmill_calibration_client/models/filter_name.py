from enum import StrEnum


class FilterName(StrEnum):
    COSINE = "cosine"
    HAMMING = "hamming"
    HANN = "hann"
    RAM_LAK = "ram-lak"
    SHEPP_LOGAN = "shepp-logan"

    def __str__(self) -> str:
        return str(self.value)
