"""The vocabulary: enums, value types with units and bounds, and outlines, each defined once.

Science, contracts, pictures and service all import this package, and it imports the
standard library and `annotated_types` alone.
"""

from sawmill_vocabulary.choices import (
    Adjustment,
    Agreement,
    AirCorrection,
    AlphaRule,
    CalibrationMethod,
    CalibrationStatus,
    CellOrder,
    ColorMap,
    DataKind,
    FaultyCells,
    FilterName,
    Handedness,
    HardeningHandling,
    MetalHandling,
    MovedBody,
    ObjectTurns,
    PaperCorrelation,
    PaperObjective,
    PaperStop,
    PoseHandling,
    Preference,
    Progress,
    ProgressCallback,
    ReconstructionMethod,
    RingRemoval,
    Rotation,
    RowAlignment,
    UsedEstimate,
    Verdict,
    Weighting,
)
from sawmill_vocabulary.geometry import (
    FEWEST_PAIRED_VIEWS,
    LARGEST_MM,
    TAU,
    WIDEST_CELL_MM,
    WIDEST_MEASURED_STEP_DEG,
    WIDEST_STEP_DEG,
    DetectorEstimate,
    DetectorModule,
    GeometryError,
    Scanner,
    SourceFrame,
    Theta,
    ThetaBounds,
    angle_difference,
    wrap_angle,
)
from sawmill_vocabulary.outlines import fault_of_outline
from sawmill_vocabulary.pairs import FixedPair, PairedScanner
from sawmill_vocabulary.phantoms import (
    BUILT_IN_OUTLINES,
    LARGEST_ASSUMED_LOG_RADIUS_MM,
    MOST_CORNERS,
    PUBLISHED_PRECISION_MM,
    STANDARD_SIZE_TOLERANCE,
    CoordinateMm,
    Disc,
    Point,
    Polygon,
    Shape,
    TrueAxis,
)
