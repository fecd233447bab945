"""Messages on the verdict of a calibration: what speaks against it, and what to do."""

from sawmill_vocabulary.messages import N_, Message

_IMPRECISE = N_("Not precise enough: the error may be up to %(upper_mm).3f mm, and %(allowed_mm).3f mm is allowed.")
_RAY_ERROR = N_(
    "The predicted ray error is %(rms_mm).3f mm (RMS), with 95 %% below %(upper_mm).3f mm, where %(allowed_mm).3f mm "
    "is allowed."
)
_UNCERTAIN_SCALE = N_(
    "Sizes are not certain enough: they may be wrong by %(percent).2g %%, and %(allowed_percent).2g %% is allowed."
)
_PITCH = N_(
    "Check the distance between the detector's cells (detector_pitch_mm), its unit, and whether pixels were binned. "
    "Then check source_to_cor_mm."
)


class CalibrationMessage(Message):
    """Messages on a verdict, each with the names of its values in the templates."""

    NOT_CONVERGED = (
        "not-converged",
        N_("The search for the geometry has not ended at a clear result."),
        N_(
            "Check that the chosen rows show only the phantom. Compare the report's residual with the drawing, for "
            "what the drawing does not have. Use more views if there are few."
        ),
        N_("The fit did not converge."),
    )
    IMPRECISE = "imprecise", _IMPRECISE, N_("Use more views, more rows or a longer exposure."), _RAY_ERROR
    IMPRECISE_MODEL = (
        "imprecise-model",
        _IMPRECISE,
        N_(
            "The scan differs from what this phantom should give. Solve that first, as the other reasons state; more "
            "views alone will not help."
        ),
        _RAY_ERROR,
    )
    AMBIGUOUS_SIDE = (
        "ambiguous-side",
        N_("It is unclear from which end the phantom was seen, or which way it turned."),
        N_("Use a phantom without symmetry, or give both in the scanner's settings."),
        N_("The scan does not tell %(side)s, %(sense)s from %(other_side)s, %(other_sense)s."),
    )
    AMBIGUOUS_TURN = (
        "ambiguous-turn",
        N_("The phantom looks the same turned by %(by_deg).0f degrees, so the first angle is unclear."),
        N_("Use a phantom without symmetry."),
        N_("The first angle may be off by %(by_deg).0f degrees."),
    )
    SCALE_CONTRADICTION = (
        "scale-contradiction",
        N_("Two measurements contradict each other: the size of the phantom and the distance of the source."),
        N_(
            "Measure the phantom: it may be larger than its drawing by %(larger_percent).1f %% or more. Then measure "
            "the distance from the source to the turning axis."
        ),
        N_(
            "The free fit put the source at %(found_mm).2f mm, nearer than source_to_cor_mm %(known_mm).2f mm by "
            "%(deviations).0f standard deviations."
        ),
    )
    SOURCE_HELD = (
        "source-held",
        N_("The source is straight opposite the turning axis, as far as this scan shows."),
        "",
        N_(
            "The free fit put the source at %(found_mm).2f mm, nearer than source_to_cor_mm %(known_mm).2f mm, for "
            "which no theta exists: the source distance was held there, and the source shift is 0 within the noise."
        ),
    )
    SHIFT_BEYOND_BOUNDS = (
        "shift-beyond-bounds",
        N_(
            "The phantom may be another one: by its size the source is shifted by %(shift_mm).0f mm, and "
            "%(allowed_mm).0f mm is possible."
        ),
        N_("Measure the phantom and check which one was scanned. Then check source_to_cor_mm and the bounds."),
        N_(
            "The source shift would be %(shift_mm).0f mm, where the scanner's bounds allow %(allowed_mm).0f mm, as "
            "with a phantom %(by_percent).1f %% %(size)s than its drawing, or more."
        ),
    )
    OUTSIDE_BOUNDS = (
        "outside-bounds",
        N_("The result is outside of what is possible for this scanner."),
        N_("Check the scanner's constants, or widen the bounds."),
        N_("Theta lies outside the scanner's bounds."),
    )
    SHIFT_NOT_RESOLVED = (
        "shift-not-resolved",
        N_("The sideways position of the source is too close to 0 to be measured. The result is not affected."),
        "",
        N_("The source shift is not resolved from 0, so theta has no standard deviations; the rays have."),
    )
    COLUMN_BY_VIEWS = (
        "column-by-views",
        N_("The centre of rotation's place on the detector is known to %(column_mm).2g mm only (95 %%)."),
        "",
        N_(
            "The mean of the views' shifts looks the same, and the rays do not depend on it. Images of logs find the "
            "place of each view from the log."
        ),
    )
    SCALE_SIZE = (
        "scale-size",
        _UNCERTAIN_SCALE,
        N_("Measure the phantom, and enter its measured size."),
        N_(
            "Most of the uncertainty (95 %%) is the phantom's size tolerance: size_tolerance of its drawing, or "
            "size_tolerance_percent."
        ),
    )
    SCALE_NOISE = (
        "scale-noise",
        _UNCERTAIN_SCALE,
        N_("Use more views, more rows, a longer exposure or a larger phantom."),
        N_("Most of the uncertainty (95 %%) is the error of R/SDD."),
    )
    SCALE_ASPECT = (
        "scale-aspect",
        _UNCERTAIN_SCALE,
        N_("Measure the phantom along both sides and draw it again, or give the side that is right (true_axis)."),
        N_("Most of the uncertainty (95 %%): the phantom's two directions differ from its drawing's."),
    )
    EFFECT_FITTED = (
        "effect-fitted",
        "",
        "",
        N_("%(details)s It was fitted. Without that, the rays would be off by %(off_mm).2g mm."),
    )
    EFFECT_NOT_FITTED = (
        "effect-not-fitted",
        "",
        "",
        N_("%(details)s It was not fitted, and the rays are off by %(off_mm).2g mm."),
    )
    SCANNER_MOVED = (
        "scanner-moved-in-scan",
        N_("Something moved during the scan by %(moved_mm).2g mm."),
        N_("Fasten the phantom, let the scanner warm up, check what carries source and detector, and repeat the scan."),
        N_("%(headline)s The geometry is the mean of the scan: the next log is off from it by half of the motion."),
    )
    MOVED_OFTEN = (
        "moved-often",
        N_("Phantom or scanner moved at %(times)d views of the scan: the rays may be off by %(may_be_mm).2g mm."),
        N_("Fasten the phantom, check what carries source, turntable and detector, and repeat the scan."),
        N_("%(headline)s Other motions may explain the scan as well."),
    )
    SATURATED = (
        "cells-saturated",
        N_("Too many detector cells are saturated: %(share_percent).0f %%, and %(allowed_percent).0f %% is allowed."),
        N_("Lower the tube's current or the exposure, take new flat fields, and repeat the scan."),
        N_("These cells have the largest value in flat fields or in air, so their line integrals are wrong."),
    )
    DETECTOR_IN_LOG = (
        "detector-in-log",
        N_("The detector would be %(behind_mm).0f mm behind the turning axis, inside of the largest log."),
        _PITCH,
        N_("The largest log has a radius of %(radius_mm).0f mm."),
    )
    DETECTOR_FAR_AWAY = (
        "detector-far-away",
        N_("The detector would be %(distance_mm).0f mm from the source, and no scanner has above %(allowed_mm).0f mm."),
        _PITCH,
    )
    MAGNIFICATION = (
        "magnification-implausible",
        N_("The magnification would be %(magnification).1f, and no scanner of logs has above %(allowed).0f."),
        _PITCH,
    )
    WIDE_CELLS = (
        "cells-implausible",
        N_("The detector's cells would be %(pitch_mm).0f mm wide, and no scanner has above %(allowed_mm).0f mm."),
        _PITCH,
    )
    LOG_IN_OTHER_SENSE = (
        "log-in-other-sense",
        N_("The log turned the other way than the phantom."),
        N_("Check the sign of the angles, and from which end the phantom was seen."),
        N_("The log's rays agree only if the scanner turns the other way."),
    )
    LOG_MOVED = (
        "log-moved",
        N_("The log beside the phantom moved during the scan, by %(log_mm).2g mm at view %(view)d."),
        "",
        N_("%(details)s The log moved alone: the phantom's values were taken."),
    )
    BOTH_MOVED = (
        "phantom-and-log-moved",
        N_("The phantom and the log moved during the scan: the log by %(log_mm).2g mm at view %(view)d."),
        N_("Fasten the log on the turntable, and repeat the scan."),
    )
    PHANTOM_OR_LOG_MOVED = (
        "phantom-or-log-moved",
        N_("The phantom and the log beside it contradict each other."),
        N_("Fasten both, and repeat the scan with 120 views or more."),
        N_(
            "%(details)s So few views do not tell which of them moved, or whether the flat field has an error behind "
            "the log; the phantom's values were taken."
        ),
    )
    PHANTOM_SLIPPED = (
        "phantom-slipped",
        N_("The phantom slipped during the scan."),
        N_("Fasten the phantom, and repeat the scan."),
        N_("%(details)s The log's values were taken."),
    )
    PHANTOM_SLIPPED_OR_DRAWN = (
        "phantom-slipped-or-not-as-drawn",
        N_("The phantom slipped during the scan, or it is not as drawn."),
        N_("Fasten the phantom, and repeat the scan."),
        N_("%(details)s The log stood still, so its values were taken."),
    )
    LOG_DISAGREES = (
        "log-disagrees",
        "",
        "",
        N_(
            "The log beside the phantom puts the COR %(column_mm)+.3f mm and the tilt %(tilt_deg)+.3f degrees from "
            "where the phantom puts them, beyond both error bars."
        ),
    )
    MEASUREMENT_EXPIRED = (
        "measurement-expired",
        N_("The phantom's measurement of %(what)s expired on %(expired_on)s."),
        N_("Measure it again."),
        N_("It was %(measured_mm).2f mm with a standard uncertainty of %(error_mm).2g mm."),
    )
    NOT_AS_MEASURED = (
        "not-as-measured",
        N_("The phantom is drawn %(drawn_mm).2f mm along %(what)s, and was measured as %(measured_mm).2f mm."),
        N_("Draw it as measured: otherwise sizes are wrong by as much."),
        N_("The measurement's standard uncertainty is %(error_mm).2g mm."),
    )
    WITHOUT_ERROR_BARS = (
        "without-error-bars",
        N_("The published search gives no error bars."),
        N_("Look at the pictures before you use it."),
        N_("Its theta is not known to be within tolerance."),
    )
    UNEXPLAINED = (
        "unexplained",
        N_("The phantom was not found: %(share_percent).0f %% of the scan is unexplained."),
        N_("Check which phantom was scanned, and use the default method."),
        N_("The theta of the published search leaves %(share_percent).0f %% of the sinogram unexplained."),
    )
    ROTATION_TAKEN = (
        "rotation-taken",
        N_("The published search takes the rotation as given."),
        N_("Use --rotation reversed for a scanner that turns the other way."),
    )


class ResidualMessage(Message):
    """Messages on structure that the phantom's model leaves, by its place; the place does not show which cause is real.

    The value is `share_percent`, the structure's share of the sinogram; of cells also the first and the last cell.
    """

    STANDING = (
        "residual-in-all-views",
        N_("The same cells are wrong in all views: cells %(first_cell)d to %(last_cell)d."),
        N_("Check the order and the direction of the detector's modules, and the cell at which the readout starts."),
        N_("%(share_percent).1f %% of the sinogram is unexplained, and stays with the cells while the phantom turns."),
    )
    VIEWS = (
        "residual-in-views",
        N_("A few views do not fit the others (%(share_percent).1f %% of the signal)."),
        N_("Look at these views, and repeat the scan."),
        N_(
            "The phantom's model leaves %(share_percent).1f %% of the sinogram unexplained, and not as noise, most of "
            "it in few views, as when the log moves or an exposure fails."
        ),
    )
    CELLS = (
        "residual-in-cells",
        N_("Single detector cells do not fit the others (%(share_percent).1f %% of the signal)."),
        N_("Take more flat frames, or have rings removed."),
        N_(
            "The phantom's model leaves %(share_percent).1f %% of the sinogram unexplained, and not as noise, most of "
            "it in single cells, the same in every view, as from flat fields of few frames or cells of unequal gain."
        ),
    )
    EDGES = (
        "residual-at-edges",
        N_("The edges of the phantom do not look as expected (%(share_percent).1f %% of the signal)."),
        N_(
            "Try in this order: 1. turn slower, expose shorter; 2. look at the drive and its encoder; 3. plane rough "
            "surfaces and worn corners; 4. measure the phantom, and draw it again."
        ),
        N_(
            "The phantom's model leaves %(share_percent).1f %% of the sinogram unexplained, and not as noise, most of "
            "it at the phantom's edges, which has several causes: a detector that lags or a phantom that turns "
            "during the exposure, angles that jitter, a surface as the saw left it or worn corners, a drawing that is "
            "not its shape."
        ),
    )
    BESIDE = (
        "residual-beside",
        N_("Something else is in the beam beside the phantom (%(share_percent).1f %% of the signal)."),
        N_("Take it away, and repeat the scan."),
        N_(
            "The phantom's model leaves %(share_percent).1f %% of the sinogram unexplained, and not as noise, most of "
            "it beside the phantom's shadow, as from another body in the beam: a second board, a support, a hand."
        ),
    )
    SHADOW = (
        "residual-in-shadow",
        N_("The wood of the phantom does not look as expected (%(share_percent).1f %% of the signal)."),
        N_(
            "Try in this order: 1. take new flat fields; 2. check that the chosen rows show only the phantom; 3. use "
            "dry wood without knots; 4. collimate and filter the beam."
        ),
        N_(
            "The phantom's model leaves %(share_percent).1f %% of the sinogram unexplained, and not as noise, most of "
            "it inside the phantom's shadow, which has several causes: wood that is not uniform, scatter and beam "
            "hardening, flat fields that no longer fit, rows that show something else."
        ),
    )
