from enum import StrEnum


class Adjustment(StrEnum):
    ANGLE_JITTER = "angle-jitter"
    BEAM_HARDENING = "beam-hardening"
    BLUR = "blur"
    CORNERS = "corners"
    CORRUPT_VIEWS = "corrupt-views"
    CREEP = "creep"
    DEFORMATION = "deformation"
    DENSITY_GRADIENT = "density-gradient"
    ENCODER = "encoder"
    FAULTY_CELLS = "faulty-cells"
    FLAT_FIELD = "flat-field"
    INTENSITY_AVERAGING = "intensity-averaging"
    LAG = "lag"
    METAL = "metal"
    OUTLIERS = "outliers"
    PACE = "pace"
    PHANTOM_ROWS = "phantom-rows"
    ROTATION_DURING_EXPOSURE = "rotation-during-exposure"
    SCATTERED_RADIATION = "scattered-radiation"
    SLIP = "slip"
    VIEW_GAIN = "view-gain"
    WOBBLE = "wobble"

    def __str__(self) -> str:
        return str(self.value)
